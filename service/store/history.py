"""Check at the start that the database still has every result that was acknowledged.

A database can be damaged, and it can be older than what it has acknowledged: its WAL was cut, or a copy was put in its
place. Evidence are the folders of the particles, and the file `acknowledged`, which is written after every
commit. In doubt the history begins anew: a new `instance_id`, numbers beyond all that were seen. Nothing is deleted:
what no longer belongs to the history is moved to `aside/<time>-<why>/`, with a note that says what happened.
"""

import logging
import os
import re
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from pathlib import Path

from drivers.files.durable import read_json, sync, write_json
from service.base import aside
from service.store import audit, schema
from service.store.damage import ALL, N_NEWEST, find_damage
from service.store.events import NEW_HISTORY_STEP
from service.store.particle_files import particle_id, path_of

log = logging.getLogger(__name__)

DATABASE, PARTICLES, BACKUPS = "results.sqlite", "particles", "backups"
RESTORED = f"{DATABASE}.restored"
"""Copy that is completed to take the place of the database."""
ACKNOWLEDGED = "acknowledged"
HAS_KEYS = "has-keys"
"""File that says that there is, or was, a key: if the database is damaged, nothing is open without one."""
DAY = re.compile(r"\d{4}-\d\d-\d\d")
MET = "damage-met"
"""File that says that the last daemon has met damage of the database."""
RESTORING = "restoring"
"""File that says that a restore is to be finished: where what it replaces belongs, and why."""
CHECK_S, FULL_CHECK_S = 10.0, 60.0
"""Longest check of the database at the start, half a million results, and after one that has met damage; every backup
is checked to the end."""
NEWEST_DAYS = 3
"""Folders of days that are searched at each start for results that the database lacks."""


def open_history(state_dir: Path) -> None:
    """Create the database, or check it and begin the history anew in doubt; the caller has the store locked.

    Raises `StoreError` for a newer schema, `sqlite3.Error` or `OSError` if it cannot be read or written now.
    """
    path = state_dir / DATABASE
    finish_restore(state_dir)
    folder: Path | None = None
    is_new = not path.exists()
    moved, is_met = None, (state_dir / MET).exists()
    go_on = _for_seconds(FULL_CHECK_S if is_met else CHECK_S)
    if not is_new and (damage := find_damage(path, go_on, n_newest=ALL if is_met else N_NEWEST)) is not None:
        moved = f"The database was damaged ({damage}) and was moved here."
    elif is_new and path.with_name(f"{DATABASE}-wal").exists():  # of one that was removed, or half moved away
        moved = "The WAL of a database that is gone was moved here."
    if moved is not None:
        folder = aside.new_folder(state_dir, "damaged")
        aside.explain(folder, f"{moved} {_offer(state_dir)}")
        move_database(path, folder)
        is_new = True
    (state_dir / MET).unlink(missing_ok=True)
    known, is_audit_known = audit.kept_digests(state_dir), False
    if not is_new:
        with schema.connect_reader(path) as reader:
            is_audit_known = audit.has_kept(reader, known)
    schema.prepare(path)
    with closing(schema.connect(path)) as connection:
        if loss := _find_loss(connection, state_dir, is_new=is_new):
            folder = folder or aside.new_folder(state_dir, "lost-rows")
            instance_id, highest = renumber(connection, state_dir, "history begun anew", folder.name)
            # first of all: what is moved away is evidence that these numbers were given
            acknowledge(state_dir, instance_id, highest)
            aside.explain(folder, f"{loss} The feed goes on after {highest}, with a new instance_id.")
            _move_strays(connection, state_dir, folder)
        n_kept = len(known)
        if not audit.has_kept(connection, known):
            n_kept = 0
            if is_audit_known:  # a migration made it anew
                (state_dir / audit.DIGESTS).unlink()
            else:
                folder = folder or aside.new_folder(state_dir, "audit")
                lacking = f"lacks some of the {len(known)} entries whose digests are here."
                aside.explain(folder, f"The audit of the database {lacking}")
                (state_dir / audit.DIGESTS).rename(folder / audit.DIGESTS)
        audit.keep_digests(connection, state_dir, n_kept)
        if is_new:
            keep_keys(connection, state_dir, None if folder is None else folder / DATABASE)
        elif connection.execute("SELECT EXISTS (SELECT 1 FROM keys)").fetchone()[0]:
            (state_dir / HAS_KEYS).touch()  # of a copy that was put here
        instance_id, last_seq = connection.execute("SELECT instance_id, last_seq FROM store").fetchone()
    # the folder of the next result, which a crash left without its row, under any day
    name, particles_dir = particle_id(instance_id, last_seq + 1), state_dir / PARTICLES
    for unfinished in (particles_dir / name, *particles_dir.glob(f"????-??-??/{name}")):
        shutil.rmtree(unfinished, ignore_errors=True)


