"""Files that workers of a cluster need for many bundles: they travel once to each, and are known by their digest."""

import hashlib
import os
import shutil
import tempfile
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

N_KEPT = 8
"""Contents that a worker keeps on its disk, the latest used: a background is 84 MB or more."""
_keeping = threading.Lock()
"""Held while contents come and go."""


@dataclass(frozen=True, slots=True)
class Content:
    """Files by name, and the digest of names and bytes."""

    digest: str
    files: Mapping[str, bytes]


def content_of(files: Mapping[str, bytes]) -> Content:
    """Return the content that these files make up."""
    digest = hashlib.sha256()
    for name, data in sorted(files.items()):
        digest.update(f"{len(name)} {name} {len(data)} ".encode())
        digest.update(data)
    return Content(digest.hexdigest(), files)


def read_content(path: Path) -> Content:
    """Return the content of a file, or of the files in a folder."""
    paths = sorted(path.iterdir()) if path.is_dir() else [path]
    return content_of({each.name: each.read_bytes() for each in paths})


def keep_content(room: Path, content: Content) -> None:
    """Write a content to the room of a worker, if it is not there, and remove those that were not used for longest."""
    with _keeping:
        room.mkdir(parents=True, exist_ok=True)
        if (room / content.digest).exists():
            return
        unfinished = Path(tempfile.mkdtemp(prefix=".", dir=room))
        for name, data in content.files.items():
            (unfinished / name).write_bytes(data)
        unfinished.rename(room / content.digest)
        by_use = sorted(room.glob("[!.]*"), key=lambda path: path.stat().st_mtime_ns, reverse=True)
        for old in by_use[N_KEPT:]:  # a task that asks for it meanwhile finds all of it, or nothing
            shutil.rmtree(old.rename(room / f".{old.name}"), ignore_errors=True)


def kept_content(room: Path, digest: str) -> Path | None:
    """Return the folder of a content in the room of a worker; None if it is not there."""
    folder = room / digest
    try:
        os.utime(folder)
    except FileNotFoundError:
        return None
    return folder
