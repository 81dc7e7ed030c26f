"""Bounded reading of files: never more than a limit, never blocked by a FIFO."""

import errno
import os
import stat
from pathlib import Path


def read_bounded(path: Path, max_bytes: int) -> bytes:
    """Return the content of a file; raise `OSError` if it has more than `max_bytes` (EFBIG), or is a FIFO (ESPIPE)."""
    descriptor = os.open(
        path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC
    )  # else a FIFO would wait for a writer
    with os.fdopen(descriptor, "rb") as file:
        if stat.S_ISFIFO(os.fstat(descriptor).st_mode):  # what is in it now need not be all
            raise OSError(errno.ESPIPE, "is a pipe: write its content to a file", str(path))
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise OSError(errno.EFBIG, f"has more than {max_bytes} bytes", str(path))
    return content
