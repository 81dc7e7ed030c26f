import asyncio
import shutil
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from support.processing import Bench, Desk, Learning, ScriptedPool, turn

from drivers.errors import RecordingError
from pipeline.frames import BundleKind
from service.calibration.drop_files import ObservedDrop
from service.calibration.drops import DropCollector
from service.processing.backgrounds import N_AWAITED, N_BESIDE
from service.processing.measure_job import MeasureJob, RigFile
from service.processing.spool import LeftBundle, Loss
from service.processing.worker_slot import JobLostError
from service.results.fields import LossReason, Result


async def test_results_are_committed_in_trigger_order_whichever_is_ready_first(tmp_path: Path):
    pool = ScriptedPool(is_gated=True)
    bench = Bench(
        tmp_path, [turn("a"), turn("b", loss=Loss(reason="queue_full", detail="")), turn("c")], pool
    )
    run = asyncio.create_task(bench.processing.run())
    while len(pool.gates) < 2:
        await pool.has_job.wait()
        pool.has_job.clear()
    pool.gates["c"].set()
    for _ in range(20):
        await asyncio.sleep(0)
    assert bench.outcomes == []
    pool.gates["a"].set()
    await run
    assert bench.outcomes == [("a", None), ("b", "queue_full"), ("c", None)]
    assert [bundle.name for bundle in bench.spool.released] == ["a", "b", "c"]
    assert bench.progress == 3


async def test_each_outcome_tells_its_delay_but_not_that_of_an_earlier_daemon(tmp_path: Path):
    before_s = time.monotonic()
    trigger, path = turn("b").trigger, tmp_path / "b.tiff"
    stale = LeftBundle(session=0, trigger=trigger, name="b", content=path, background=None)
    lost = turn("c", loss=Loss(reason="queue_full", detail=""))
    bench = Bench(tmp_path, [turn("e", kind=BundleKind.BACKGROUND), turn("a"), stale, lost], ScriptedPool())
    await bench.processing.run()
    after_s = time.monotonic()
    assert len(bench.delays_s) == 2
    assert all(before_s <= delay_s <= after_s for delay_s in bench.delays_s)  # since 0 of the clock


async def test_bodies_are_not_refined_while_others_wait(tmp_path: Path):
    pool = ScriptedPool(is_gated=True, slots=1)
    bench = Bench(tmp_path, [turn(name) for name in "abcde"], pool)
    run = asyncio.create_task(bench.processing.run())
    for _ in range(100):
        await asyncio.sleep(0)
    assert not bench.spool.bundles
    for name in "abcde":
        pool.gates.setdefault(name, asyncio.Event()).set()
    await run
    rushed = [job.bundle_path.stem for job in pool.jobs if isinstance(job, MeasureJob) and job.is_rushed]
    assert rushed == ["b", "c", "d"]  # others waited when the worker was free for them
    assert len(bench.outcomes) == 5


async def test_results_and_losses_are_passed_on_once_they_are_durable(tmp_path: Path):
    loss = Loss(reason=LossReason.QUEUE_FULL, detail="full")
    bundles = [turn("a"), turn("e", kind=BundleKind.BACKGROUND), turn("b", loss=loss), turn("c")]
    bench = Bench(tmp_path, bundles, ScriptedPool())
    await bench.processing.run()
    assert bench.told == [("a", 1), ("b", 2), ("c", 3)]


async def test_every_job_gets_the_background_of_its_place_and_old_versions_go(tmp_path: Path):
    empty = BundleKind.BACKGROUND
    bundles = [turn("a"), turn("e1", kind=empty), turn("b"), turn("e2", kind=empty), turn("c"), turn("d")]
    bench = Bench(tmp_path, bundles, ScriptedPool())
    assert bench.processing.background is None
    await bench.processing.run()
    assert bench.processing.background is not None
    learnt = [job for job in bench.pool.jobs if isinstance(job, Learning)]
    assert [job.previous_path for job in learnt] == [None, complete(learnt[0])]
    used = {record["bundle"]: record["background"] for record in bench.store.records}
    assert used == {"a": None, "b": complete(learnt[0]), "c": complete(learnt[1]), "d": complete(learnt[1])}
    assert list_names(tmp_path) == [complete(learnt[1]).name]


