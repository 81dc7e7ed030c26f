"""What one stone costs on this machine, stage by stage, from the bundle's file to the durable result.

The stages are the daemon's own: `worker_job.measure` in a process of its own, then the store.
"""

import asyncio
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from drivers.recording import write_bundle
from drivers.rig_file import write_rig
from pipeline.frames import FrameBundle
from pipeline.particle import PipelineParameters
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.scene import BODY, Scene, build_scene
from pipeline.synthesis.stones import stone
from service.background_file import write_background
from service.errors import UsageError
from service.segmentation_settings import SegmentationSettings, plan_segmenter
from service.store import open_store
from service.worker_job import MeasureJob, RigFile, WorkerContext, initialize, measure

SIZES_MM = (5.0, 15.0, 25.0, 40.0)
"""Greatest diameters; the last ones fill the image."""
FORM = "angular"
STORE = "store"


@dataclass(frozen=True, slots=True, kw_only=True)
class StageTimes:
    """Of stones of one size; medians, in ms."""

    size_mm: float
    n: int
    stages_ms: Mapping[str, float]  # wall clock
    total_ms: float
    p95_ms: float  # of the total
    cpu_ms: float  # of all threads; more than the total when a stage uses several cores


def run_performance_bench(
    repeat: int, seed: int, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> list[StageTimes]:
    """Time `repeat` stones of each of `SIZES_MM` in one worker, after one that warms it up."""
    context = multiprocessing.get_context("spawn")
    worker = WorkerContext(
        parameters=PipelineParameters(),
        is_simulated=True,
        segmentation=plan_segmenter(SegmentationSettings()),
    )
    jobs = [(row, number) for row in range(len(SIZES_MM)) for number in range(repeat)]
    timed: dict[int, list[dict[str, float]]] = {row: [] for row in range(len(SIZES_MM))}
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, mp_context=context, initializer=initialize, initargs=(worker,)) as pool,
    ):
        pool.submit(_time_one, Path(folder), seed, 0, repeat).result()
        for done, (row, number) in enumerate(jobs):
            on_progress(done, len(jobs))
            timed[row].append(pool.submit(_time_one, Path(folder), seed, row, number).result())
    return [_times(SIZES_MM[row], runs) for row, runs in timed.items()]


def _times(size_mm: float, runs: list[dict[str, float]]) -> StageTimes:
    stages = [stage for stage in runs[0] if stage != "cpu"]
    totals_ms = [sum(run[stage] for stage in stages) for run in runs]
    return StageTimes(
        size_mm=size_mm,
        n=len(runs),
        stages_ms={stage: median(run[stage] for run in runs) for stage in stages},
        total_ms=median(totals_ms),
        p95_ms=float(np.quantile(totals_ms, 0.95)),
        cpu_ms=median(run["cpu"] for run in runs),
    )


# --- in the worker process ---


@cache
def _scene(folder: Path, seed: int) -> Scene:
    """The rig, with its files in the folder."""
    scene = build_scene(seed)
    write_rig(folder / "rig.json", scene.true_rig)
    write_background(folder / "background.npz", scene.background)
    return scene


def _time_one(folder: Path, seed: int, row: int, number: int) -> dict[str, float]:
    """Milliseconds of each stage, and of CPU in all of them (`cpu`), for the n-th stone of a size."""
    scene = _scene(folder, seed)
    rng = stream(seed, BODY, row, number)
    bundle = scene.photograph(tumble(stone(FORM, SIZES_MM[row], rng), scene.true_rig, rng), rng, FORM)
    name = f"{row}-{number}"
    job = MeasureJob(
        bundle_path=folder / f"{name}.tiff",
        camera_ids=scene.true_rig.camera_ids,
        rig=RigFile(folder / "rig.json", scene.true_rig.calibration_id),
        background_path=folder / "background.npz",
        out_dir=folder / name,
    )
    write_bundle(job.bundle_path, bundle, job.camera_ids, compression="none")
    cpu_start = time.process_time()
    record = measure(job)
    if record["outcome"] != "measured":
        raise UsageError(
            f"a stone of {SIZES_MM[row]:g} mm cannot be timed: {record['detail']}; try another --seed"
        )
    store_start = time.perf_counter()
    asyncio.run(_store(folder / f"state-{name}", bundle, record, job.out_dir))
    times_ms = {stage: ms for stage, ms in record["timings_ms"].items() if stage != "total"}
    times_ms[STORE] = 1000 * (time.perf_counter() - store_start)
    return times_ms | {"cpu": 1000 * (time.process_time() - cpu_start)}


async def _store(folder: Path, bundle: FrameBundle, record: Mapping[str, Any], files: Path) -> None:
    with open_store(folder) as store:
        session = await store.begin_session({})
        await store.record_trigger(session, bundle.trigger, bundle.name)
        await store.finish(session, bundle.name, record, {"mesh.ply": files / "mesh.ply"})
