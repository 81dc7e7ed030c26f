"""Whatever is damaged in a database that nobody has open, the next start serves, or says why not in one line."""

import asyncio
import os
import random
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.eventually import PATIENCE_S
from support.extents import examples, first_quick
from support.outcomes import add, lose_open, measured, rejected, trigger

from service.base.errors import StoreError
from service.health.alarms.alarms import open_alarms
from service.results.fields import LossReason
from service.store import history, open_store
from service.store.accounting import accounting
from service.store.audit import note
from service.store.event_log import EventLog
from service.store.events import EventType, NewEvent
from service.store.reads import gate_count, open_triggers, results_after
from service.store.retention import Disk, RetentionLimits, mark_files, remove_results
from service.store.trouble import TroubleCause

N_RESULTS = 12
PAGE_BYTES = 4096
INFO = {"calibration_id": "0123", "is_simulated": True}


async def fill(state_dir: Path) -> None:
    """Leave a database with rows in the tables that a start reads."""
    mesh = state_dir.parent / "mesh.ply"
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session(INFO)
        for number in range(N_RESULTS):
            if number % 3:
                mesh.write_bytes(b"mesh")
                await add(
                    store,
                    session,
                    number,
                    measured(text=f"stone {number:02d} {'x' * 2000}"),
                    {"mesh.ply": mesh},
                )
            else:
                await add(store, session, number, rejected("empty"))
        await store.record_triggers(session, {"open": trigger(98), "left": trigger(99)})
        for number in range(5):
            await store.write(note, "key mes", "lot opened", f"L{number}", after={"tonnage_t": number})
        events = EventLog(store)
        events.note(*(NewEvent(type=EventType.LOT_OPENED, subject=f"L{number}") for number in range(9)))
        await events.written()


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    state_dir = tmp_path_factory.mktemp("damage") / "state"
    asyncio.run(fill(state_dir))
    return state_dir


@pytest.fixture
def state_dir(filled: Path, tmp_path: Path) -> Path:
    """Return a copy of the filled store, for one test."""
    return shutil.copytree(filled, tmp_path / "state")


async def start_and_serve(state_dir: Path) -> list[str]:
    """Do with the store what the start of a daemon does, then measure a stone; return the incidents."""
    with await asyncio.to_thread(open_store, state_dir) as store:
        async with asyncio.timeout(PATIENCE_S):  # a store that is held waits
            session = await store.begin_session(INFO)
            await store.read(open_triggers, store.session, [])
            await lose_open(store, LossReason.CRASH, "the daemon ended")
            await store.read(gate_count)
            await open_alarms(store, EventLog(store))
            seq = await add(store, session, 1, measured())
            assert (await store.read(results_after, 0, 1000)).items[-1]["seq"] == seq
            assert (await store.read(accounting)).is_balanced
            limits, now = RetentionLimits(files_days=1, results_days=1), datetime.now(UTC)
            await store.write(mark_files, limits, Disk(10**12, 10**12), now)
            await store.write(remove_results, limits, now)
        assert store.trouble is None
        return store.incidents


def damage_at_random(database: Path, seed: int) -> None:
    """Write over bytes anywhere, over bytes of the first pages, or cut the file."""
    chance = random.Random(seed)  # noqa: S311 - no secret
    content = bytearray(database.read_bytes())
    if seed % 4 == 3:
        content = content[: chance.randrange(len(content))]
    else:
        end = len(content) if seed % 4 else 3 * PAGE_BYTES
        for _ in range(chance.choice((1, 3, 30, 300))):
            content[chance.randrange(end)] = chance.randrange(256)
    database.write_bytes(content)


