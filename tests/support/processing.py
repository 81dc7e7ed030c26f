"""Processing with everything around it in the hands of a test: spool, pool, store and calibration."""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from support.outcomes import measured

from pipeline.frames import BundleKind, CameraId, Trigger
from service.calibration.drop_files import ObservedDrop
from service.calibration.drops import OUTLINES, DropCollector, observe
from service.processing.left_bundles import Quarantine
from service.processing.measure_job import MeasuredBundle, MeasureJob, RigFile, learn_background
from service.processing.processing import CalibrationInUse, Processing, ProcessingContext, ProcessingObserver
from service.processing.spool import Loss, SpooledBundle
from service.results.fields import Result, Verified
from service.results.record import document_of

RIG = RigFile(Path("rig.json"), "rig")


class QueueSpool:
    """A spool that was filled beforehand."""

    def __init__(self, bundles: list[SpooledBundle]) -> None:
        self.bundles = list(bundles)
        self.on_take: Callable[[str], None] = lambda name: None
        self.released: list[SpooledBundle] = []

    async def take(self) -> SpooledBundle | None:
        await asyncio.sleep(0)
        if not self.bundles:
            return None
        self.on_take(self.bundles[0].name)
        return self.bundles.pop(0)

    async def release(self, bundle: SpooledBundle, seq: int | None = None) -> None:
        self.released.append(bundle)


class Learning(SimpleNamespace):
    """The arguments of a `learn_background`."""


class ScriptedPool:
    """Answers at once, or when the test says so."""

    size = threads_per_job = 1
    n_waiting = 0

    def __init__(
        self, failures: Mapping[str, Exception] | None = None, *, is_gated: bool = False, slots: int = 100
    ) -> None:
        self.failures = failures or {}
        self.slots = asyncio.Semaphore(slots)
        self.unseen: dict[str, Exception] = {}
        self.jobs: list[MeasureJob | Learning] = []
        self.gates: dict[str, asyncio.Event] = {}
        self.is_gated = is_gated
        self.has_job = asyncio.Event()

    async def run_when_idle(self, make_job: Callable[[], partial[Any]]) -> Any:
        self.n_waiting += 1
        async with self.slots:
            self.n_waiting -= 1
            return await self.run(make_job())

    async def run(self, call: partial[Any]) -> Any:
        if call.func is observe:
            return self._observe(call.args[0])
        job = Learning(**call.keywords) if call.func is learn_background else call.args[0]
        name = job.bundle_path.stem
        self.jobs.append(job)
        self.has_job.set()
        if self.is_gated:
            await self.gates.setdefault(name, asyncio.Event()).wait()
        if name in self.failures:
            raise self.failures[name]
        if isinstance(job, Learning):
            job.out_path.mkdir(parents=True)
            return {}
        job.out_dir.mkdir(parents=True)
        (job.out_dir / "mesh.ply").write_text(name)
        (job.out_dir / "mesh.ply.tmp").touch()
        record = measured(
            bundle=name, background=job.background_path, calibration_id=job.rig_file.calibration_id
        )
        return MeasuredBundle(record)

    def _observe(self, job: MeasureJob) -> ObservedDrop:
        name = job.bundle_path.stem
        (job.out_dir / OUTLINES).touch()  # a process that dies may leave half a file
        if name in self.unseen:
            raise self.unseen[name]
        return ObservedDrop(bundle=f"{name} {job.rig_file.calibration_id}")


class ListStore:
    def __init__(self) -> None:
        self.records: list[Mapping[str, Any]] = []

    async def finish(self, session: int, bundle: str, record: Result, files: Mapping[str, Path]) -> int:
        assert record.bundle == bundle
        self.records.append({**document_of(record), "session": session, "files": dict(files)})
        return len(self.records)


@dataclass
class Desk:
    """A calibration that a test replaces, and a list in the place of who collects."""

    rig_file: RigFile = RIG
    kind: BundleKind | None = None
    verified: Verified | None = None
    collected: list[tuple[ObservedDrop, str, bool]] = field(default_factory=list)

    def in_use(self) -> CalibrationInUse:
        return CalibrationInUse(self.rig_file, self.collector, self.verified)

    @property
    def collector(self) -> DropCollector | None:
        if self.kind is None:
            return None

        async def add(drop: ObservedDrop, record: Result, outlines: Path | None) -> None:
            self.collected.append((drop, record.bundle, outlines is not None))

        return DropCollector(kind=self.kind, diameters_mm=(10.0,), add=add)


class Bench:
    def __init__(
        self, folder: Path, bundles: list[SpooledBundle], pool: ScriptedPool, desk: Desk | None = None
    ) -> None:
        self.spool = QueueSpool(bundles)
        self.pool = pool
        self.store = ListStore()
        self.progress = 0
        self.delays_s: list[float] = []
        self.told: list[tuple[str, int]] = []
        """Bundles whose records were passed on, and how many were durable then."""
        self.folder = folder
        self.quarantine = Quarantine(folder.parent / "quarantine")
        context = ProcessingContext(
            session=1,
            camera_ids=(CameraId("c01"),),
            is_simulated=True,
            save_silhouettes=False,
            folder=folder,
            can_rush=True,
        )
        self.processing = Processing(
            context,
            spool=self.spool,
            pool=pool,
            finish=self.store.finish,
            calibration=(desk or Desk()).in_use,
            observer=ProcessingObserver(
                on_outcome=self.delays_s.append,
                on_progress=self.on_progress,
                on_result=lambda record: self.told.append((record.bundle, len(self.store.records))),
            ),
            quarantine=self.quarantine,
        )

    def on_progress(self) -> None:
        self.progress += 1

    @property
    def outcomes(self) -> list[tuple[str, str | None]]:
        return [(record["bundle"], record.get("reason")) for record in self.store.records]


def turn(name: str, *, kind: BundleKind = BundleKind.PARTICLE, loss: Loss | None = None) -> SpooledBundle:
    trigger = Trigger(sequence=1, received_ns=0, device_ns=0, utc="2026-11-21T04:00:00Z", kind=kind)
    return SpooledBundle(trigger=trigger, name=name, content=loss or Path(f"{name}.tiff"))
