"""Stones measured again by a cluster: how many are under way, what becomes of each, and whom the command trusts."""

import asyncio
import os
import pickle
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from support.remeasuring import AgainPool

from drivers.errors import RecordingError
from pipeline.frames import CameraId
from pipeline.particle import PipelineParameters
from service.base.errors import UsageError
from service.commands import remeasure as module
from service.commands.daemon_client import DaemonClient, DaemonError
from service.commands.remeasure import OrderingDaemon, RemeasuredIds, remeasure_on_cluster
from service.commands.results_folder import IN_FLIGHT
from service.processing.measure_job import MeasuredBundle, MeasureJob, RigFile, WorkerContext
from service.processing.worker_slot import JobLostError
from service.results.fields import LossReason

N_PROCESSES = 3


@dataclass
class FakeDaemon:
    """Orders all stones but those named `done-...`, and takes all that was measured."""

    folder: Path
    n_ordered: int = 0
    delivered: list[str] = field(default_factory=list)

    async def order(self, name: str) -> tuple[str, MeasureJob] | None:
        if name.startswith("done"):
            return None
        if name.startswith("gone"):
            raise DaemonError("refused", "not-kept")
        self.n_ordered += 1
        job = MeasureJob(
            bundle_path=self.folder / name / "bundle.tiff",
            camera_ids=(CameraId("c01"),),
            rig_file=RigFile(self.folder / "rig.json", "0"),
            background_path=None,
            out_dir=self.folder / f"{self.n_ordered}" / "out",
        )
        return f"{self.n_ordered}", job

    async def deliver(self, name: str, order: str) -> bool:
        assert (self.folder / order / "out" / "record.json").is_file()
        self.delivered.append(name)
        return True


@dataclass
class CountingPool(AgainPool):
    """Counts the jobs under way, and raises what it is told to, once for each stone."""

    errors: dict[str, Exception] = field(default_factory=dict)
    size: int = N_PROCESSES
    n_under_way: int = 0
    most: int = 0

    async def run(self, call: partial[MeasuredBundle]) -> MeasuredBundle:
        self.n_under_way += 1
        self.most = max(self.most, self.n_under_way)
        await asyncio.sleep(0)
        self.n_under_way -= 1
        if (error := self.errors.pop(call.args[0].bundle_path.parent.name, None)) is not None:
            raise error
        return await super().run(call)


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> CountingPool:
    context = WorkerContext(parameters=PipelineParameters(), is_simulated=True)
    (tmp_path / "context.pickle").write_bytes(pickle.dumps(context))
    pool = CountingPool()

    @asynccontextmanager
    async def opened(executor: str, wanted: WorkerContext) -> AsyncIterator[CountingPool]:
        assert (executor, wanted) == ("dask://x:1", context)
        yield pool

    monkeypatch.setattr(module, "open_cluster", opened)
    return pool


async def remeasured(daemon: Any, names: list[str]) -> RemeasuredIds:
    summary, n_done = RemeasuredIds(), 0

    def on_progress() -> None:
        nonlocal n_done
        n_done += 1

    await remeasure_on_cluster(daemon, "dask://x:1", names, summary, on_progress)
    assert n_done == len(names)
    return summary


async def test_few_bundles_are_under_way_whatever_the_archive(pool: CountingPool, tmp_path: Path) -> None:
    names = [f"s{number}" for number in range(200)]
    summary = await remeasured(FakeDaemon(tmp_path), ["done-1", *names, "done-2", "gone-1"])
    assert sorted(summary.revised) == sorted(names)
    assert (summary.unchanged, summary.without_frames, summary.failed) == (
        ["done-1", "done-2"],
        ["gone-1"],
        {},
    )
    assert N_PROCESSES < pool.most <= IN_FLIGHT * N_PROCESSES


async def test_a_failure_is_that_of_its_stone_and_a_background_that_went_is_ordered_again(
    pool: CountingPool, tmp_path: Path
) -> None:
    pool.errors = {
        "a": JobLostError(LossReason.WORKER_CRASH, "it died"),
        "b": RecordingError(Path("bundle.tiff"), "is damaged"),
        "c": FileNotFoundError("background-1"),
    }
    daemon = FakeDaemon(tmp_path)
    summary = await remeasured(daemon, ["a", "b", "c", "d"])
    assert (sorted(summary.revised), sorted(daemon.delivered)) == (["c", "d"], ["c", "d"])
    assert summary.failed == {"a": "worker_crash: it died", "b": "is damaged"}


async def test_when_all_is_of_this_algorithm_no_cluster_is_asked(tmp_path: Path) -> None:
    summary = await remeasured(FakeDaemon(tmp_path), ["done-1", "gone-1"])
    assert (summary.unchanged, summary.without_frames) == (["done-1"], ["gone-1"])


def test_only_a_folder_of_our_own_in_the_spool_is_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = OrderingDaemon(DaemonClient(), tmp_path / "spool")
    own, elsewhere = tmp_path / "spool" / "1", tmp_path / "1"
    for folder in (own, elsewhere):
        folder.mkdir(parents=True)
    daemon._require_own(own)
    with pytest.raises(UsageError, match=r"is not a folder of this user"):
        daemon._require_own(elsewhere)
    with pytest.raises(UsageError, match=r"on the daemon's host"):
        daemon._require_own(tmp_path / "spool" / "none")
    monkeypatch.setattr(os, "geteuid", lambda: own.stat().st_uid + 1)
    with pytest.raises(UsageError, match=r"run this as the daemon's user"):
        daemon._require_own(own)
