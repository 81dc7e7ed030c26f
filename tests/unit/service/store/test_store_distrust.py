"""What a backup or a database says is not believed where it would harm: objects, folders, an audit made anew."""

import asyncio
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from support.configurations import REPLAY
from support.extents import first_quick
from support.outcomes import add, measured
from support.rest import particle_files
from typer.testing import CliRunner

from service.base.errors import StoreError
from service.commands.cli import build_app
from service.daemon.retaining import LowThread, Retaining
from service.store import Store, audit, open_store
from service.store.audit import check_chain, entries, kept_digests, next_digest
from service.store.backups import restore
from service.store.reads import results_after
from service.store.retention import Disk, RetentionLimits

Tamper = Callable[[sqlite3.Connection], None]
EMPTY_THE_AUDIT = (
    "DROP TRIGGER audit_is_not_deleted",
    "DELETE FROM audit",
    "CREATE TRIGGER audit_is_not_deleted BEFORE DELETE ON audit BEGIN"
    " SELECT RAISE(ABORT, 'the audit is never edited'); END",
)


def tamper_with(database: Path, tamper: Tamper) -> None:
    with closing(sqlite3.connect(database, isolation_level=None)) as other:
        tamper(other)


def do(*statements: str) -> Tamper:
    def tamper(other: sqlite3.Connection) -> None:
        for statement in statements:
            other.execute(statement)

    return tamper


def make_audit_anew(other: sqlite3.Connection) -> None:
    """Change who did something, and have all digests fit."""
    (guard,) = other.execute("SELECT sql FROM sqlite_schema WHERE name = 'audit_is_not_edited'").fetchone()
    other.execute("DROP TRIGGER audit_is_not_edited")
    other.execute("UPDATE audit SET who = 'key other' WHERE entry = 2")
    digest = ""
    for row in other.execute(
        "SELECT entry, at, who, action, subject, before, after FROM audit ORDER BY entry"
    ).fetchall():
        digest = next_digest(digest, row)
        other.execute("UPDATE audit SET digest = ? WHERE entry = ?", (digest, row[0]))
    other.execute(guard)


async def note(store: Store, n: int) -> None:
    for number in range(n):
        await store.write(audit.note, "key mes", "lot opened", f"L{number}", after={"tonnage_t": number})


@pytest.fixture
async def backup(state_dir: Path, tmp_path: Path) -> Path:
    """Return a backup, made before the newest result and the newest entry of the audit."""
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        await add(store, session, 1, measured(), particle_files(tmp_path / "out"))
        await note(store, 3)
        made = await store.back_up(keep=4)
        await add(store, session, 2, measured())
        await note(store, 1)
    return made


@pytest.mark.parametrize(
    ("tamper", "told"),
    first_quick(
        [
            (
                do("CREATE TRIGGER t AFTER UPDATE ON store BEGIN DELETE FROM answers; END"),
                "trigger 't' of its own",
            ),
            (
                do("CREATE TRIGGER audit AFTER INSERT ON results BEGIN DELETE FROM answers; END"),
                "trigger 'audit'",
            ),
            (do("CREATE VIEW v AS SELECT 1"), "view 'v' of its own"),
            (do("CREATE TABLE t (a)"), "table 't' of its own"),
            (
                do("ALTER TABLE indexed_fields ADD COLUMN c TEXT DEFAULT 'd'"),
                "table indexed_fields is not that of schema",
            ),
            (
                do("ALTER TABLE indexed_fields ADD COLUMN 'c; d' TEXT"),
                "a column of indexed_fields is damaged",
            ),
            (do("DROP TRIGGER audit_is_not_deleted"), "audit_is_not_deleted"),
            (do("DROP TABLE answers", "CREATE VIEW answers AS SELECT 1"), "answers"),
            (do("UPDATE files SET folder = '../../victim', removed = 'age'"), "folder of a particle"),
            (do("UPDATE files SET folder = '/victim'"), "folder of a particle"),
            (do("UPDATE files SET folder = folder || '/..'"), "folder of a particle"),
            (make_audit_anew, "entry 2 of its audit"),
        ]
    ),
)
async def test_a_backup_that_was_tampered_with_is_refused_and_changes_nothing(
    state_dir: Path, backup: Path, tamper: Tamper, told: str
) -> None:
    tamper_with(backup, tamper)
    before = (state_dir / "results.sqlite").read_bytes()
    with pytest.raises(StoreError, match=told):
        await asyncio.to_thread(restore, backup, state_dir)
    assert (state_dir / "results.sqlite").read_bytes() == before
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert (store.last_seq, store.incidents) == (2, [])