def note_damage(state_dir: Path, detail: str) -> None:
    """Leave a note that a read or a write has met damage: the next start looks at all records for it."""
    with suppress(OSError):
        (state_dir / MET).write_text(f"{detail}\n", encoding="utf-8")


def backups_in(state_dir: Path) -> list[Path]:
    """Return all copies of the database, the oldest first."""
    return sorted((state_dir / BACKUPS).glob("results-*.sqlite"))


def _offer(state_dir: Path) -> str:
    """Return a sentence that names the newest backup without damage, with the number of its last result."""
    go_on = _for_seconds(CHECK_S)
    for path in reversed(backups_in(state_dir)):
        with suppress(sqlite3.Error, OSError):
            if find_damage(path, go_on) is None:
                with schema.connect_reader(path) as connection:
                    (last_seq,) = connection.execute("SELECT last_seq FROM store").fetchone()
                name = path.relative_to(state_dir)
                return f"The newest good backup is {name}, up to result {last_seq}: stonefall restore."
    return "There is no good backup."


def _for_seconds(seconds: float) -> Callable[[], bool]:
    deadline_s = time.monotonic() + seconds
    return lambda: time.monotonic() < deadline_s


def renumber(
    connection: sqlite3.Connection, state_dir: Path, action: str, subject: str, *, beyond: int = 0
) -> tuple[str, int]:
    """Give the history a new identity and numbers beyond all that were seen, as the audit says; return both."""
    (last_seq,) = connection.execute("SELECT last_seq FROM store").fetchone()
    highest = max(last_seq, acknowledged(state_dir)[1], _highest_in_folders(state_dir), beyond)
    instance_id = schema.new_instance()
    known = audit.kept_digests(state_dir)
    chain = audit.check_chain(connection)
    with schema.transaction(connection):
        connection.execute(
            "UPDATE store SET instance_id = ?, last_seq = ?, last_event = last_event + ?",
            (instance_id, highest, NEW_HISTORY_STEP),
        )
        before = {"entries": len(known), "digest": known[-1] if known else ""}
        after = {"entries": chain.n_entries, "digest": chain.digest}
        audit.note(connection, "stonefall", action, subject, before=before, after=after)
    return instance_id, highest


def keep_keys(connection: sqlite3.Connection, state_dir: Path, former: Path | None) -> None:
    """Take the keys from the database whose place another one takes; note that they are lost where they cannot be read.

    Where none was ever made, none is lost. The keys of a copy are used only then. Sessions of browsers end, as some may
    have been ended since the copy.
    """
    connection.execute("DELETE FROM browser_sessions")
    connection.execute("DELETE FROM pairings")
    connection.execute("UPDATE store SET keys_lost = ?", ((state_dir / HAS_KEYS).exists(),))
    if former is None or not former.is_file():  # a pipe would wait for a writer
        return
    # whatever a damaged database raises
    with suppress(Exception), schema.connect_reader(former) as reader, schema.transaction(connection):
        keys = reader.execute("SELECT * FROM keys ORDER BY rowid").fetchall()
        (is_lost,) = reader.execute("SELECT keys_lost FROM store").fetchone() or (1,)
        if not is_lost:
            connection.execute("DELETE FROM keys")
        # of an earlier release without `is_display`
        rows = [(*key, 0)[:9] for key in keys]
        connection.executemany("INSERT OR REPLACE INTO keys VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", rows)
        connection.execute("UPDATE store SET keys_lost = ?", (is_lost,))


def _move_strays(connection: sqlite3.Connection, state_dir: Path, folder: Path) -> None:
    """Move the folders of particles that have no result."""
    ids = "SELECT 1 FROM results WHERE id = ?"
    folders = (path for path, _ in particle_folders(state_dir))
    move_particles([path for path in folders if not connection.execute(ids, (path.name,)).fetchone()], folder)


def switch_later(state_dir: Path, why: str) -> None:
    """Note durably that the finished copy is to take the place of the database, which `finish_restore` does."""
    write_json(state_dir / RESTORING, {"folder": aside.folder_name("before-restore"), "why": why})


