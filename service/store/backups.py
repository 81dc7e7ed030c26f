"""Copies of the database: made while it is written, checked, and restored.

A copy has every result and every count, not the files of the particles, which stay where they are.
"""

import os
import shutil
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing, suppress
from datetime import UTC, datetime
from pathlib import Path

from drivers.files.durable import replacing, sync
from service.base import aside
from service.base.errors import StoreError
from service.store import audit, history, schema
from service.store.damage import ALL, find_damage
from service.store.trouble import TroubleCause, trouble_of

STATISTICS = "sqlite_stat"
"""Begins the names of the tables that `ANALYZE` makes."""
PAGES, PAUSE_S = 1000, 0.01
"""Copied at a time, 4 MB, and the pause before the next: measuring comes first."""
ROOM_BYTES = 1 << 30
"""Free space that a copy must leave for results."""


class DamagedStoreError(StoreError):
    """The copy of the database is damaged, and so is the database."""


def backup_path(state_dir: Path) -> Path:
    """Return where a copy made now belongs."""
    return state_dir / history.BACKUPS / f"results-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.sqlite"


def back_up(state_dir: Path, target: Path, go_on: Callable[[], bool] = lambda: True) -> None:
    """Copy the database, as it is at one moment, durably to `target`; a daemon may be writing to it.

    Raises `StoreError` if there is no database or no room, it is damaged, or `go_on` returned False.
    """
    path = state_dir / history.DATABASE
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        needed_bytes, free_bytes = path.stat().st_size + ROOM_BYTES, shutil.disk_usage(target.parent).free
        if free_bytes < needed_bytes:
            needed, free = (f"{n_bytes / 1e9:.1f} GB" for n_bytes in (needed_bytes, free_bytes))
            raise StoreError(f"no backup of {path}: it needs {needed}, and {free} are free")
        with replacing(target) as unfinished:
            _copy(path, unfinished, go_on)
            if (damage := find_damage(unfinished, go_on)) is not None:
                raise DamagedStoreError(f"the database is damaged: {damage}")
            if not go_on():
                raise StoreError(f"no backup of {path}: the daemon stops")
    except (sqlite3.Error, OSError, ValueError) as err:
        trouble = trouble_of(err)
        is_damaged = trouble is not None and trouble.cause is TroubleCause.DAMAGED
        kind = DamagedStoreError if is_damaged else StoreError
        raise kind(f"no backup of {path} to {target}: {err}") from err


def prune(state_dir: Path, keep: int, made: Path) -> None:
    """Remove all copies but `keep`: the one just `made`, even if the clock was set, and the newest others.

    What a backup that was killed has left goes too.
    """
    others = [path for path in reversed(history.backups_in(state_dir)) if path != made]
    unfinished = (state_dir / history.BACKUPS).glob("results-*.sqlite.tmp*")
    for path in (*others[keep - 1 :], *unfinished):
        path.unlink(missing_ok=True)


def restore(source: Path, state_dir: Path, *, any_audit: bool = False) -> str:
    """Put a copy in the place of the database, and return what was done.

    The history begins anew, with a new `instance_id`; the database that was there is moved to `aside`. A copy is not
    trusted: it must have the schema of its version and nothing else, and unless `any_audit` an audit that this store
    has had, as the digests kept beside its databases tell. Raises `StoreError` if a daemon is running, or the copy is
    not a database of results, or was tampered with.
    """
    state_dir.joinpath(history.PARTICLES).mkdir(parents=True, exist_ok=True)
    lock = schema.lock_store(state_dir)
    try:
        return _restore(source, state_dir, any_audit=any_audit)
    except (sqlite3.Error, OSError, ValueError) as err:
        raise StoreError(f"{source} is not restored to {state_dir}: {err}") from err
    finally:
        os.close(lock)


def _restore(source: Path, state_dir: Path, *, any_audit: bool) -> str:
    history.finish_restore(state_dir)  # of an earlier one that was killed
    if not source.is_file():
        raise StoreError(f"{source}: is no file")  # a device would fill the disk
    with replacing(state_dir / history.RESTORED) as unfinished:
        shutil.copyfile(source, unfinished)
        _require_backup(source, unfinished)
        schema.prepare(unfinished)
        with closing(schema.connect(unfinished)) as connection:
            if not any_audit:
                _require_own_audit(source, connection, state_dir)
            beyond, database = 0, state_dir / history.DATABASE
            if database.exists():
                history.keep_keys(connection, state_dir, database)
            # but if there is none, or it cannot be read
            with suppress(sqlite3.Error, TypeError, ValueError), schema.connect_reader(database) as former:
                beyond = int(former.execute("SELECT last_seq FROM store").fetchone()[0])
            _, highest = history.renumber(
                connection, state_dir, "backup restored", source.name, beyond=beyond
            )
            connection.execute("PRAGMA journal_mode = DELETE")  # so that it is one file
    why = f"The backup {source} was restored. The feed goes on after {highest}, with a new instance_id."
    history.switch_later(state_dir, why)
    done = history.finish_restore(state_dir)
    if done is None:
        raise StoreError(f"{source} is not restored to {state_dir}: its note is gone")
    folder, n_back = done
    return f"restored; what was there before is in {folder}; folders of particles taken back: {n_back}"


def _copy(path: Path, target: Path, go_on: Callable[[], bool]) -> None:
    def progress(status: int, remaining: int, total: int) -> None:
        if not go_on():
            raise StoreError(f"no backup of {path}: the daemon stops")
        if target.exists():
            sync(target)  # step by step: at the end, results would wait for all of it
        time.sleep(PAUSE_S)

    with schema.connect_reader(path) as source, closing(sqlite3.connect(target)) as copy:
        source.execute("SELECT * FROM store")  # from here on it sees one state, whatever is written meanwhile
        source.backup(copy, pages=PAGES, progress=progress)
        copy.execute("PRAGMA journal_mode = DELETE")  # so that it is one file


def _require_backup(source: Path, copy: Path) -> None:
    """Raise `StoreError` unless the copy of a backup has the schema of its version, nothing else, and no damage."""
    if (damage := find_damage(copy, n_newest=ALL)) is not None:
        raise StoreError(f"{source}: is damaged: {damage}")
    with schema.connect_reader(copy) as connection:
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        found = schema.objects(connection)
        if version == 0 or ("table", "store") not in found:
            raise StoreError(f"{source}: is not a database of results")
        expected = schema.expected_objects(min(version, schema.newest_version()))
        foreign = sorted(
            each for each in found if each not in expected and not each[1].startswith(STATISTICS)
        )
        if foreign and version <= schema.newest_version():  # a newer one is refused with its number
            kind, name = foreign[0]
            raise StoreError(f"{source}: was tampered with: it has a {kind} {name!r} of its own")


def _require_own_audit(source: Path, connection: sqlite3.Connection, state_dir: Path) -> None:
    """Raise `StoreError` unless the audit of a backup begins like one whose digests this store has kept."""
    chain = audit.check_chain(connection)
    folders = (state_dir, *(state_dir / aside.ASIDE).glob("*"))
    kept = [digests[: chain.n_entries] for folder in folders if (digests := audit.kept_digests(folder))]
    broken_at = [audit.check_chain(connection, digests).broken_at for digests in kept] or [chain.broken_at]
    if None not in broken_at:
        raise StoreError(
            f"{source}: was tampered with, or is of another store: entry {max(filter(None, broken_at))} of its audit is"
            " not in this store's; with --any-audit it is restored all the same"
        )
