"""The files of a particle, `particles/<day>/<id>/`: durable before the row that names them.

A crash between the two leaves a folder without a row: it is invisible, and removed at the next start, or when its
number is given to the next result. The files of a revision are in the folder `r<revision>` within it. Raw frames are
large, so only those of the newest results are kept.
"""

import logging
import os
import re
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from drivers.files.durable import sync, unfinished
from service.base.errors import StoreError

log = logging.getLogger(__name__)

RAW = "bundle.tiff"
FOLDER = re.compile(r"([0-9]{4}-[0-9]{2}-[0-9]{2}/)?[0-9a-f]{8}-[0-9]{8,16}(/r[0-9]{1,9})?")
"""Day (earlier versions had none), id, and of a revision its number."""


def particle_id(instance_id: str, seq: int) -> str:
    """Return the id of a particle: unique across stores, and in the order of `seq`."""
    return f"{instance_id[:8]}-{seq:08d}"


def particle_folder(name: str, recorded_at: str) -> str:
    """Return where the files of a particle are, below `particles`: a folder a day, each for itself of bearable size."""
    return f"{recorded_at[:10]}/{name}"


def revision_folder(folder: str, revision: int) -> str:
    """Return where the files of a revision are, below `particles`; `folder` is the stone's."""
    return folder if revision == 1 else f"{folder}/r{revision}"


def is_folder(folder: str) -> bool:
    """True when a text of the database is the path of a particle's folder, below `particles` and nothing else."""
    return FOLDER.fullmatch(folder) is not None


def path_of(particles_dir: Path, folder: str) -> Path:
    """Return where a folder is that the database names.

    Raises `StoreError` if it would be elsewhere: the database was tampered with, or is damaged.
    """
    if not is_folder(folder):
        raise StoreError(f"{folder!r} is no folder of a particle: nothing there is read, written or removed")
    return particles_dir / folder


def first_seq(name: str) -> int:
    """Return the `seq` of the first result of a stone, which its id ends with."""
    return int(name.rpartition("-")[2])


def drop_raw(folder: Path) -> None:
    """Remove the raw frames of a particle, and the unfinished file of a daemon that was killed while it wrote them."""
    finished = folder / RAW
    for path in (finished, unfinished(finished)):
        path.unlink(missing_ok=True)


def keep_files(folder: Path, files: Mapping[str, Path]) -> Mapping[str, int]:
    """Copy or link `files`, by their names in `folder`, into it, durably; return the sizes of those that were there.

    Sources on tmpfs may have been deleted, which is no reason to lose the result. The others stay until `drop_sources`,
    so that a transaction that fails afterwards can be repeated.
    """
    shutil.rmtree(folder, ignore_errors=True)
    if not files:
        return {}
    new_day = () if folder.parent.exists() else (folder.parent.parent,)
    folder.mkdir(parents=True)
    kept = {}
    for name, source in files.items():
        try:
            _link_or_copy(source, folder / name)
        except FileNotFoundError:
            log.error("a file of a result is gone: %s", source)
        else:
            kept[name] = (folder / name).stat().st_size
    # in parallel: one flush of the device serves all of them
    written = [*(folder / name for name in kept), folder, folder.parent, *new_day]
    with ThreadPoolExecutor(len(written), thread_name_prefix="sync") as threads:
        list(threads.map(sync, written))
    return kept


def drop_sources(files: Mapping[str, Path]) -> None:
    """Remove the sources of files that `keep_files` has made durable; they may be gone."""
    for source in files.values():
        source.unlink(missing_ok=True)


def _link_or_copy(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system (the spool is on tmpfs), or one without links
        shutil.copyfile(source, target)