def finish_restore(state_dir: Path) -> tuple[Path, int] | None:
    """Put the copy of a noted restore in the place of the database, then move the folders of particles to fit it.

    Each step can be repeated after a kill. Returns where the former database is, and how many folders were taken back;
    None if no restore was noted, when the copy of one that was killed before is removed. Raises `sqlite3.Error` or
    `OSError` if the disk refuses.
    """
    path, copy, noted = state_dir / DATABASE, state_dir / RESTORED, state_dir / RESTORING
    if not noted.exists():
        for left in (*state_dir.glob(f"{copy.name}*"), *state_dir.glob(f"{noted.name}*")):
            left.unlink()
        return None
    note = read_json(noted)
    folder: Path = state_dir / aside.ASIDE / note["folder"]
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / aside.NOTE).exists():
        aside.explain(folder, note["why"])
    if copy.exists():  # until then, the files of this name are those of the former database
        move_database(path, folder)
        copy.rename(path)
        sync(state_dir)
    with closing(schema.connect(path)) as connection:
        acknowledge(state_dir, *connection.execute("SELECT instance_id, last_seq FROM store").fetchone())
        _move_strays(connection, state_dir, folder)
        n_back = take_back(connection, state_dir)
    noted.unlink()
    sync(state_dir)
    return folder, n_back


def move_particles(paths: Sequence[Path], folder: Path) -> None:
    """Move folders of particles without a result into `folder`, side by side."""
    if not paths:
        return
    (folder / PARTICLES).mkdir(exist_ok=True)
    for path in paths:
        path.rename(folder / PARTICLES / path.name)
    aside.explain(folder, f"{len(paths)} folders of particles without a result were moved here.")


def take_back(connection: sqlite3.Connection, state_dir: Path) -> int:
    """Move folders of particles that have a result again back from `aside`; return how many these were."""
    n_back = 0
    for path in (state_dir / aside.ASIDE).glob(f"*/{PARTICLES}/*"):
        row = connection.execute(
            "SELECT folder FROM files JOIN results USING (seq) WHERE id = ? AND removed IS NULL", (path.name,)
        ).fetchone()
        if row is not None and not (target := path_of(state_dir / PARTICLES, row[0])).exists():
            target.parent.mkdir(exist_ok=True)
            path.rename(target)
            n_back += 1
    return n_back


def move_database(path: Path, folder: Path) -> None:
    """Move a database into a folder, with the files of its WAL and the digests of its audit."""
    for name in (path.name, f"{path.name}-wal", f"{path.name}-shm", audit.DIGESTS):
        if (source := path.with_name(name)).exists():
            source.rename(folder / name)
    sync(folder)
    sync(path.parent)


def acknowledge(state_dir: Path, instance_id: str, seq: int) -> None:
    """Note beside the database up to which number results are acknowledged; not flushed, so it may be behind."""
    descriptor = os.open(state_dir / ACKNOWLEDGED, os.O_WRONLY | os.O_CREAT, 0o640)
    try:
        os.pwrite(descriptor, f"{instance_id} {seq:016d}\n".encode(), 0)  # of one length, in place
    finally:
        os.close(descriptor)


def acknowledged(state_dir: Path) -> tuple[str | None, int]:
    """Return the history and the number noted by `acknowledge`; None and 0 without a readable note."""
    try:
        instance_id, seq = (state_dir / ACKNOWLEDGED).read_text(encoding="ascii").split()
        return instance_id, int(seq)
    except (OSError, ValueError):
        return None, 0


def _find_loss(connection: sqlite3.Connection, state_dir: Path, *, is_new: bool) -> str | None:
    """Return the evidence that the database lacks acknowledged results, None without any."""
    instance_id, last_seq = connection.execute("SELECT instance_id, last_seq FROM store").fetchone()
    noted_id, noted_seq = acknowledged(state_dir)
    if is_new:
        seen = max(noted_seq, _highest_in_folders(state_dir))
        return f"There were results up to {seen} without a database." if seen else None
    if noted_id not in (None, instance_id):
        return f"The database is of another history than the results acknowledged up to {noted_seq}."
    newest = particle_folders(state_dir, newest_days=NEWEST_DAYS)
    own = (seq for path, seq in newest if path.name.startswith(instance_id[:8]))
    # a crash leaves the folder of the next result, without its row
    seen = max(noted_seq, max(own, default=0) - 1)
    if seen > last_seq:
        return f"The database ends at result {last_seq}, and results up to {seen} at least were acknowledged."
    return None


def _highest_in_folders(state_dir: Path) -> int:
    return max((seq for _, seq in particle_folders(state_dir)), default=0)


def particle_folders(state_dir: Path, newest_days: int | None = None) -> Iterator[tuple[Path, int]]:
    """Yield the folders of particles, each with its number: side by side as once, and those of the (newest) days."""
    particles_dir = state_dir / PARTICLES
    days = sorted((path for path in particles_dir.iterdir() if DAY.fullmatch(path.name)), reverse=True)
    for folder in (particles_dir, *days[:newest_days]):
        with suppress(FileNotFoundError):  # retention removed the last of it
            for path in folder.iterdir():
                number = path.name.rpartition("-")[2]
                if number.isdigit() and not DAY.fullmatch(path.name):
                    yield path, int(number)
