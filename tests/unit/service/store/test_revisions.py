"""A revision is a later item of the feed that changes neither the first result nor the accounting."""

import asyncio
import shutil
import sqlite3
from contextlib import closing
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
import trimesh
from support.outcomes import add, measured, rejected
from support.rest import particle_files
from support.stores import folder_of

from service.lots.lots import LotDefinition, assign, close_lot, find_lot, open_lot
from service.lots.products import ProductDefinition, save_product
from service.lots.stones import stones_between, stones_of_lot
from service.remeasuring.jobs import RemeasureError, revise
from service.results.fields import RUSH
from service.store import ParticleFilter, Store, open_store
from service.store.accounting import accounting
from service.store.audit import entries
from service.store.backups import restore
from service.store.events import events_after
from service.store.reads import newest_folder, particle, particles, results_after, seq_before
from service.store.retention import (
    Disk,
    RetentionLimits,
    files_going,
    mark_files,
    note_gone,
    pin,
    remove_results,
)
from service.store.sweep import sweep

WIDE = Disk(total_bytes=10**12, free_bytes=10**11)
LATER = datetime.now(UTC) + timedelta(days=40)
EVER = ("2000-01-01T00:00:00.000Z", "2100-01-01T00:00:00.000Z")
SIZES = ("max_feret_mm", "min_feret_mm", "length_mm", "width_mm", "thickness_mm")


def stone(size_mm: float, **fields: Any) -> dict[str, Any]:
    """Return the record of a stone, as far as a lot reads it."""
    sizes = dict.fromkeys(SIZES, size_mm)
    return measured(sieve_size_mm=size_mm, volume_mm3=size_mm**3, volume_sd_percent=1.0, **sizes, **fields)


async def id_of(store: Store, seq: int) -> str:
    found = await store.read(particle, seq)
    assert found is not None
    return str(found["id"])


async def revised(store: Store, seq: int, record: dict[str, Any], folder: Path) -> int:
    """Revise the stone of this first result, with another mesh, and return the number of the item."""
    await asyncio.to_thread(write_mesh, folder)
    before = await store.read(particle, await id_of(store, seq))
    assert before is not None
    assert await revise(store, before, record, folder, "anna")
    return store.last_seq


