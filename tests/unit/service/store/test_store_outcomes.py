"""Every trigger ends in exactly one outcome, numbered without gaps, durable before it is visible."""

import asyncio
import sqlite3
import threading
from contextlib import closing
from dataclasses import replace
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path

import pytest
from support.eventually import PATIENCE_S
from support.outcomes import add, lose_open, measured, rejected, result, trigger
from support.rest import particle_files
from support.stores import folder_of

from drivers.files.times import utc_now
from pipeline.frames import BundleKind, GateCount, rfc3339
from service.base.errors import StoreError
from service.lots.stones import stones_between
from service.results.fields import LossReason, Result
from service.results.record import lost_record
from service.results.version import ALGORITHM_VERSION
from service.store import ParticleFilter, Store, open_store, writes
from service.store.accounting import OutcomeCounts, accounting, outcome_counts
from service.store.reads import gate_count, open_triggers, particle, particles, results_after
from service.store.retention import RetentionLimits, remove_results
from service.store.writes import NOTE_EVERY


async def seqs(store: Store) -> list[int]:
    return [record["seq"] for record in (await store.read(results_after, 0, 1000)).items]


async def test_concurrent_finishes_are_numbered_without_gaps(store: Store, session: int) -> None:
    numbers = await asyncio.gather(*(add(store, session, i, measured()) for i in range(40)))
    assert sorted(numbers) == list(range(1, 41)) == await seqs(store)
    assert store.last_seq == 40


async def test_a_second_outcome_is_refused(store: Store, session: int, tmp_path: Path) -> None:
    await store.record_triggers(session, {"a": trigger(1)})
    first, second = await asyncio.gather(
        store.finish(session, "a", measured(volume_mm3=1.5)),
        store.finish(session, "a", rejected("empty"), particle_files(tmp_path / "out")),
    )
    assert first == second == 1
    record = await store.read(particle, 1)
    assert record is not None
    assert (record["outcome"], record["volume_mm3"], record["mesh"]) == ("measured", 1.5, None)
    assert (tmp_path / "out" / "mesh.ply").exists()  # not taken, because not used
    assert await add(store, session, 2, measured()) == 2


async def test_files_move_to_the_particle(
    store: Store, session: int, state_dir: Path, tmp_path: Path
) -> None:
    files = particle_files(tmp_path / "out")
    content = {path.name: path.read_bytes() for path in (tmp_path / "out").rglob("*.*")}
    await add(store, session, 1, measured(), files)
    record = await store.read(particle, 1)
    assert record is not None
    folder = folder_of(state_dir, record["id"])
    assert record["mesh"] == f"particles/{record['id']}/mesh.ply"
    assert {path.name: path.read_bytes() for path in folder.rglob("*.*")} == content
    assert not any(path.exists() for path in files.values())


async def test_a_failed_write_changes_nothing_and_can_be_repeated(
    store: Store, session: int, state_dir: Path, tmp_path: Path
) -> None:
    files = particle_files(tmp_path / "out")
    with pytest.raises(StoreError, match="CHECK constraint failed"):
        await add(store, session, 1, measured().model_copy(update={"outcome": "odd"}), files)
    assert await seqs(store) == []
    assert (await store.read(accounting)).in_progress == 1
    assert await store.finish(session, "00000001", measured(), files) == 1
    folder = folder_of(state_dir, "*")
    assert sorted(path.name for path in folder.iterdir()) == ["bundle.tiff", "mesh.ply", "silhouettes.tiff"]


async def test_a_file_that_was_deleted_is_left_out_of_its_result(
    store: Store, session: int, state_dir: Path, tmp_path: Path
) -> None:
    files = particle_files(tmp_path / "out")
    await asyncio.to_thread(files["mesh.ply"].unlink)
    await add(store, session, 1, measured(), files)
    folder = folder_of(state_dir, "*")
    assert sorted(path.name for path in folder.iterdir()) == ["bundle.tiff", "silhouettes.tiff"]
    record = await store.read(particle, 1)
    assert record is not None
    assert (record["outcome"], record["mesh"]) == ("measured", None)


