"""Time of one stone on this machine, by stage and from the bundle's file to the durable result.

Everything runs in one worker process on one thread. Stages count processor time, of the quickest of `N_RUNS`. Other
work on the machine can make the same stage take up to twice the processor time, so the speed of the processor is
reported as well. The whole way (`measure_job.measure` and the store) is run once, and timed by the clock too.
"""

import asyncio
import multiprocessing
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from statistics import median

import numpy as np

from drivers.files.recording import write_bundle
from drivers.files.rig_file import write_rig
from pipeline.body_measurement import BodyKind
from pipeline.carving import carve
from pipeline.evaluation.scene import BODY, EvaluationScene, build_scene
from pipeline.frames import FrameBundle
from pipeline.measuring.solid import solid_of
from pipeline.meshing import mesh_hull
from pipeline.particle import BodyParameters, ParticleResult, PipelineParameters, measure_bundle
from pipeline.segmentation import segment_all
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import stone
from pipeline.views.prepared import prepare_views
from service.base.errors import UsageError
from service.configuration.segmentation_settings import SegmentationSettings, plan_segmenter
from service.processing.backgrounds import write_background
from service.processing.measure_job import (
    RESULT_FILES,
    MeasureJob,
    RigFile,
    WorkerContext,
    initialize,
    measure,
    this_worker,
)
from service.store import open_store

SIZES_MM = (5.0, 15.0, 25.0, 40.0)
"""Greatest diameters of the stones; the largest fills the image."""
FORM = "angular"
N_RUNS = 3
"""Runs of each stone, whose data stay in the caches meanwhile; the goals were measured in the same way."""
MATRIX_SIZE = 512
"""Rows of the single-precision matrices whose product tells the present speed of the processor."""


MEDIANS = (
    "hull_ms", "photo_ms", "refine_ms", "texture_ms", "mesh_ms", "way_ms", "way_cpu_ms", "gflops",
)  # fmt: skip
"""Figures of which a size of stones has the median under the same name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StoneTimes:
    """Times of one stone."""

    stages_ms: Mapping[str, float]  # processor time, frames to all measures of the estimate
    hull_ms: float  # their sum with the hull as the body
    photo_ms: float  # with the refined and textured body
    refine_ms: float  # of that, the refinement
    texture_ms: float  # and the greys of the vertices
    mesh_ms: float  # silhouettes to the hull's mesh with its integrals
    way_ms: float  # bundle's file to durable result, by the clock
    way_cpu_ms: float
    gflops: float  # speed of the processor meanwhile


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeTimes:
    """Times of stones of one size: medians, and 95th percentiles in `..._p95_ms`."""

    size_mm: float
    n: int
    stages_ms: Mapping[str, float]
    cpu_ms: float  # frames to all measures of the estimate
    cpu_p95_ms: float
    hull_ms: float
    photo_ms: float
    refine_ms: float
    texture_ms: float
    mesh_ms: float
    way_ms: float
    way_p95_ms: float
    way_cpu_ms: float
    gflops: float


def run_performance_bench(
    repeat: int, seed: int, on_progress: Callable[[int, int], None] = lambda done, total: None
) -> list[SizeTimes]:
    """Time `repeat` stones of each of `SIZES_MM` in one worker, after a first stone that warms it up."""
    jobs = [(row, number) for row in range(len(SIZES_MM)) for number in range(repeat)]
    timed: dict[int, list[StoneTimes]] = {row: [] for row in range(len(SIZES_MM))}
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(
            1,
            mp_context=multiprocessing.get_context("spawn"),
            initializer=initialize,
            initargs=(worker_context(),),
        ) as pool,
    ):
        pool.submit(_time_one, Path(folder), seed, 0, repeat).result()
        for done, (row, number) in enumerate(jobs):
            on_progress(done, len(jobs))
            timed[row].append(pool.submit(_time_one, Path(folder), seed, row, number).result())
    return [_summary(SIZES_MM[row], stones) for row, stones in timed.items()]


def worker_context() -> WorkerContext:
    """Return the context of the daemon's workers with default settings."""
    return WorkerContext(
        parameters=PipelineParameters(),
        is_simulated=True,
        segmentation=plan_segmenter(SegmentationSettings()),
        compact_meshes=True,
    )


def _summary(size_mm: float, stones: list[StoneTimes]) -> SizeTimes:
    totals_ms = [sum(each.stages_ms.values()) for each in stones]
    return SizeTimes(
        size_mm=size_mm,
        n=len(stones),
        stages_ms={stage: median(each.stages_ms[stage] for each in stones) for stage in stones[0].stages_ms},
        cpu_ms=median(totals_ms),
        cpu_p95_ms=float(np.quantile(totals_ms, 0.95)),
        way_p95_ms=float(np.quantile([each.way_ms for each in stones], 0.95)),
        **{name: median(getattr(each, name) for each in stones) for name in MEDIANS},
    )


# --- in the worker process ---


@cache
def _scene(folder: Path, seed: int) -> EvaluationScene:
    """Return the scene, and write rig and background to the folder."""
    scene = build_scene(seed)
    write_rig(folder / "rig.json", scene.true_rig)
    write_background(folder / "background", scene.background)
    return scene


