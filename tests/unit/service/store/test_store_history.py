"""Numbers that were acknowledged are never given again, and nothing is deleted, whatever happens to the database."""

import asyncio
import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from support.extents import first_quick
from support.outcomes import add, measured, rejected
from support.rest import particle_files
from support.store_process import run_until_killed

from service.base.errors import StoreError
from service.store import Store, open_store
from service.store.reads import results_after


async def add_measured(state_dir: Path, count: int, *, with_files: bool = True) -> str:
    """Add results to the store and return its instance_id."""
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        for number in range(1, count + 1):
            files = particle_files(state_dir.parent / "out") if with_files else None
            await add(store, session, number, measured() if with_files else rejected("empty"), files)
        return store.instance_id


def meshes(state_dir: Path) -> dict[str, bytes]:
    """Return every mesh by the name of its particle, wherever it lies."""
    return {path.parent.name: path.read_bytes() for path in state_dir.rglob("mesh.ply")}


async def next_seq(store: Store) -> int:
    return await add(store, await store.begin_session({}), 1, measured())


@pytest.mark.parametrize("with_files", [True, False])
async def test_an_older_copy_in_the_place_of_the_database_begins_a_new_history(
    state_dir: Path, tmp_path: Path, with_files: bool
) -> None:
    before = await add_measured(state_dir, 3, with_files=with_files)
    shutil.copy(state_dir / "results.sqlite", tmp_path)
    await add_measured(state_dir, 4, with_files=with_files)
    folders = {path.name for path in (state_dir / "particles").glob("*/*")}
    shutil.copy(tmp_path / "results.sqlite", state_dir)
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert store.instance_id != before
        (incident,) = store.incidents
        assert "ends at result 3" in incident
        assert store.last_seq >= 7
        assert [item["seq"] for item in (await store.read(results_after, 0, 10)).items] == [1, 2, 3]
        assert await next_seq(store) == 8
        kept = {path.name for path in (state_dir / "particles").glob("*/*")}
        moved = {path.name for path in (state_dir / "aside").glob("*/particles/*")}
        assert kept | moved == folders
        assert len(moved) == (4 if with_files else 0)
        renewed = store.instance_id
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert (store.instance_id, len(store.incidents)) == (renewed, 1)
        shutil.move(state_dir / "aside", tmp_path / "elsewhere")
        assert store.incidents == []


@pytest.mark.parametrize("share", first_quick([0.5, 0.0]))
async def test_a_cut_wal_begins_a_new_history(state_dir: Path, share: float) -> None:
    acknowledged = await asyncio.to_thread(run_until_killed, state_dir, 12)
    with closing(sqlite3.connect(f"{(state_dir / 'results.sqlite').as_uri()}?mode=ro", uri=True)) as reader:
        (before,) = reader.execute("SELECT instance_id FROM store").fetchone()
    wal = state_dir / "results.sqlite-wal"
    os.truncate(wal, int(wal.stat().st_size * share))
    before_meshes = meshes(state_dir)
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert store.instance_id != before
        assert store.last_seq >= max(acknowledged)
        assert await next_seq(store) > max(acknowledged)
        assert meshes(state_dir) == before_meshes


async def test_a_kill_is_no_reason_for_a_new_history(state_dir: Path) -> None:
    await asyncio.to_thread(run_until_killed, state_dir, 5)
    with await asyncio.to_thread(open_store, state_dir) as store:
        before = store.instance_id
        leftover = store.particles_dir / "2026-03-01" / f"{before[:8]}-{store.last_seq + 1:08d}"
        assert store.incidents == []
    leftover.mkdir(parents=True)  # what a kill between files and row leaves
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert (store.instance_id, store.incidents) == (before, [])


@pytest.mark.parametrize("first_page", [True, False])
async def test_a_damaged_database_is_moved_aside_whole(state_dir: Path, first_page: bool) -> None:
    before = await add_measured(state_dir, 5)
    path = state_dir / "results.sqlite"
    with path.open("r+b") as file:
        size = file.seek(0, 2)
        file.seek(0 if first_page else 4096)
        file.write(b"\xa5" * (4096 if first_page else size - 4096))
    damaged = path.read_bytes()
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert store.instance_id != before
        (incident,) = store.incidents
        assert "The database was damaged" in incident
        assert await next_seq(store) == 6
    (kept,) = (state_dir / "aside").glob("*-damaged/results.sqlite")
    assert kept.read_bytes() == damaged
    assert len(list((state_dir / "aside").glob("*-damaged/particles/*"))) == 5


async def test_a_removed_database_does_not_begin_at_one_again(state_dir: Path) -> None:
    await add_measured(state_dir, 2)
    (state_dir / "results.sqlite").unlink()
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert "without a database" in store.incidents[0]
        assert await next_seq(store) == 3


async def test_the_wal_of_a_database_that_is_gone_is_moved_aside(state_dir: Path) -> None:
    await add_measured(state_dir, 2)
    (state_dir / "results.sqlite").unlink()
    (state_dir / "results.sqlite-wal").write_bytes(b"results not in the database yet")
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert await next_seq(store) == 3
    (kept,) = (state_dir / "aside").glob("*-damaged/results.sqlite-wal")
    assert kept.read_bytes() == b"results not in the database yet"


async def test_a_number_is_not_given_again_where_a_crash_comes_while_the_history_begins_anew(
    state_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    await add_measured(state_dir, 2)
    shutil.copy(state_dir / "results.sqlite", tmp_path)
    await add_measured(state_dir, 4)
    shutil.copy(tmp_path / "results.sqlite", state_dir)
    (state_dir / "acknowledged").unlink()

    def crash(path: Path, target: Path) -> None:
        raise OSError(5, "the power fails")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", crash)
        with pytest.raises(StoreError, match="power"):
            open_store(state_dir)
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert await next_seq(store) == 7


def test_a_deleted_lock_file_lets_no_second_process_in(store: Store, state_dir: Path) -> None:
    for path in state_dir.iterdir():
        if path.is_file() and not path.name.startswith("results.sqlite"):
            path.unlink()
    with pytest.raises(StoreError, match="another process"):
        open_store(state_dir)