async def test_the_audit_says_what_a_restore_took_from_it(state_dir: Path, backup: Path) -> None:
    known = kept_digests(state_dir)
    await asyncio.to_thread(restore, backup, state_dir)
    with await asyncio.to_thread(open_store, state_dir) as store:
        *earlier, newest = await store.read(entries, None, 0, 10)
        assert (newest.action, newest.subject, len(earlier)) == ("backup restored", backup.name, 3)
        assert newest.before == {"entries": 4, "digest": known[3]}
        assert newest.after == {"entries": 3, "digest": known[2]}
        kept = kept_digests(state_dir)
        assert kept[:3] == known[:3]
        assert (await store.read(check_chain, kept)).broken_at is None
        assert len(store.incidents) == 1
    (aside,) = (state_dir / "aside").glob("*-before-restore/audit-digests")
    assert kept_digests(aside.parent) == known


async def test_after_damage_a_backup_is_compared_with_what_was_kept_of_the_damaged_database(
    state_dir: Path, backup: Path, tmp_path: Path
) -> None:
    forged = shutil.copy(backup, tmp_path / "forged.sqlite")
    tamper_with(forged, make_audit_anew)
    (state_dir / "results.sqlite").write_bytes(b"\xa5" * 10_000)
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert [each.action for each in await store.read(entries, None, 0, 10)] == ["history begun anew"]
    with pytest.raises(StoreError, match="entry 2 of its audit"):
        await asyncio.to_thread(restore, forged, state_dir)
    await asyncio.to_thread(restore, backup, state_dir)


async def test_a_backup_of_another_store_is_restored_on_request_alone(
    state_dir: Path, backup: Path, tmp_path: Path
) -> None:
    other_dir = tmp_path / "other"
    with await asyncio.to_thread(open_store, other_dir) as store:
        await note(store, 2)
    with pytest.raises(StoreError, match="--any-audit"):
        await asyncio.to_thread(restore, backup, other_dir)
    config = tmp_path / "stonefall.toml"
    config.write_text(REPLAY.replace('dir = "state"', 'dir = "other"'))
    restoring = ["restore", str(backup), "--config", str(config), "--any-audit"]
    done = await asyncio.to_thread(CliRunner().invoke, build_app(["restore"]), restoring)
    assert (done.exit_code, done.output.startswith("restored")) == (0, True)
    with await asyncio.to_thread(open_store, other_dir) as store:
        assert (await store.read(results_after, 0, 10)).items[0]["seq"] == 1


@pytest.mark.parametrize(
    ("tamper", "broken_at"), [(do(*EMPTY_THE_AUDIT), 1), (make_audit_anew, 2)], ids=["emptied", "made anew"]
)
async def test_an_audit_that_fits_in_itself_is_compared_with_what_was_kept(
    state_dir: Path, tamper: Tamper, broken_at: int
) -> None:
    config = state_dir.parent / "stonefall.toml"
    config.write_text(REPLAY)
    with await asyncio.to_thread(open_store, state_dir) as store:
        await note(store, 3)
        tamper_with(state_dir / "results.sqlite", tamper)
        assert (await store.read(check_chain)).broken_at is None
        await note(store, 1)
        known = kept_digests(state_dir)
        assert (await store.read(check_chain, known)).broken_at == broken_at
        verify = CliRunner().invoke(build_app(["audit"]), ["audit", "verify", "--config", str(config)])
        assert f"entry {broken_at} of the audit" in str(verify.exception)
    with await asyncio.to_thread(open_store, state_dir) as store:
        (incident,) = store.incidents
        assert "The audit of the database lacks" in incident
        (aside,) = (state_dir / "aside").glob("*-audit")
        assert kept_digests(aside) == known
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert len(store.incidents) == 1


async def test_what_is_not_the_folder_of_a_particle_is_not_removed(
    store: Store, session: int, state_dir: Path, tmp_path: Path
) -> None:
    victim = tmp_path / "victim" / "bundle.tiff"
    victim.parent.mkdir()
    victim.write_bytes(b"of another program")
    seq = await add(store, session, 1, measured(), particle_files(tmp_path / "out"))
    tamper_with(state_dir / "results.sqlite", do("UPDATE files SET folder = '../../victim', removed = 'age'"))
    no_recordings: Any = None
    disk = Disk(total_bytes=10**12, free_bytes=10**12)
    retaining = Retaining(
        store,
        no_recordings,
        RetentionLimits(),
        disk_of=lambda _: disk,
        now=lambda: datetime(2026, 3, 1, tzinfo=UTC),
    )
    with LowThread() as thread, pytest.raises(StoreError, match="no folder of a particle"):
        await retaining.step(thread)
    with pytest.raises(StoreError, match="no folder of a particle"):
        await store.raw_path(seq)
    assert victim.exists()
