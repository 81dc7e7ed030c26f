"""A disk that refuses to write holds the store, and nothing else: what falls meanwhile has its outcome afterwards."""

import asyncio
import sqlite3
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from support.eventually import PATIENCE_S
from support.outcomes import add, measured, trigger
from support.rest import particle_files

from pipeline.frames import BundleKind, Trigger
from service.base.errors import StoreError
from service.results.record import lost_record
from service.store import Store, open_store, writer
from service.store.accounting import accounting
from service.store.reads import particle, results_after
from service.store.trouble import TroubleCause


async def until(is_so: Callable[[], bool]) -> None:
    async with asyncio.timeout(PATIENCE_S):
        while not is_so():  # noqa: ASYNC110 - another thread makes it so
            await asyncio.sleep(0.005)


def cause(store: Store) -> TroubleCause | None:
    return None if store.trouble is None else store.trouble.cause


def lost(stone: Trigger) -> dict[str, object]:
    return lost_record(
        stone, bundle="b", reason="store_held", detail="", calibration_id="0123", is_simulated=True
    )


@contextmanager
def locked(state_dir: Path) -> Iterator[None]:
    with closing(sqlite3.connect(state_dir / "results.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        yield
        other.execute("ROLLBACK")


async def test_a_locked_database_holds_and_what_fell_meanwhile_is_counted(
    store: Store, session: int, state_dir: Path
) -> None:
    await store.record_triggers(session, {"1": trigger(1)})
    with locked(state_dir):
        finishing = asyncio.create_task(store.finish(session, "1", measured()))
        await until(lambda: cause(store) is TroubleCause.LOCKED)
        assert "end the program" in str(store.trouble)
        await store.record_triggers(session, {"2": trigger(2)})  # does not wait
        await store.record_triggers(session, {"3": trigger(3, BundleKind.BALL)})
        assert (await store.read(accounting)).triggers == 1  # clients are answered
        assert not finishing.done()
    assert await finishing == 1
    assert store.trouble is None
    assert await store.finish(session, "2", lost(trigger(2))) == 2
    assert await store.finish(session, "3", lost(trigger(3, BundleKind.BALL))) == 3
    counts = await store.read(accounting)
    assert (counts.triggers, counts.measured, counts.by_reason) == (3, 1, {"store_held": 2})
    assert counts.is_balanced
    record = await store.read(particle, 3)
    assert record is not None
    assert (record["kind"], record["sequence"], record["captured_at"]) == (
        "ball",
        3,
        "2026-02-28T23:03:00.000Z",
    )


async def test_a_full_disk_holds_until_there_is_room(
    state_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_full = threading.Event()
    is_full.set()
    connect = writer.connect

    def connect_to_full_disk(path: Path) -> sqlite3.Connection:
        connection = connect(path)
        if is_full.is_set():
            connection.execute("PRAGMA max_page_count = 40")
        return connection

    monkeypatch.setattr(writer, "connect", connect_to_full_disk)
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        files = particle_files(tmp_path / "out")
        finishing = asyncio.create_task(add(store, session, 1, measured(text="x" * 400_000), files))
        await until(lambda: cause(store) is TroubleCause.FULL)
        assert "make room" in str(store.trouble)
        is_full.clear()
        assert await finishing == 1
        assert (await store.read(accounting)).measured == 1
        assert not any(path.exists() for path in files.values())


async def test_files_of_a_particle_that_cannot_be_written_hold(
    store: Store, session: int, tmp_path: Path
) -> None:
    folder = store.particles_dir
    folder.rmdir()
    folder.touch()
    finishing = asyncio.create_task(
        add(store, session, 1, measured(), particle_files(tmp_path / "out")),
    )
    await until(lambda: cause(store) is TroubleCause.UNWRITABLE)
    folder.unlink()
    folder.mkdir()
    assert await finishing == 1
    (kept,) = folder.glob("*/*")
    assert sorted(path.name for path in kept.iterdir()) == ["bundle.tiff", "mesh.ply", "silhouettes.tiff"]


async def test_a_disk_that_does_not_answer_keeps_no_trigger_waiting(
    store: Store, session: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "STALLED_S", 0.01)
    answers = threading.Event()
    hanging = store.write_later(lambda _: answers.wait())
    await store.record_triggers(session, {"1": trigger(1)})
    await until(lambda: store.trouble is not None)
    assert "not answered" in str(store.trouble)
    await store.record_triggers(session, {"2": trigger(2)})
    answers.set()
    await hanging
    assert [await store.finish(session, name, lost(trigger(int(name)))) for name in "12"] == [1, 2]
    assert (await store.read(accounting)).is_balanced


async def test_a_held_store_can_be_closed(state_dir: Path) -> None:
    store = await asyncio.to_thread(open_store, state_dir)
    session = await store.begin_session({})
    await store.record_triggers(session, {"1": trigger(1)})
    with locked(state_dir):
        finishing = asyncio.create_task(store.finish(session, "1", measured()))
        await until(lambda: cause(store) is TroubleCause.LOCKED)
        async with asyncio.timeout(PATIENCE_S):
            await asyncio.to_thread(store.close)
        with pytest.raises(StoreError, match="locked"):
            await finishing
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert (await store.read(accounting)).in_progress == 1


def overwrite_pages(path: Path) -> None:
    """Move everything into the database file, and write garbage over all of its pages but the first."""
    with closing(sqlite3.connect(path)) as other:
        other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with path.open("r+b") as file:
        size = file.seek(0, 2)
        file.seek(4096)
        file.write(b"\xa5" * (size - 4096))


async def test_damage_that_shows_while_running_holds_for_good(state_dir: Path) -> None:
    store = await asyncio.to_thread(open_store, state_dir)
    session = await store.begin_session({})
    await add(store, session, 1, measured())
    overwrite_pages(state_dir / "results.sqlite")
    with pytest.raises(StoreError, match="malformed"):
        await store.read(results_after, 0, 10)
    assert cause(store) is TroubleCause.DAMAGED
    assert "restore a backup" in str(store.trouble)
    await store.record_triggers(session, {"2": trigger(2)})
    finishing = asyncio.create_task(store.finish(session, "2", lost(trigger(2))))
    await asyncio.sleep(0)
    await asyncio.to_thread(store.close)
    with pytest.raises(StoreError, match="malformed"):
        await finishing


async def test_a_record_that_cannot_be_read_holds(store: Store, session: int, state_dir: Path) -> None:
    await add(store, session, 1, measured(text="here"))
    path = state_dir / "results.sqlite"
    with closing(sqlite3.connect(path)) as other:
        other.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    path.write_bytes(path.read_bytes().replace(b'"text": "here"', b'"text": "he\xffe"'))
    with pytest.raises(StoreError):
        await store.read(results_after, 0, 10)
    assert cause(store) is TroubleCause.DAMAGED


async def test_a_database_that_is_replaced_while_running_holds(
    store: Store, session: int, state_dir: Path
) -> None:
    (state_dir / "results.sqlite").rename(state_dir / "elsewhere.sqlite")
    await store.record_triggers(session, {"1": trigger(1)})
    await until(lambda: cause(store) is TroubleCause.DAMAGED)
    assert "removed or replaced" in str(store.trouble)


async def test_raw_frames_that_cannot_be_removed_cost_no_result(state_dir: Path, tmp_path: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir, keep_raw=1) as store:
        session = await store.begin_session({})
        assert await add(store, session, 1, measured(), particle_files(tmp_path / "1")) == 1
        raw = await store.raw_path(1)
        raw.unlink()
        (raw / "in the way").mkdir(parents=True)
        assert await add(store, session, 2, measured()) == 2
        await store.drop_old_raw(1)
        assert store.trouble is None