async def test_the_count_of_the_gate_is_that_of_the_newest_session_that_knows_one(state_dir: Path) -> None:
    first, second = (
        GateCount(gate="a,b,1", sequence=n, device_us=1000 * n, at=rfc3339(trigger(n).utc)) for n in (7, 9)
    )
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        assert await store.read(gate_count) is None
        await store.record_triggers(session, {"a": trigger(7)}, first)
        assert await store.read(gate_count) == (first, 0)
        await store.record_triggers(session, {"b": trigger(8), "c": trigger(8)})  # not announced
        assert await store.read(gate_count) == (first, 2)
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})  # killed before it heard of the gate
        session = await store.begin_session({})
        assert await store.read(gate_count) == (first, 2)
        await store.record_triggers(session, {"a": trigger(9)}, second)
        assert await store.read(gate_count) == (second, 0)
        await store.forget_gate_count(session)
        assert await store.read(gate_count) is None
        session = await store.begin_session({})
        assert await store.read(gate_count) is None


async def test_triggers_that_are_measured_yet_stay_open(state_dir: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        old = await store.begin_session({})
        await store.record_triggers(old, {name: trigger(1) for name in ("b", "a", "c")})
        new = await store.begin_session({})
        await store.record_triggers(new, {"a": trigger(1)})
        left = [(old, "a"), (old, "b"), (old, "gone"), (new, "a")]
        assert await store.read(open_triggers, store.session, left) == [(old, "b"), (old, "a")]
        assert await lose_open(store, "crash", "killed", but={(old, "a")}) == 2
        assert await store.read(open_triggers, store.session, left) == [(old, "a")]
        await store.finish(old, "a", measured())
        assert await store.read(open_triggers, store.session, left) == []
        counts = await store.read(accounting, old)
        assert (counts.measured, counts.lost) == (1, 2)


async def add_raw(store: Store, session: int, sequence: int, folder: Path) -> int:
    """One stone with its frames."""
    raw = folder / f"{sequence}.tiff"
    raw.write_bytes(b"frames")
    return await add(store, session, sequence, measured(), {"bundle.tiff": raw})


def seqs_with_raw(state_dir: Path) -> list[int]:
    return sorted(int(path.parent.name[-8:]) for path in (state_dir / "particles").glob("*/*/bundle.tiff"))


async def test_only_the_newest_raw_frames_are_kept(state_dir: Path, tmp_path: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir, keep_raw=4) as store:
        old = await store.begin_session({})
        for sequence in range(6):
            await add_raw(store, old, sequence, tmp_path)
        assert seqs_with_raw(state_dir) == [3, 4, 5, 6]
        await store.record_triggers(old, {"open": trigger(6)})
    with await asyncio.to_thread(open_store, state_dir, keep_raw=2) as store:
        new = await store.begin_session({})
        assert seqs_with_raw(state_dir) == [5, 6]
        assert await lose_open(store, "crash", "killed") == 1
        assert seqs_with_raw(state_dir) == [6]
        assert await add_raw(store, new, 7, tmp_path) == 8
        await add(store, new, 8, measured())
        assert seqs_with_raw(state_dir) == [8]
    with await asyncio.to_thread(open_store, state_dir, keep_raw=0) as store:
        session = await store.begin_session({})
        await add_raw(store, session, 9, tmp_path)
        assert seqs_with_raw(state_dir) == []


async def test_a_start_does_not_look_for_what_was_removed(state_dir: Path, tmp_path: Path) -> None:
    n = NOTE_EVERY + 20
    with await asyncio.to_thread(open_store, state_dir, keep_raw=2) as store:
        session = await store.begin_session({})
        for sequence in range(n):
            await add_raw(store, session, sequence, tmp_path)
        newest = await store.raw_path(n)
        unfinished = newest.with_name("bundle.tiff.tmp")  # of a daemon that was killed
        await asyncio.to_thread(unfinished.touch)
        again = await store.raw_path(1)
        await asyncio.to_thread(again.touch)
    with await asyncio.to_thread(open_store, state_dir, keep_raw=2) as store:
        session = await store.begin_session({})
        assert seqs_with_raw(state_dir) == [1, n - 1, n]
        for sequence in range(2):
            await add_raw(store, session, sequence, tmp_path)
        assert seqs_with_raw(state_dir) == [1, n + 1, n + 2]
        assert not unfinished.exists()


async def test_a_store_of_the_first_schema_goes_on(state_dir: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        await add(store, session, 1, measured(sieve_size_mm=12.0))
        await add(store, session, 2, rejected("empty"))
    database = state_dir / "results.sqlite"
    database.rename(state_dir / "today.sqlite")
    old = sqlite3.connect(database)
    old.executescript((files("service.store") / "001_initial.sql").read_text(encoding="utf-8"))
    old.execute("ATTACH ? AS today", (str(state_dir / "today.sqlite"),))
    old.executescript(
        """INSERT INTO store SELECT one, instance_id, last_seq FROM today.store;
        INSERT INTO sessions SELECT session, started_at, info FROM today.sessions;
        INSERT INTO triggers SELECT trigger, session, bundle, sequence, kind, captured_at, state FROM today.triggers;
        INSERT INTO results (seq, id, trigger, session, record)
            SELECT seq, id, trigger, session, record FROM today.results;
        PRAGMA user_version = 1"""
    )
    old.close()
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        await add(store, session, 3, measured(sieve_size_mm=30.0))
        large = await store.read(particles, ParticleFilter(min_sieve_size_mm=10.0), None, 10)
        assert [record["seq"] for record in large] == [3, 1]
        counts = await store.read(accounting)
        assert (counts.triggers, counts.measured, counts.by_reason) == (3, 2, {"empty": 1})
        stones = await store.read(stones_between, "2000", "3000")
        assert sum(stones.lot.counts.values()) == 3


async def test_readers_have_threads_of_their_own(store: Store, session: int) -> None:
    answered = threading.Event()
    others = [asyncio.create_task(asyncio.to_thread(answered.wait)) for _ in range(64)]
    async with asyncio.timeout(PATIENCE_S):
        assert (await store.read(accounting)).triggers == 0
    answered.set()
    await asyncio.gather(*others)


def test_the_folder_of_the_particles_is_durable_from_the_beginning(
    state_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[set[Path]] = []
    monkeypatch.setattr("service.store.store.sync", lambda folder: synced.append({folder, *folder.iterdir()}))
    open_store(state_dir).close()
    assert synced == [{state_dir, state_dir / "particles"}]


async def test_what_a_crash_left_under_the_next_number_is_removed(state_dir: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        name = f"{store.instance_id[:8]}-00000001"
    stale = [state_dir / "particles" / day / name / "mesh.ply" for day in ("", "2026-03-01", utc_now()[:10])]
    for path in stale:
        path.parent.mkdir(parents=True)
        path.write_bytes(b"of another stone")
    with await asyncio.to_thread(open_store, state_dir) as store:
        assert not any(path.exists() for path in stale)
        stale[-1].parent.mkdir()  # by a write that is repeated
        stale[-1].touch()
        await add(store, await store.begin_session({}), 1, rejected("empty"))
        assert not stale[-1].exists()


async def test_a_cancelled_caller_loses_no_outcome_and_wakes_readers(store: Store, session: int) -> None:
    await store.record_triggers(session, {"a": trigger(1)})
    waiting = asyncio.create_task(store.wait_while(lambda: store.last_seq == 0))
    finishing = asyncio.create_task(store.finish(session, "a", measured()))
    await asyncio.sleep(0)
    finishing.cancel()
    await asyncio.wait_for(waiting, PATIENCE_S)
    assert finishing.cancelled()
    assert await seqs(store) == [1]


async def test_extra_keys_survive_and_the_trigger_has_the_last_word(store: Store, session: int) -> None:
    await add(store, session, 1, measured(roughness_um=3.25, sequence=99, seq=7, captured_at="whenever"))
    record = await store.read(particle, 1)
    assert record is not None
    assert (record["roughness_um"], record["sequence"]) == (3.25, 1)
    assert record["captured_at"] == "2026-02-28T23:01:00.000Z"
    assert record == await store.read(particle, record["id"])


async def test_open_triggers_of_earlier_sessions_become_lost(state_dir: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        old = await store.begin_session({"calibration_id": "0123", "is_simulated": True})
        await add(store, old, 1, measured())
        for sequence in (2, 3):
            await store.record_triggers(old, {f"{sequence}": trigger(sequence)})
        instance_id = store.instance_id
    with await asyncio.to_thread(open_store, state_dir) as store:
        new = await store.begin_session({"is_replay": True})
        await store.record_triggers(new, {"1": trigger(1)})  # has its life before it
        assert await lose_open(store, "worker_crash", "the daemon was killed") == 2
        assert await lose_open(store, "worker_crash", "") == 0
        assert store.instance_id == instance_id
        items = (await store.read(results_after, 1, 10)).items
        assert [(item["seq"], item["bundle"], item["outcome"], item["reason"]) for item in items] == [
            (2, "2", "lost", "worker_crash"),
            (3, "3", "lost", "worker_crash"),
        ]
        result = Result.model_validate(items[0], strict=True)  # complete: no field is absent
        assert (result.is_simulated, result.calibration_id) == (True, "0123")
        assert result.algorithm_version == ALGORITHM_VERSION
        everything, current = await store.read(accounting), await store.read(accounting, new)
    assert (everything.triggers, everything.measured, everything.lost, everything.in_progress) == (4, 1, 2, 1)
    assert (current.triggers, current.lost, current.in_progress) == (1, 0, 1)
    assert everything.is_balanced
    assert current.is_balanced


async def test_accounting_adds_up_and_counts_backgrounds_apart(store: Store, session: int) -> None:
    await store.record_triggers(session, {"empty rig": trigger(1, BundleKind.BACKGROUND)})
    await store.record_triggers(session, {"ball": trigger(2, BundleKind.BALL)})
    await add(store, session, 3, measured())
    await add(store, session, 4, measured(quality="reduced"))
    await add(store, session, 5, rejected("clipped"))
    await add(store, session, 6, result(outcome="lost", reason="queue_full"))
    counts = await store.read(accounting)
    assert (counts.triggers, counts.measured, counts.rejected, counts.lost, counts.in_progress) == (
        5,
        2,
        1,
        1,
        1,
    )
    assert counts.backgrounds == 1
    assert counts.by_quality == {"good": 1, "reduced": 1}
    assert counts.by_reason == {"clipped": 1, "queue_full": 1}
    assert counts.is_balanced


async def test_misuse_is_refused_by_name(store: Store, session: int) -> None:
    with pytest.raises(StoreError, match="bundle x: no such trigger"):
        await store.finish(session, "x", measured())
    await store.record_triggers(session, {"b": trigger(1, BundleKind.BACKGROUND)})
    with pytest.raises(StoreError, match="background has no outcome"):
        await store.finish(session, "b", measured())
    with pytest.raises(StoreError, match="UNIQUE"):
        await store.record_triggers(session, {"b": trigger(2)})
    await store.record_triggers(session, {"c": trigger(3)})
    with pytest.raises(StoreError, match="CHECK"):
        await store.finish(session, "c", measured().model_copy(update={"outcome": "guessed"}))
    with pytest.raises(ValueError, match="JSON"):
        await store.finish(session, "c", measured(volume_mm3=float("nan")))
    assert await seqs(store) == []
    assert await store.finish(session, "c", measured()) == 1


def test_only_one_process_has_the_store(store: Store, state_dir: Path) -> None:
    with pytest.raises(StoreError, match="another process"):
        open_store(state_dir)


def test_a_newer_schema_and_a_file_in_the_way_are_refused(tmp_path: Path) -> None:
    open_store(tmp_path / "newer").close()
    connection = sqlite3.connect(tmp_path / "newer" / "results.sqlite")
    connection.execute("PRAGMA user_version = 99")
    connection.close()
    with pytest.raises(StoreError, match="schema 99 was written by a newer stonefall"):
        open_store(tmp_path / "newer")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StoreError, match="file"):
        open_store(tmp_path / "file")


def test_times_are_written_in_one_way() -> None:
    assert rfc3339("2026-03-01T01:00:00.123456+01:00") == "2026-03-01T00:00:00.123Z"
    assert rfc3339("2026-03-01T00:00:00Z") == "2026-03-01T00:00:00.000Z"
    for wrong in ("2026-03-01T00:00:00", "yesterday", "0001-01-01T00:00:00+14:00"):
        with pytest.raises(ValueError, match=r".+"):
            rfc3339(wrong)


async def test_results_of_a_replay_are_marked_and_never_beside_those_of_stones_that_fell(
    state_dir: Path,
) -> None:
    for folder, info, other in (
        ("live", {"cameras": ["c01"]}, {"is_replay": True}),
        ("replay", {"recording": "/a/recording"}, {"is_replay": False}),
    ):
        with closing(open_store(state_dir / folder)) as store:
            await store.begin_session(other)  # nothing came of it
            session = await store.begin_session(info)
            await add(store, session, 1, measured(), {})
            record = await store.read(particle, 1)
            assert record is not None
            assert record["is_replay"] is (folder == "replay")
            with pytest.raises(StoreError, match=r"choose another store\.dir"):
                await store.begin_session(other)
            assert await store.begin_session(info) == session + 1


async def test_results_by_a_clock_that_was_not_set_are_marked_and_stay_so(
    state_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with closing(open_store(state_dir)) as store:
        session = await store.begin_session({})
        with monkeypatch.context() as at_boot:
            at_boot.setattr(writes, "utc_now", lambda: "1970-01-01T00:00:42.000Z")
            await add(store, session, 1, measured(), {})
        await add(store, session, 2, measured(), {})
    with closing(open_store(state_dir)) as store:
        records = (await store.read(results_after, 0, 10)).items
        assert [record["time_is_doubtful"] for record in records] == [True, False]


MANY = 10_000_000


def lost_together(n_stones: int) -> dict[str, object]:
    """Return the record of stones that the gate counted while no daemon ran."""
    return lost_record(
        replace(trigger(7), n_stones=n_stones),
        bundle="gap",
        reason=LossReason.DOWN,
        detail="",
        calibration_id="0123",
        is_simulated=True,
    )


async def balance(store: Store) -> tuple[int, int, int]:
    """Return how many triggers there are, how many of them were lost and are open, wherever it is said."""
    counts = await store.read(accounting)
    assert counts.is_balanced
    assert counts.by_reason.get("down", 0) == counts.lost
    outcomes = await store.read(outcome_counts, OutcomeCounts())
    assert (sum(outcomes.n.values()), outcomes.in_progress) == (counts.lost, counts.in_progress)
    return counts.triggers, counts.lost, counts.in_progress


async def test_one_entry_with_a_number_counts_as_so_many_stones(store: Store, session: int) -> None:
    await store.record_triggers(session, {"gap": replace(trigger(7), n_stones=MANY)})
    assert await balance(store) == (MANY, 0, MANY)
    await store.finish(session, "gap", lost_together(MANY))
    assert await balance(store) == (MANY, MANY, 0)
    (entry,) = (await store.read(results_after, 0, 10)).items
    assert (entry["seq"], entry["outcome"], entry["n_stones"]) == (1, "lost", MANY)
    assert Result.model_validate(entry, strict=True).n_stones == MANY
    await store.finish(
        session, "late", lost_together(3).model_copy(update={"bundle": "late"})
    )  # without a row of its own
    assert await balance(store) == (MANY + 3, MANY + 3, 0)
    stones = await store.read(stones_between, "2000", "3000")
    assert sum(stones.lot.counts.values()) == MANY + 3


async def test_a_removed_entry_with_a_number_is_still_counted(store: Store, session: int) -> None:
    for sequence in (1, 2):
        await store.record_triggers(session, {f"{sequence}": replace(trigger(sequence), n_stones=MANY)})
        await store.finish(session, f"{sequence}", lost_together(MANY))
    await store.write(remove_results, RetentionLimits(results_days=1), datetime(2027, 1, 1, tzinfo=UTC))
    assert len((await store.read(results_after, 0, 10)).items) == 1
    assert await balance(store) == (2 * MANY, 2 * MANY, 0)


async def test_a_kill_before_its_outcome_loses_none_of_its_stones(state_dir: Path) -> None:
    count = GateCount(gate="a,b,1", sequence=7, device_us=7, at=rfc3339(trigger(1).utc))
    with await asyncio.to_thread(open_store, state_dir) as store:
        session = await store.begin_session({})
        await store.record_triggers(session, {"1": trigger(1)}, count)
        await store.record_triggers(session, {"gap": replace(trigger(7), n_stones=MANY)})
    with await asyncio.to_thread(open_store, state_dir) as store:
        await store.begin_session({})
        assert await store.read(gate_count) == (
            count,
            MANY,
        )  # the gate's count from there on is known to be lost
        assert await lose_open(store, LossReason.CRASH, "killed") == MANY + 1
        counts = await store.read(accounting)
    assert (counts.triggers, counts.lost, counts.by_reason) == (MANY + 1, MANY + 1, {"crash": MANY + 1})


async def test_open_triggers_are_lost_in_steps_of_which_each_is_whole(state_dir: Path) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        old = await store.begin_session({})
        await store.record_triggers(old, {str(number): trigger(1) for number in range(9)})
        await store.begin_session({})
        lost = [
            await lose_open(store, "crash", "killed", but={(old, "1"), (old, "8")}, most=3) for _ in "123"
        ]
        assert lost == [3, 3, 1]
        items = (await store.read(results_after, 0, 10)).items
        assert [item["bundle"] for item in items] == ["0", "2", "3", "4", "5", "6", "7"]
        assert (await store.read(accounting)).in_progress == 2


async def test_a_query_without_an_end_is_an_error_not_a_wait(store: Store) -> None:
    """`StopIteration` cannot be raised into a future, which would stay without an answer."""
    for ask in (store.read, store.write):
        with pytest.raises(RuntimeError, match="nothing was left to take"):
            await asyncio.wait_for(ask(lambda _: next(iter(()))), timeout=PATIENCE_S)
