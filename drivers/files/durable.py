"""Files that are there whole or not at all, and JSON that may be damaged."""

import errno
import fcntl
import json
import mmap
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.errors import RecordingError

BLOCK = 4096
"""What goes past the page cache begins and ends at multiples of this; a device that asks for more refuses it."""


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place, durably, when the block ends without error."""
    temporary = unfinished(path)
    try:
        yield temporary
        sync(temporary)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)


def unfinished(path: Path) -> Path:
    """What is to take the place of `path`, until it does."""
    return path.with_name(f"{path.name}.tmp")


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """A hidden folder beside `path` that takes its place when the block ends without error.

    Raises
    ------
    RecordingError
        `path` exists and is not an empty folder.
    """
    path = path.resolve()  # `.` has no name, and a link must not be replaced
    require_unused(path)
    hidden = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    hidden.mkdir(parents=True)
    try:
        yield hidden
        hidden.replace(path)
        sync(path.parent)
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def require_unused(path: Path) -> None:
    """Refuse to write where something is."""
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise RecordingError(path, "exists already")


def copy_past_cache(source: Path, target: Path) -> None:
    """Copy a file that is not empty without leaving it in memory, where the file system can.

    So the machine does not copy it into the page cache first, and from there later. `target` may exist; it is not
    synced.

    Raises
    ------
    OSError
        As of any copy; `target` may be incomplete then.
    """
    descriptor = -1
    try:
        with source.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
            descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_DIRECT, 0o666)
            at, end = 0, len(content) // BLOCK * BLOCK
            with memoryview(content) as view:
                while at < end:
                    with view[at:end] as rest:
                        at += os.write(descriptor, rest)
                fcntl.fcntl(descriptor, fcntl.F_SETFL, 0)  # for the rest, which is less than a block
                os.write(descriptor, content[end:])
    except OSError as err:
        if err.errno != errno.EINVAL:
            raise
        shutil.copyfile(source, target)
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def sync(path: Path) -> None:
    """Flush a file or a folder to its device."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_json(path: Path, document: Any) -> None:
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """Parsed content of a JSON file.

    Raises
    ------
    RecordingError
        The file is not there, or is not JSON.
    """
    try:
        return json.loads(path.read_bytes())
    except OSError as err:
        raise RecordingError(path, f"cannot be read: {err.strerror}") from err
    except (ValueError, RecursionError) as err:
        raise RecordingError(path, f"is not JSON: {err}") from err
