"""The files of a particle, `particles/<id>/`: on the disk before the row that speaks of them.

A folder without a row is what a crash left between the two; it is invisible, and whoever gets its number
next removes it. Raw frames are large, so only those of the newest results stay.
"""

import os
import shutil
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from drivers.files.durable import sync, unfinished

RAW = "bundle.tiff"


def particle_id(instance_id: str, seq: int) -> str:
    """Unique across stores; in the order of `seq`."""
    return f"{instance_id[:8]}-{seq:08d}"


def raw_frames(particles_dir: Path, instance_id: str, seq: int) -> Path:
    """Where a result's frames are, if they are kept."""
    return particles_dir / particle_id(instance_id, seq) / RAW


def drop_raw(particles_dir: Path, instance_id: str, seq: int) -> None:
    """Remove the frames of a result, and what a daemon left that was killed while it wrote them."""
    path = raw_frames(particles_dir, instance_id, seq)
    for each in (path, unfinished(path)):
        each.unlink(missing_ok=True)


def keep_files(folder: Path, files: Mapping[str, Path]) -> None:
    """Bring `files` (a name in `folder` each) there, durably.

    The sources stay until `drop_sources`, so that a transaction that fails afterwards can be repeated.
    """
    shutil.rmtree(folder, ignore_errors=True)
    if not files:
        return
    folder.mkdir()
    for name, source in files.items():
        _bring(source, folder / name)
    # at once: the device flushes for all of them what it would flush for each
    written = [*(folder / name for name in files), folder, folder.parent]
    with ThreadPoolExecutor(len(written), thread_name_prefix="sync") as each:
        list(each.map(sync, written))


def drop_sources(files: Mapping[str, Path]) -> None:
    """Remove what `keep_files` has brought to safety."""
    for source in files.values():
        source.unlink()


def _bring(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system (the spool is on tmpfs), or one without links
        shutil.copyfile(source, target)