def write_mesh(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    trimesh.creation.box((1.0, 1.0, 1.0)).export(folder / "mesh.ply")


def migrations() -> list[str]:
    scripts = [entry for entry in files("service.store").iterdir() if entry.name.endswith(".sql")]
    return [script.read_text(encoding="utf-8") for script in sorted(scripts, key=lambda entry: entry.name)]


def size_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*.*"))


def with_frames(state_dir: Path) -> list[int]:
    return sorted(int(path.parent.name[-8:]) for path in state_dir.glob("particles/*/*/bundle.tiff"))


@pytest.fixture
async def filled(store: Store, session: int, tmp_path: Path) -> Store:
    """Return a store with three stones of 10 mm, the second of which has a revision of 12 mm, item 4."""
    for number in (1, 2, 3):
        await add(
            store, session, number, stone(10.0, verification="passed"), particle_files(tmp_path / "out")
        )
    assert await revised(store, 2, stone(12.0, verification=None), tmp_path / "again") == 4
    return store


async def test_a_revision_is_a_new_item_of_the_same_stone(filled: Store) -> None:
    items = (await filled.read(results_after, 0, 10)).items
    assert [(item["seq"], item.get("revision"), item.get("revises")) for item in items] == [
        (1, 1, None), (2, 1, None), (3, 1, None), (4, 2, 2),
    ]  # fmt: skip
    first, again = items[1], items[3]
    of_the_stone = ("id", "session", "bundle", "sequence", "captured_at", "is_replay", "verification")
    assert {name: again[name] for name in of_the_stone} == {name: first[name] for name in of_the_stone}
    assert (first["sieve_size_mm"], again["sieve_size_mm"]) == (10.0, 12.0)
    assert again["recorded_at"] >= first["recorded_at"]
    assert await filled.read(particle, first["id"]) == await filled.read(particle, 4) == again
    assert await filled.read(particle, 2) == first
    assert [item["seq"] for item in (await filled.read(results_after, 1, 2)).items] == [2, 3]
    assert filled.last_seq == 4
    assert await filled.read(seq_before, again["recorded_at"]) == 3
    assert await filled.read(seq_before, EVER[0]) == 0
    assert await filled.read(seq_before, EVER[1]) == 4


async def test_a_second_revision_follows_the_first(filled: Store, tmp_path: Path) -> None:
    assert await revised(filled, 2, rejected("clipped"), tmp_path / "again") == 5
    newest = await filled.read(particle, await id_of(filled, 2))
    assert newest is not None
    assert (newest["revision"], newest["revises"], newest["outcome"]) == (3, 4, "rejected")


async def test_counts_and_balance_stay(store: Store, session: int, tmp_path: Path) -> None:
    await add(store, session, 1, stone(10.0), particle_files(tmp_path / "out"))
    await add(store, session, 2, rejected("empty"), particle_files(tmp_path / "out"))
    before = await store.read(accounting, session)
    await revised(store, 1, rejected("clipped"), tmp_path / "again")
    await revised(store, 2, stone(11.0), tmp_path / "again")
    assert await store.read(accounting, session) == await store.read(accounting) == before
    assert before.is_balanced
    assert await add(store, session, 3, stone(9.0)) == 5  # numbers go on after the revisions


async def test_stones_windows_and_lists_are_of_the_newest_revision(filled: Store, tmp_path: Path) -> None:
    window = await filled.read(stones_between, *EVER)
    assert sorted(window.lot.column("sieve_size_mm")) == [10.0, 10.0, 12.0]

    async def listed(**wanted: Any) -> list[int]:
        return [each["seq"] for each in await filled.read(particles, ParticleFilter(**wanted), None, 10)]

    assert await listed() == [3, 4, 1]  # in the order of the stones
    assert await listed(min_sieve_size_mm=11) == [4]
    assert await listed(max_sieve_size_mm=11) == [3, 1]
    await revised(filled, 2, rejected("clipped"), tmp_path / "again")
    assert await listed(outcome="rejected") == [5]
    assert await listed(quality="good") == [3, 1]
    assert [each["seq"] for each in await filled.read(particles, ParticleFilter(), 2, 10)] == [1]


async def test_a_stone_that_is_refined_afterwards_counts_as_refined(
    store: Store, session: int, tmp_path: Path
) -> None:
    rushed = stone(10.0, body="estimate", refinement_fallback=RUSH)
    plain = stone(10.0, body="estimate", refinement_fallback="no texture that the views share")
    for number, record in enumerate((rushed, rushed, plain, stone(10.0, body="photo"), stone(9.0)), 1):
        await add(store, session, number, record, particle_files(tmp_path / "out"))
    before = await store.read(stones_between, *EVER)
    assert before.by_body == {"estimate": 3, "photo": 1}  # of the last one it is not known
    assert before.not_refined == {"rush": 2, "no_evidence": 1}
    await revised(store, 1, stone(10.0, body="photo", refinement_fallback=None), tmp_path / "again")
    after = await store.read(stones_between, *EVER)
    assert (after.by_body, after.not_refined) == (
        {"photo": 2, "estimate": 2},
        {"rush": 1, "no_evidence": 1},
    )


async def test_stones_of_an_earlier_schema_tell_their_bodies_as_far_as_their_records_are_there(
    state_dir: Path, tmp_path: Path
) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        for number in (1, 2, 3, 4):
            rushed = stone(10.0, body="estimate", refinement_fallback=RUSH)
            await add(store, session, number, rushed, particle_files(tmp_path / "out"))
        await revised(store, 2, stone(10.0, body="photo", refinement_fallback=None), tmp_path / "again")
        await store.write(save_product, "basalt", ProductDefinition(title="8/16", density_kg_m3=2700), "anna")
        await store.write(open_lot, LotDefinition(lot="L1"), "basalt", None, "anna")
        await store.write(assign, "L1", *EVER, "anna")
    database = state_dir / "results.sqlite"
    database.rename(state_dir / "today.sqlite")
    with closing(sqlite3.connect(database)) as old:
        for script in migrations()[:9]:
            old.executescript(script)
        old.execute("ATTACH ? AS today", (str(state_dir / "today.sqlite"),))
        columns = ", ".join(row[1] for row in old.execute("PRAGMA main.table_info(store)"))  # of that schema
        old.execute(f"INSERT INTO store ({columns}) SELECT {columns} FROM today.store")  # noqa: S608 - as above
        old.executescript(
            """INSERT INTO sessions SELECT * FROM today.sessions;
            INSERT INTO products SELECT * FROM today.products;
            INSERT INTO lots
                SELECT lot, state, product, version, definition, opened_at, closed_at, void_reason, revision
                FROM today.lots;
            INSERT INTO triggers
                SELECT trigger, session, bundle, sequence, kind, captured_at, state, lot FROM today.triggers;
            INSERT INTO results (seq, id, trigger, session, record)
                SELECT seq, id, trigger, session, record FROM today.results;
            INSERT INTO revisions SELECT * FROM today.revisions;
            DELETE FROM results WHERE seq = 3;
            PRAGMA user_version = 9"""
        )
    with await asyncio.to_thread(open_store, state_dir) as store:
        stones = await store.read(stones_of_lot, "L1")
        assert (sum(stones.lot.counts.values()), stones.by_body, stones.not_refined) == (
            4,
            {"estimate": 2, "photo": 1},
            {"rush": 2},
        )


async def test_a_closed_lot_gets_a_revision_and_an_event(filled: Store, tmp_path: Path) -> None:
    await filled.write(save_product, "basalt", ProductDefinition(title="8/16", density_kg_m3=2700), "anna")
    await filled.write(open_lot, LotDefinition(lot="L1"), "basalt", None, "anna")
    await filled.write(assign, "L1", *EVER, "anna")
    await revised(filled, 1, stone(13.0), tmp_path / "again")
    opened = await filled.read(find_lot, "L1")
    await filled.write(close_lot, "L1", None, "anna")
    await revised(filled, 3, stone(14.0), tmp_path / "again")
    lot = await filled.read(find_lot, "L1")
    assert opened is not None and lot is not None
    assert (opened.revision, lot.revision, lot.n_stones) == (0, 2, 3)
    stones = (await filled.read(stones_of_lot, "L1")).lot
    assert list(stones.column("sieve_size_mm")) == [13.0, 12.0, 14.0]
    events = (await filled.read(events_after, 0, 10)).items
    assert [(each["type"], each["data"]["revision"]) for each in events][-2:] == [
        ("lot.closed", 1),
        ("lot.revised", 2),
    ]


async def test_the_audit_has_what_was_and_what_is(filled: Store) -> None:
    (entry,) = await filled.read(entries, None, 0, 10)
    assert (entry.who, entry.action, entry.subject) == ("anna", "particle remeasured", await id_of(filled, 2))
    assert entry.before is not None and entry.after is not None
    assert (entry.before["seq"], entry.before["sieve_size_mm"]) == (2, 10.0)
    assert (entry.after["seq"], entry.after["sieve_size_mm"]) == (4, 12.0)


async def test_files_lie_within_those_of_the_stone_which_stay(filled: Store, state_dir: Path) -> None:
    folder = folder_of(state_dir, await id_of(filled, 2))
    assert {path.name for path in folder.iterdir()} == {"bundle.tiff", "mesh.ply", "silhouettes.tiff", "r2"}
    assert (
        await filled.folder(4)
        == folder / "r2"
        == filled.particles_dir / str(await filled.read(newest_folder, 2))
    )
    assert await filled.folder(2) == folder
    assert [path.name for path in (folder / "r2").iterdir()] == ["mesh.ply"]
    total = size_of(state_dir / "particles")  # `particle_files` hands the frames over, too
    assert await filled.read(lambda base: base.execute("SELECT files_bytes FROM store").fetchone()) == (
        total,
    )
    await asyncio.to_thread(sweep, state_dir, lambda: True)
    assert await filled.folder(4) == folder / "r2"
    assert filled.incidents == []


async def test_revisions_take_no_frames_away(state_dir: Path, tmp_path: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir, keep_raw=2) as store:
        session = await store.begin_session({})
        for number in (1, 2, 3):
            await add(store, session, number, stone(10.0), particle_files(tmp_path / "out"))
        for seq in (2, 3, 2):
            await revised(store, seq, stone(11.0), tmp_path / "again")
        assert with_frames(state_dir) == [2, 3]
        await add(store, session, 4, stone(10.0), particle_files(tmp_path / "out"))
        assert with_frames(state_dir) == [3, 7]
        await store.drop_old_raw(3)
        assert with_frames(state_dir) == [3, 7]


async def test_what_was_removed_meanwhile_is_not_revised(filled: Store, tmp_path: Path) -> None:
    await filled.write(mark_files, RetentionLimits(files_days=30), WIDE, LATER)
    with pytest.raises(RemeasureError, match="were just removed"):
        await revised(filled, 1, stone(11.0), tmp_path / "again")
    assert filled.last_seq == 4
    assert (await filled.read(results_after, 0, 10)).last_seq == 4


async def test_a_result_stays_until_its_revision_has_left_the_feed(
    filled: Store, session: int, state_dir: Path
) -> None:
    before = await filled.read(accounting)
    name = await id_of(filled, 2)
    limits = RetentionLimits(files_days=30, results_days=35)
    await filled.write(mark_files, limits, WIDE, LATER)
    going = await filled.read(files_going)
    for seq, folder in going:
        shutil.rmtree(state_dir / "particles" / folder)
        await filled.write(note_gone, [seq])
    assert await filled.read(lambda base: base.execute("SELECT files_bytes FROM store").fetchone()) == (0,)
    assert await filled.write(remove_results, limits, LATER) == 3  # the newest item, a revision, stays
    page = await filled.read(results_after, 3, 10)
    assert (page.first_seq, page.last_seq, [item["seq"] for item in page.items]) == (4, 4, [4])
    assert page.items[0]["files_removed"] == "age"
    assert await filled.read(particle, 1) is None
    assert await filled.read(particle, name) is not None

    await add(filled, session, 9, stone(10.0))
    await add(filled, session, 10, stone(10.0))
    assert await filled.write(remove_results, limits, LATER) == 2
    assert (await filled.read(results_after, 5, 10)).first_seq == 6
    assert await filled.read(particle, name) is None
    after = await filled.read(accounting)
    assert (after.measured, after.is_balanced) == (before.measured + 2, True)


async def test_a_pin_is_of_the_stone(filled: Store) -> None:
    await filled.write(pin, 2, "dispute", "anna")
    pinned = [item["seq"] for item in (await filled.read(results_after, 0, 10)).items if item["is_pinned"]]
    assert pinned == [2, 4]


async def test_a_restart_and_a_restored_backup_have_the_revisions(state_dir: Path, tmp_path: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        await add(store, session, 1, stone(10.0), particle_files(tmp_path / "out"))
        await revised(store, 1, stone(11.0), tmp_path / "again")
        name, instance_id = await id_of(store, 1), store.instance_id
        backup = await store.back_up(keep=1)
        await revised(store, 1, stone(12.0), tmp_path / "again")
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert (store.instance_id, store.last_seq, store.incidents) == (instance_id, 3, [])
    restore(backup, state_dir)
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert store.instance_id != instance_id
        newest = await store.read(particle, name)
        assert newest is not None
        assert (newest["revision"], newest["sieve_size_mm"]) == (2, 11.0)
        assert (await store.folder(2) / "mesh.ply").is_file()
        assert await revised(store, 1, stone(13.0), tmp_path / "again") == 4  # no number is given again
        assert (await store.folder(4)).name == "r3"


def test_the_feed_is_read_from_its_cursor_on_without_looking_at_all_of_it(tmp_path: Path) -> None:
    """The plan of the query: both halves begin at the cursor and come in order, so that a page costs a page."""
    from service.store.reads import FIRST, LATER

    base = sqlite3.connect(tmp_path / "empty.sqlite")
    for script in migrations():
        base.executescript(script)
    query = f"{FIRST} WHERE results.seq > 5 UNION ALL {LATER} WHERE revisions.seq > 5 ORDER BY 1 LIMIT 9"
    plan = "\n".join(row[3] for row in base.execute(f"EXPLAIN QUERY PLAN {query}"))
    base.close()
    assert "MERGE (UNION ALL)" in plan
    assert "SEARCH results USING INTEGER PRIMARY KEY (rowid>?)" in plan
    assert "SEARCH revisions USING INTEGER PRIMARY KEY (rowid>?)" in plan
    assert "TEMP B-TREE" not in plan
    assert "SCAN" not in plan