@given(seed=st.integers(0, 1 << 32))
@examples(2)
def test_a_start_after_random_damage_serves_or_says_why_not_and_deletes_nothing(
    filled: Path, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    state_dir = shutil.copytree(filled, tmp_path_factory.mktemp("flipped") / "state")
    database = state_dir / "results.sqlite"
    damage_at_random(database, seed)
    damaged, meshes = database.read_bytes(), len(list(state_dir.rglob("mesh.ply")))
    try:
        incidents = asyncio.run(start_and_serve(state_dir))
    except StoreError as err:
        assert "\n" not in str(err)
        assert database.read_bytes() == damaged
    else:
        aside = list((state_dir / "aside").glob("*-damaged/results.sqlite"))
        assert [path.read_bytes() for path in aside] == ([damaged] if aside else [])
        assert bool(incidents) or not aside
    assert len(list(state_dir.rglob("mesh.ply"))) == meshes
    shutil.rmtree(state_dir.parent)


def put_over(old: bytes, new: bytes, *, last: bool = False) -> Callable[[Path], None]:
    def damage(database: Path) -> None:
        content = database.read_bytes()
        at = content.rindex(old) if last else content.index(old)
        database.write_bytes(content[:at] + new + content[at + len(new) :])

    return damage


def do(*statements: str) -> Callable[[Path], None]:
    def damage(database: Path) -> None:
        with closing(sqlite3.connect(database, isolation_level=None)) as other:
            for statement in statements:
                other.execute(statement)

    return damage


def flip_identity(database: Path) -> None:
    with closing(sqlite3.connect(database)) as other:
        (instance_id,) = other.execute("SELECT instance_id FROM store").fetchone()
    put_over(instance_id.encode(), b"\x87")(database)


@pytest.mark.parametrize(
    "damage",
    first_quick(
        [
            put_over(b"CREATE TABLE", b"CREATE\x9cTABLE"),  # its message is no text, either
            flip_identity,
            put_over(b'"calibration_id"', b"\x01", last=True),  # SQLite takes it for JSON
            put_over(b'"calibration_id"', b"\xff"),
            do("UPDATE sessions SET info = 'null'"),
            do("UPDATE triggers SET captured_at = 'noon' WHERE state = 'open'"),
            do("UPDATE store SET last_seq = 3"),
            do("PRAGMA user_version = 9"),
            do("PRAGMA user_version = -1"),
            do("DROP TABLE indexed_fields"),
            do("DROP TABLE alarms"),
            do("DROP TABLE events"),
            do("DROP TRIGGER audit_is_not_edited"),
        ]
    ),
)
async def test_what_sqlite_does_not_check_is_damage_too_and_the_newest_good_backup_is_offered(
    state_dir: Path, damage: Callable[[Path], None]
) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        good = await store.back_up(keep=4)
    (good.parent / "results-29990101T000000Z.sqlite").write_bytes(b"no database " * 1000)
    damage(state_dir / "results.sqlite")
    (incident,) = await start_and_serve(state_dir)
    assert "The database was damaged" in incident
    assert f"The newest good backup is backups/{good.name}, up to result {N_RESULTS}" in incident
    assert len(list((state_dir / "aside").glob("*-damaged/results.sqlite"))) == 1
    assert len(await start_and_serve(state_dir)) == 1


@pytest.mark.parametrize("kind", [os.mkfifo, Path.mkdir])
async def test_what_lies_in_the_place_of_the_database_and_is_no_file_is_moved_aside(
    state_dir: Path, kind: Callable[[Path], None]
) -> None:
    """A start waited for ever for somebody to write into a pipe of that name."""
    with await asyncio.to_thread(open_store, state_dir):
        pass
    (state_dir / "results.sqlite").unlink()
    kind(state_dir / "results.sqlite")
    (incident,) = await start_and_serve(state_dir)
    assert "The database was damaged (it is no file) and was moved here." in incident


async def test_damage_of_an_old_record_holds_the_store_and_the_next_start_finds_it(
    state_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(history, "N_NEWEST", 2)
    put_over(b"stone 01", b"\x01")(state_dir / "results.sqlite")
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert store.incidents == []
        with pytest.raises(StoreError):
            await store.read(results_after, 0, 10)
        assert store.trouble is not None
        assert store.trouble.cause is TroubleCause.DAMAGED
    assert "results" in (await start_and_serve(state_dir))[0]
    assert len(await start_and_serve(state_dir)) == 1


async def test_a_write_that_meets_a_damaged_record_holds_the_store(state_dir: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        await store.begin_session(INFO)
        do("UPDATE sessions SET info = 'torn' WHERE session = 1")(state_dir / "results.sqlite")
        losing = asyncio.create_task(lose_open(store, LossReason.CRASH, ""))
        async with asyncio.timeout(PATIENCE_S):
            while store.trouble is None:  # noqa: ASYNC110 - another thread makes it so
                await asyncio.sleep(0.005)
        assert store.trouble.cause is TroubleCause.DAMAGED
    with pytest.raises(StoreError, match="a record is damaged"):
        await losing


async def test_an_alarm_that_cannot_be_read_does_not_stop_the_start(state_dir: Path) -> None:
    do("INSERT INTO alarms VALUES (1, 'disk', 'unacknowledged', NULL, '{\"check\": 1}')")(
        state_dir / "results.sqlite"
    )
    assert await start_and_serve(state_dir) == []
