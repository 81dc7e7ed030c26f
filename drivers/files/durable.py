"""The one way to write durably: a file or folder is there whole or not at all, also after a power cut.

`replacing` writes a file, `new_folder` a folder, `write_json` a document, and `write_file` a file where others may
write, too. Each writes under another name in the same folder, flushes to the device, renames, and flushes the folder
that holds the name. What is at that other name is never written to: it may be a link to any file.
"""

import errno
import fcntl
import json
import mmap
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from drivers.errors import RecordingError
from drivers.files.bounded import read_bounded

BLOCK = 4096
"""Alignment in bytes of direct writes (O_DIRECT); a device that needs a larger one refuses them."""
CREATING = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
MAX_JSON_BYTES = 64 << 20
"""Largest file that `read_json` parses, which takes ten times as much memory; ours have less than a tenth."""
UNFOUND = re.compile(r".+\.[0-9a-f]{16}\.tmp", re.DOTALL)
"""Pattern of the temporary names of `write_file`, which cannot be foretold."""


@contextmanager
def replacing(path: Path, mode: int = 0o666) -> Iterator[Path]:
    """Yield a new, empty file beside `path`; it takes the place of `path`, durably, when the block ends without error.

    Two writers of one path at the same time are not provided for: the temporary path is always the same. For a folder
    that others can write to there is `write_file`.
    """
    _require_replaceable(path)
    temporary = unfinished(path)
    temporary.unlink(missing_ok=True)  # what a killed process left, or a link
    try:
        os.close(os.open(temporary, CREATING, mode))
        yield temporary
        sync(temporary)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)


def unfinished(path: Path) -> Path:
    """Return the temporary path of `replacing`: what a process that was killed while it wrote left behind."""
    return path.with_name(f"{path.name}.tmp")


def write_file(path: Path, content: bytes) -> None:
    """Write a file durably into a folder that others may write to; what they do there harms no other file."""
    _require_replaceable(path)
    temporary = path.with_name(f"{path.name}.{secrets.token_hex(8)}.tmp")
    descriptor = os.open(temporary, CREATING, 0o666)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(descriptor)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    sync(path.parent)


def _require_replaceable(path: Path) -> None:
    """Refuse a device: for root, a file would take the place of /dev/null."""
    if path.is_char_device() or path.is_block_device():
        raise OSError(errno.EEXIST, "is a device, which no file may replace", str(path))


def remove_unfinished(folder: Path) -> None:
    """Remove what processes left in a folder that were killed in `write_file`; none may be writing there."""
    for path in folder.iterdir():
        if UNFOUND.fullmatch(path.name):
            with suppress(OSError):  # it belongs to another user
                path.unlink()


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a hidden folder beside `path`; it takes the place of `path` when the block ends without error.

    The rename is durable; files in the folder are if their writer flushed them.

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
    """Raise `RecordingError` unless `path` is free or an empty folder."""
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise RecordingError(path, "exists already")


def copy_past_cache(source: Path, target: Path) -> None:
    """Copy a file that is not empty past the page cache (O_DIRECT), or through it where the file system cannot.

    That spares the machine a second copy of the data, and the kernel's writing back later. `target` may exist; it
    is not flushed.

    Raises
    ------
    OSError
        The copy failed; `target` may be incomplete.
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
                fcntl.fcntl(descriptor, fcntl.F_SETFL, 0)  # clears O_DIRECT for the rest, less than a block
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
    """Write a JSON document durably, indented by one space; `ValueError` for numbers that are not finite."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def read_json(path: Path) -> Any:
    """Return the parsed content of a JSON file.

    Raises
    ------
    RecordingError
        The file cannot be read, is not JSON, or is larger than any of ours.
    """
    try:
        return json.loads(read_bounded(path, MAX_JSON_BYTES))
    except OSError as err:
        raise RecordingError(path, f"cannot be read: {err.strerror}") from err
    except RecursionError as err:
        raise RecordingError(path, "is nested more deeply than any file of ours") from err
    except ValueError as err:
        raise RecordingError(path, f"is not JSON: {err}") from err
