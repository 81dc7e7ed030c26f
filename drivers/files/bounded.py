"""Bounded reading of files: never more than a limit, never blocked by a FIFO without a writer."""

import errno
import os
from pathlib import Path


def read_bounded(path: Path, max_bytes: int) -> bytes:
    """Return the content of a file; raise `OSError` (EFBIG) if it has more than `max_bytes`."""
    descriptor = os.open(
        path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC
    )  # else a FIFO would wait for a writer
    with os.fdopen(descriptor, "rb") as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise OSError(errno.EFBIG, f"has more than {max_bytes} bytes", str(path))
    return content