def _time_one(folder: Path, seed: int, row: int, number: int) -> StoneTimes:
    """Time the n-th stone of a size."""
    scene = _scene(folder, seed)
    rng = stream(seed, BODY, row, number)
    bundle = scene.photograph(tumble(stone(FORM, SIZES_MM[row], rng), scene.true_rig, rng), rng, FORM)
    rejection = measured(bundle, scene, "photo")[1].rejection
    if rejection is not None:
        raise UsageError(f"a stone of {SIZES_MM[row]:g} mm cannot be timed: {rejection}; try another --seed")
    photos_ms, estimates_ms, hulls_ms, meshes_ms, speeds = [], [], [], [], []
    for _ in range(N_RUNS):  # no result is kept, as in a worker: otherwise each run would use fresh memory
        speeds.append(processor_gflops())
        photos_ms.append(measured(bundle, scene, "photo")[0])
        estimates_ms.append(measured(bundle, scene, "estimate")[0])
        hulls_ms.append(sum(measured(bundle, scene, "hull")[0].values()))
        meshes_ms.append(mesh_ms(bundle, scene))
    way_ms, way_cpu_ms = _whole_way(folder, f"{row}-{number}", bundle, scene)
    photo_ms = _quickest(photos_ms)
    return StoneTimes(
        stages_ms=_quickest(estimates_ms),
        hull_ms=min(hulls_ms),
        photo_ms=sum(photo_ms.values()),
        refine_ms=photo_ms.get("refine", 0.0),
        texture_ms=photo_ms["texture"],
        mesh_ms=min(meshes_ms),
        way_ms=way_ms,
        way_cpu_ms=way_cpu_ms,
        gflops=max(speeds),
    )


def _quickest(runs: Sequence[Mapping[str, float]]) -> Mapping[str, float]:
    """Return the stages of the run that took the least time."""
    return min(runs, key=lambda stages_ms: sum(stages_ms.values()))


def processor_gflops() -> float:
    """Return the present speed of one thread in a product of matrices, the best of a few."""
    matrix = np.ones((MATRIX_SIZE, MATRIX_SIZE), np.float32)
    times_s = []
    for _ in range(N_RUNS):
        start_s = time.process_time()
        matrix @ matrix
        times_s.append(time.process_time() - start_s)
    return 2e-9 * MATRIX_SIZE**3 / min(times_s)


def measured(
    bundle: FrameBundle, scene: EvaluationScene, body: BodyKind
) -> tuple[dict[str, float], ParticleResult]:
    """Return the processor time of each stage in this worker, ms, and the result."""
    worker = this_worker()
    stages_ms: dict[str, float] = {}
    last_s = time.process_time()

    def on_stage(stage: str) -> None:
        nonlocal last_s
        now_s = time.process_time()
        stages_ms[stage] = 1000 * (now_s - last_s)
        last_s = now_s

    parameters = replace(worker.context.parameters, body=BodyParameters(body))
    result = measure_bundle(bundle, scene.true_rig, scene.background, worker.segmenter, parameters, on_stage)
    return stages_ms, result


def mesh_ms(bundle: FrameBundle, scene: EvaluationScene) -> float:
    """Return the processor time, ms, from silhouettes without distance fields to the hull's mesh and its integrals."""
    silhouettes = segment_all(bundle.frames, scene.background, this_worker().segmenter)
    start_s = time.process_time()
    hull = mesh_hull(
        carve(prepare_views(silhouettes, scene.true_rig), this_worker().context.parameters.carving)
    )
    if hull is not None:
        solid_of(hull.vertices_mm, hull.faces)
    return 1000 * (time.process_time() - start_s)


def _whole_way(folder: Path, name: str, bundle: FrameBundle, scene: EvaluationScene) -> tuple[float, float]:
    """Return the time from the bundle's file to the durable result, ms, by the clock and of the processor."""
    job = MeasureJob(
        bundle_path=folder / f"{name}.tiff",
        camera_ids=scene.true_rig.camera_ids,
        rig_file=RigFile(folder / "rig.json", scene.true_rig.calibration_id),
        background_path=folder / "background",
        out_dir=folder / name,
        save_silhouettes=True,
    )
    write_bundle(job.bundle_path, bundle, job.camera_ids, compression="none")
    times_ms = asyncio.run(_measured_and_stored(folder / "state", job, bundle))
    job.bundle_path.unlink()
    return times_ms


async def _measured_and_stored(state: Path, job: MeasureJob, bundle: FrameBundle) -> tuple[float, float]:
    with open_store(state) as store:
        session = await store.begin_session({})
        await store.record_triggers(session, {bundle.name: bundle.trigger})
        start_s, start_cpu_s = time.perf_counter(), time.process_time()
        record = measure(job).record
        files = {name: path for name in RESULT_FILES if (path := job.out_dir / name).exists()}
        await store.finish(session, bundle.name, record, files)
        return 1000 * (time.perf_counter() - start_s), 1000 * (time.process_time() - start_cpu_s)
