"""Look through the folders of particles for those that no result names.

What a result says was removed is deleted: a client, or the archive, wrote it once more meanwhile. Everything else is in
doubt and moved to `aside`, where health reports it.
"""

import shutil
import sqlite3
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path

from service.base import aside
from service.store import history, schema

CHUNK, PAUSE_S = 500, 0.05
"""Folders that are looked at between two pauses: measuring comes first."""


def sweep(state_dir: Path, go_on: Callable[[], bool]) -> None:
    """Look through all folders as long as it may `go_on`; blocks.

    Raises `StoreError` or `OSError` if the database cannot be read, or a folder cannot be moved.
    """
    folders = history.particle_folders(state_dir)
    strays: list[Path] = []
    while go_on() and (chunk := list(islice(folders, CHUNK))):
        removed, unknown = schema.read(state_dir / history.DATABASE, _unnamed, chunk)
        for path in removed:
            shutil.rmtree(path, ignore_errors=True)
        strays += unknown
        time.sleep(PAUSE_S)
    if strays:
        history.move_particles(strays, aside.new_folder(state_dir, "strays"))
    for day in sorted(state_dir.glob(f"{history.PARTICLES}/????-??-??"))[:-1]:  # but today's
        with suppress(OSError):  # it is not empty
            day.rmdir()


def _unnamed(
    connection: sqlite3.Connection, folders: Sequence[tuple[Path, int]]
) -> tuple[list[Path], list[Path]]:
    """Return the folders of removed files, and those that no result names; the next result may be being written."""
    (last_seq,) = connection.execute("SELECT last_seq FROM store").fetchone()
    removed, unknown = [], []
    for path, seq in folders:
        folder = path.name if path.parent.name == history.PARTICLES else f"{path.parent.name}/{path.name}"
        row = connection.execute(
            "SELECT bytes IS NULL FROM results JOIN files USING (seq) WHERE id = ? AND folder = ?",
            (path.name, folder),
        ).fetchone()
        if row is None and seq <= last_seq:
            unknown.append(path)
        elif row is not None and row[0]:
            removed.append(path)
    return removed, unknown
