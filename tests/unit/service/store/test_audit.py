"""The chain of the audit, and its check offline."""

import sqlite3
from contextlib import closing
from importlib.resources import files
from pathlib import Path
from uuid import UUID

import pytest
from support.configurations import REPLAY
from typer.testing import CliRunner

from service.base.errors import StoreError
from service.commands.cli import build_app
from service.store import Store, audit, open_store
from service.store.audit import check_chain
from service.store.events import events_after


def tamper(state_dir: Path, statement: str) -> None:
    """Change the audit as one does who can write to the file."""
    with closing(sqlite3.connect(state_dir / "results.sqlite")) as other:
        with pytest.raises(sqlite3.IntegrityError, match="never edited"):
            other.execute(statement)
        guards = "FROM sqlite_schema WHERE name IN ('audit_is_not_edited', 'audit_is_not_deleted')"
        there = other.execute(f"SELECT name, sql {guards}").fetchall()
        for name, _ in there:
            other.execute(f"DROP TRIGGER {name}")
        other.execute(statement)
        for _, creation in there:
            other.execute(creation)
        other.commit()


async def note(store: Store, n: int) -> None:
    for number in range(n):
        await store.write(audit.note, "key mes", "lot opened", f"L{number}", after={"tonnage_t": number})


@pytest.mark.parametrize(
    ("statement", "broken_at"),
    [
        ("UPDATE audit SET who = 'key other' WHERE entry = 2", 2),
        ("UPDATE audit SET after = NULL WHERE entry = 4", 4),
        ("DELETE FROM audit WHERE entry = 3", 3),
        ("DELETE FROM audit WHERE entry = 1", 1),
        ("UPDATE audit SET entry = entry + 10 WHERE entry = 4", 4),
        ("UPDATE audit SET digest = NULL, subject = 'L9' WHERE entry = 2", 3),
    ],
)
async def test_an_entry_that_was_changed_breaks_the_chain(
    store: Store, state_dir: Path, statement: str, broken_at: int
) -> None:
    await note(store, 4)
    whole = await store.read(check_chain)
    assert (whole.n_entries, whole.broken_at) == (4, None)
    tamper(state_dir, statement)
    assert (await store.read(check_chain)).broken_at == broken_at


async def test_a_last_entry_that_was_removed_shows_beside_the_digest_of_before(
    store: Store, state_dir: Path
) -> None:
    await note(store, 3)
    before = await store.read(check_chain)
    tamper(state_dir, "DELETE FROM audit WHERE entry = 3")
    after = await store.read(check_chain)
    assert (after.broken_at, after.n_entries) == (None, 2)
    assert after.digest != before.digest


def old_store(state_dir: Path, schema: int) -> sqlite3.Connection:
    """Return the database of an earlier version, written by its scripts."""
    old = sqlite3.connect(state_dir / "results.sqlite", isolation_level=None)
    for number in range(1, schema + 1):
        (script,) = (each for each in files("service.store").iterdir() if each.name[:3] == f"{number:03d}")
        old.executescript(f"{script.read_text(encoding='utf-8')}; PRAGMA user_version = {number}")
    return old


def in_files(content: bytes, state_dir: Path) -> bool:
    """Return whether the database or its WAL has this anywhere."""
    return any(content in path.read_bytes() for path in state_dir.glob("results.sqlite*"))


@pytest.mark.parametrize(
    ("statement", "broken_at"),
    [
        (None, None),
        ("UPDATE audit SET who = 'key other' WHERE entry = 1", 1),
        ("UPDATE audit SET who = 'key other' WHERE entry = 3", 3),
    ],
)
async def test_tokens_in_the_audit_of_an_old_store_go_and_its_chain_says_what_it_said(
    tmp_path: Path, statement: str | None, broken_at: int | None
) -> None:
    with closing(old_store(tmp_path, 12)) as old:
        old.execute("INSERT INTO store (one, instance_id) VALUES (1, ?)", (str(UUID(int=1)),))
        for token in ("the-first", "another"):
            audit.note(old, "key mes", "lot opened", "L1", after={"remark": "http://wiki/a/b"})
            facts = {"webhooks.endpoints": [{"url": f"https://mes/hook/{token}?token={token}"}]}
            audit.note(old, "SIGHUP", "configuration", "stonefall.toml", before=None, after=facts)
    if statement is not None:
        tamper(tmp_path, statement)
    with open_store(tmp_path) as store:
        found = await store.read(audit.entries, None, 0, 10)
        assert [each.action for each in found] == [*2 * ["lot opened", "configuration"], "audit redacted"]
        assert found[0].after == {"remark": "http://wiki/a/b"}  # what people wrote is theirs
        assert found[3].after == {"webhooks.endpoints": [{"url": "https://mes/hook/redacted"}]}
        assert found[4].after == {"digest": found[3].digest, "entries": [2, 4]}
        assert (await store.read(check_chain)).broken_at == broken_at
        if statement is None:
            tamper(tmp_path, "UPDATE audit SET who = 'key other' WHERE entry = 2")  # refused, as before
    assert not in_files(b"the-first", tmp_path)
    with open_store(tmp_path) as store:  # once only
        assert len(await store.read(audit.entries, None, 0, 10)) == 5


@pytest.mark.parametrize("schema", [4, 5])  # 5: the first with digests
async def test_entries_of_an_earlier_version_are_covered_by_the_first_after_them(
    tmp_path: Path, schema: int
) -> None:
    with closing(old_store(tmp_path, schema)) as old:
        entry = (1, "2026-03-01T00:00:00.000Z", "key mes", "lot opened", "L1", None, "{}")
        columns = "entry, at, who, action, subject, before, after"
        old.execute(f"INSERT INTO audit ({columns}) VALUES (?, ?, ?, ?, ?, ?, ?)", entry)  # noqa: S608
    with open_store(tmp_path) as store:
        assert (await store.read(check_chain)).n_entries == 1
        assert (await store.read(events_after, 0, 10)).last_seq == 0
        await note(store, 1)
        assert (await store.read(check_chain)).broken_at is None
        tamper(tmp_path, "UPDATE audit SET subject = 'L9' WHERE entry = 1")
        assert (await store.read(check_chain)).broken_at == 2


async def test_the_command_checks_the_store_of_a_running_daemon(store: Store, state_dir: Path) -> None:
    config = state_dir.parent / "stonefall.toml"
    config.write_text(REPLAY)
    await note(store, 2)
    verify = ["audit", "verify", "--config", str(config)]
    told = CliRunner().invoke(build_app(["audit"]), verify)
    digest = (await store.read(check_chain)).digest
    assert (told.exit_code, told.output) == (0, f"2 entries, whole; digest of the last: {digest}\n")
    tamper(state_dir, "UPDATE audit SET who = 'nobody' WHERE entry = 1")
    refused = CliRunner().invoke(build_app(["audit"]), verify)
    assert isinstance(refused.exception, StoreError)
    assert "entry 1 of the audit" in str(refused.exception)
