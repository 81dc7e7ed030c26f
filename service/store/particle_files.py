"""The files of a particle, `particles/<id>/`: durable before the row that names them.

A crash between the two leaves a folder without a row: it is invisible, and removed when its number is given to
the next result. Raw frames are large, so only those of the newest results are kept.
"""

import os
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from drivers.files.durable import sync, unfinished
from service.errors import StoreError

RAW = "bundle.tiff"


def particle_id(instance_id: str, seq: int) -> str:
    """Return the id of a particle: unique across stores, and in the order of `seq`."""
    return f"{instance_id[:8]}-{seq:08d}"


def drop_raw(folder: Path) -> None:
    """Remove the raw frames of a particle, and the unfinished file of a daemon that was killed while it wrote them."""
    finished = folder / RAW
    for path in (finished, unfinished(finished)):
        path.unlink(missing_ok=True)


def keep_files(folder: Path, files: Mapping[str, Path]) -> None:
    """Copy or link `files`, by their names in `folder`, into it, durably.

    The sources stay until `drop_sources`, so that a transaction that fails afterwards can be repeated.
    """
    shutil.rmtree(folder, ignore_errors=True)
    if not files:
        return
    folder.mkdir()
    for name, source in files.items():
        if not source.exists():  # no fault of the disk that is written to: repeating it does not help
            raise StoreError(f"{source}: is gone")
        _link_or_copy(source, folder / name)
    # in parallel: one flush of the device serves all of them
    written = [*(folder / name for name in files), folder, folder.parent]
    with ThreadPoolExecutor(len(written), thread_name_prefix="sync") as threads:
        list(threads.map(sync, written))


def drop_sources(files: Mapping[str, Path]) -> None:
    """Remove the sources of files that `keep_files` has made durable."""
    for source in files.values():
        source.unlink(missing_ok=True)


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system (the spool is on tmpfs), or one without links
        shutil.copyfile(source, target)