async def test_no_stone_waits_for_a_background_when_some_are_known(tmp_path: Path):
    empty = [turn(f"e{k}", kind=BundleKind.BACKGROUND) for k in range(N_AWAITED + 2)]
    stones = [turn(f"s{k}") for k in range(N_BESIDE + 2)]
    pool = ScriptedPool()
    bench = Bench(tmp_path, [*empty[:-2], turn("a"), empty[-2], *stones, empty[-1], turn("z")], pool)
    pool.gates = {bundle.name: asyncio.Event() for bundle in [turn("a"), *empty[:-2], *stones]}
    for gate in pool.gates.values():
        gate.set()
    pool.is_gated = True
    run = asyncio.create_task(bench.processing.run())
    for _ in range(200):
        await asyncio.sleep(0)
    names = [job.bundle_path.stem for job in pool.jobs]
    assert names[-N_BESIDE:] == [
        stone.name for stone in stones[:N_BESIDE]
    ]  # the next one needs what is learnt
    assert bench.outcomes == [("a", None)]  # in the order of the triggers
    pool.gates[empty[-2].name].set()
    for _ in range(200):
        await asyncio.sleep(0)
    assert [job.bundle_path.stem for job in pool.jobs][-2:] == [empty[-1].name, "z"]
    pool.gates[empty[-1].name].set()
    pool.gates["z"].set()
    await run
    learnt = [complete(job) for job in pool.jobs if isinstance(job, Learning)]
    used = [record["background"] for record in bench.store.records]
    assert used == [learnt[-3]] * (1 + N_BESIDE) + [learnt[-2]] * 3
    assert [job.previous_path for job in pool.jobs if isinstance(job, Learning)] == [None, *learnt[:-1]]
    assert list_names(tmp_path) == [path.name for path in learnt[-2:]]


async def test_the_first_backgrounds_are_learnt_before_a_later_bundle_is_started(tmp_path: Path):
    pool = ScriptedPool(is_gated=True)
    bench = Bench(tmp_path, [turn("e", kind=BundleKind.BACKGROUND), turn("a")], pool)
    run = asyncio.create_task(bench.processing.run())
    for _ in range(20):
        await asyncio.sleep(0)
    assert [type(job) for job in pool.jobs] == [Learning]
    pool.is_gated = False
    pool.gates["e"].set()
    await run
    assert bench.outcomes == [("a", None)]


async def test_failures_cost_their_own_bundle_alone(tmp_path: Path):
    failures = {
        "a": JobLostError("deadline", "not finished within 1 s"),
        "b": RecordingError(Path("b.tiff"), "torn"),
        "e1": JobLostError("worker_crash", "died"),
        "e2": RecordingError(Path("e2.tiff"), "torn"),
    }
    empty = BundleKind.BACKGROUND
    bundles = [turn("a"), turn("b"), turn("e1", kind=empty), turn("e2", kind=empty), turn("c")]
    bench = Bench(tmp_path, bundles, ScriptedPool(failures))
    await bench.processing.run()
    assert bench.outcomes == [("a", "deadline"), ("b", "unreadable"), ("c", None)]
    assert [record["outcome"] for record in bench.store.records] == ["lost", "lost", "measured"]
    assert bench.store.records[2]["background"] is None


async def test_what_failed_leaves_nothing_in_memory(tmp_path: Path):
    class Unfinished(ScriptedPool):
        async def run(self, call: partial[Any]) -> Any:
            folder = call.keywords.get("out_path") or call.args[0].out_dir
            folder.mkdir()
            (folder / "half").touch()
            raise JobLostError("worker_crash", "No space left on device")

    bundles = [turn("e", kind=BundleKind.BACKGROUND), turn("a")]
    bench = Bench(tmp_path, bundles, Unfinished())
    await bench.processing.run()
    assert bench.outcomes == [("a", "worker_crash")]
    assert list_names(tmp_path) == []


async def test_a_full_disk_costs_a_calibration_its_ball_and_not_the_daemon(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    class FullDesk(Desk):
        @property
        def collector(self) -> DropCollector | None:
            async def add(drop: ObservedDrop, record: Result, outlines: Path | None) -> None:
                raise OSError(28, "No space left on device")

            return DropCollector(kind=BundleKind.BALL, diameters_mm=(10.0,), add=add)

    bundles = [turn(name, kind=BundleKind.BALL) for name in ("a", "b")]
    bench = Bench(tmp_path, bundles, ScriptedPool(), FullDesk())
    await bench.processing.run()
    assert bench.outcomes == [("a", None), ("b", None)]
    assert "drop not kept for the calibration: [Errno 28] No space left on device bundle=b" in caplog.text
    assert list_names(tmp_path) == []


async def test_only_known_files_reach_the_store(tmp_path: Path):
    bench = Bench(tmp_path, [turn("a")], ScriptedPool())
    await bench.processing.run()
    assert list(bench.store.records[0]["files"]) == ["mesh.ply"]
    assert list_names(tmp_path) == []


async def test_what_is_abandoned_is_lost_with_the_reason(tmp_path: Path):
    pool = ScriptedPool(is_gated=True)
    full = Loss(reason="queue_full", detail="16 bundles were waiting")
    bundles = [turn("e", kind=BundleKind.BACKGROUND), turn("a"), turn("b", loss=full)]
    bench = Bench(tmp_path, bundles, pool)
    run = asyncio.create_task(bench.processing.run())
    await pool.has_job.wait()
    bench.processing.abandon()
    await run
    assert bench.outcomes == [("a", "shutdown"), ("b", "queue_full")]


async def test_a_bug_ends_the_consumer(tmp_path: Path):
    bench = Bench(tmp_path, [turn("a"), turn("b")], ScriptedPool({"a": KeyError("bug")}))
    with pytest.raises(ExceptionGroup) as group:
        await bench.processing.run()
    assert group.group_contains(KeyError)


async def test_every_bundle_is_measured_with_the_calibration_of_its_turn(tmp_path: Path):
    """Also when it waits for a worker while another one is activated, and when it is lost."""
    pool, desk = ScriptedPool(is_gated=True), Desk()
    full = Loss(reason="queue_full", detail="")
    bench = Bench(tmp_path, [turn("a"), turn("b"), turn("c"), turn("d", loss=full)], pool, desk)

    def activate_before_c(name: str) -> None:
        if name == "c":
            assert bench.store.records == []
            desk.rig_file = RigFile(Path("new.json"), "new")
            for waiting in "abc":
                pool.gates.setdefault(waiting, asyncio.Event()).set()

    bench.spool.on_take = activate_before_c
    await bench.processing.run()
    found = [(record["bundle"], record["calibration_id"]) for record in bench.store.records]
    assert found == [("a", "rig"), ("b", "rig"), ("c", "new"), ("d", "new")]


async def test_drops_are_collected_in_order_and_stones_are_not(tmp_path: Path):
    ball, stone = BundleKind.BALL, BundleKind.PARTICLE
    pool, desk = ScriptedPool(), Desk(kind=ball)
    pool.unseen = {
        "b": JobLostError("worker_crash", "died"),
        "d": RecordingError(tmp_path, "has no pages"),
    }
    names = {"a": ball, "s": stone, "b": ball, "c": ball, "d": ball}
    bundles = [turn(name, kind=kind) for name, kind in names.items()]
    bench = Bench(tmp_path, bundles, pool, desk)
    await bench.processing.run()
    assert [name for name, _ in bench.outcomes] == list(names)
    assert [(drop.bundle, name, has_file) for drop, name, has_file in desk.collected] == [
        ("a rig", "a", True),
        ("b", "b", False),
        ("c rig", "c", True),
        ("d", "d", False),
    ]
    assert [drop.problem for drop, _, _ in desk.collected] == [
        None,
        "worker_crash: died",
        None,
        "has no pages",
    ]
    assert list_names(tmp_path) == []


def complete(job: Learning) -> Path:
    """The name of what the job has learnt, once it is complete."""
    return job.out_path.with_name(job.out_path.name.replace("learning", "background"))


async def test_what_an_earlier_session_left_ends_there_with_the_background_of_then(tmp_path: Path):
    left, other = (
        LeftBundle(
            session=7,
            trigger=turn(name).trigger,
            name=name,
            content=Path(f"{name}.tiff"),
            background=background,
        )
        for name, background in (("left", tmp_path / "then"), ("other", None))
    )
    desk = Desk(kind=BundleKind.PARTICLE)
    bench = Bench(
        tmp_path, [left, other, turn("e", kind=BundleKind.BACKGROUND), turn("a")], ScriptedPool(), desk
    )
    await bench.processing.run()
    used = {record["bundle"]: (record["session"], record["background"]) for record in bench.store.records}
    (learnt,) = (job for job in bench.pool.jobs if isinstance(job, Learning))
    assert used == {"left": (7, tmp_path / "then"), "other": (7, None), "a": (1, complete(learnt))}
    assert [bundle for _, bundle, _ in desk.collected] == ["a"]  # nobody waits for drops of then


async def test_a_bundle_that_no_worker_survives_is_kept_and_nothing_else(tmp_path: Path):
    failures = {
        **{name: JobLostError("worker_crash", "") for name in ("b", "e")},
        "d": JobLostError("worker_crash", "OSError: [Errno 24] Too many open files", is_hosts=True),
    }
    bundles = [turn("a"), turn("b"), turn("e", kind=BundleKind.BACKGROUND), turn("c"), turn("d")]
    bench = Bench(tmp_path / "spool", bundles, ScriptedPool(failures))
    (tmp_path / "spool").mkdir()
    for bundle in bundles:
        (tmp_path / f"{bundle.name}.tiff").touch()
    bench.spool.bundles = [replace(each, content=tmp_path / f"{each.name}.tiff") for each in bundles]
    await bench.processing.run()
    assert bench.outcomes == [("a", None), ("b", "worker_crash"), ("c", None), ("d", "worker_crash")]
    assert bench.quarantine.bundles() == ["1-b.tiff"]


async def test_a_deleted_spool_costs_the_background_and_not_the_daemon(tmp_path: Path):
    folder = tmp_path / "spool"
    folder.mkdir()
    empty = BundleKind.BACKGROUND
    bundles = [turn("e1", kind=empty), turn("a"), turn("b"), turn("c"), turn("e2", kind=empty), turn("d")]
    bench = Bench(folder, bundles, ScriptedPool())
    bench.spool.on_take = lambda name: name == "b" and shutil.rmtree(folder)
    await bench.processing.run()
    assert [name for name, _ in bench.outcomes] == ["a", "b", "c", "d"]
    *_, d = bench.store.records
    learnt = [job for job in bench.pool.jobs if isinstance(job, Learning)]
    assert [job.previous_path for job in learnt] == [None, None]
    assert d["background"] == complete(learnt[1])


def list_names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())
