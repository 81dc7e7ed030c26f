"""Time of one stone against the number of voxels and views, and throughput against the number of workers."""

import multiprocessing
import tempfile
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing.synchronize import Barrier
from pathlib import Path
from statistics import median

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.files.recording import write_bundle
from drivers.files.rig_file import write_rig
from pipeline.carving import CarvingParameters, carve
from pipeline.evaluation.scene import BODY, EvaluationScene, build_scene
from pipeline.frames import CameraId, FrameBundle
from pipeline.measuring.solid import solid_of
from pipeline.meshing import mesh_hull
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import nominal_rig
from pipeline.segmentation import SilhouetteSet, segment_all
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import stone
from pipeline.views.prepared import prepare_views
from research.performance import FORM, measured, worker_context
from service.processing.backgrounds import write_background
from service.processing.measure_job import (
    MeasureJob,
    RigFile,
    WorkerContext,
    initialize,
    measure,
    this_worker,
)

GRIDS = (128, 256, 512)
VIEWS = (8, 12, 16, 24, 32)
WORKERS = (1, 2)
READY_S = 120.0
"""Longest wait for the start of the workers."""
N_BUNDLES = 20
"""Bundles that each number of workers measures."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GridTimes:
    """Processor time on one grid, medians."""

    n: int  # voxels along an edge
    n_faces: int  # of the hull's mesh
    stages_ms: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewTimes:
    """Processor time with one number of views, medians."""

    n_views: int
    stages_ms: Mapping[str, float]  # frames to all measures

    @property
    def total_ms(self) -> float:
        return sum(self.stages_ms.values())


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerTimes:
    """Throughput of one number of workers."""

    n_workers: int
    stones_per_s: float  # by the clock, so that other work on the machine shows
    cpu_ms: float  # processor time of a stone, median


@dataclass(frozen=True, slots=True, kw_only=True)
class Scaling:
    """Times of one stone."""

    size_mm: float
    grids: Sequence[GridTimes]
    views: Sequence[ViewTimes]
    workers: Sequence[WorkerTimes]

    def exponents(self) -> dict[str, float]:
        """Return the exponent of n in the time of each stage, for n voxels an edge: 2 for a surface, 3 for a volume."""
        n = np.log([grid.n for grid in self.grids])
        stages = {stage: [grid.stages_ms[stage] for grid in self.grids] for stage in self.grids[0].stages_ms}
        return {stage: float(np.polyfit(n, np.log(ms), 1)[0]) for stage, ms in stages.items()}


def run_scaling_bench(size_mm: float, repeat: int, seed: int) -> Scaling:
    """Time one stone repeatedly, in worker processes."""
    with ProcessPoolExecutor(
        1,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=initialize,
        initargs=(worker_context(),),
    ) as pool:
        grids, views = pool.submit(_alone, size_mm, repeat, seed).result()
    with tempfile.TemporaryDirectory() as folder:
        jobs = _write_jobs(Path(folder), size_mm, seed)
        workers = [_together(n_workers, jobs) for n_workers in WORKERS]
    return Scaling(size_mm=size_mm, grids=grids, views=views, workers=workers)


def crowded_rig() -> RigCalibration:
    """Return a rig of twice the cameras: those of the design, and again turned into the gaps of each layer."""
    rig = nominal_rig()
    turn = Rotation.from_euler("z", 45, degrees=True).as_matrix()
    more = (replace(camera, id=CameraId(f"d{camera.id[1:]}"), R=camera.R @ turn.T) for camera in rig.cameras)
    return replace(rig, name="crowded", cameras=(*rig.cameras, *more))


def spread(rig: RigCalibration, n_views: int) -> tuple[CameraId, ...]:
    """Return `n_views` cameras of a crowded rig, equally many in each layer of four, opposite ones first."""
    n_designed = len(rig.cameras) // 2
    places = [first + quarter for quarter in (0, 2, 1, 3) for first in range(0, n_designed, 4)]
    order = [*places, *(n_designed + place for place in places)]
    chosen = sorted(order[:n_views])
    return tuple(rig.cameras[place].id for place in chosen)


def _photographed(scene: EvaluationScene, size_mm: float) -> FrameBundle:
    rng = stream(scene.seed, BODY)
    return scene.photograph(tumble(stone(FORM, size_mm, rng), scene.true_rig, rng), rng, FORM)


# --- in the worker processes ---


def _alone(size_mm: float, repeat: int, seed: int) -> tuple[list[GridTimes], list[ViewTimes]]:
    crowded = build_scene(seed, crowded_rig())
    bundle = _photographed(crowded, size_mm)
    views = []
    for n_views in VIEWS:
        cameras = spread(crowded.true_rig, n_views)
        seen = replace(bundle, frames={camera: bundle.frames[camera] for camera in cameras})
        views.append(_time_views(seen, crowded, repeat))
    designed = [camera.id for camera in nominal_rig().cameras]
    frames = {camera: bundle.frames[camera] for camera in designed}
    silhouettes = segment_all(frames, crowded.background, this_worker().segmenter)
    rig = crowded.true_rig.subset(designed)
    return [_time_grid(silhouettes, rig, n, repeat) for n in GRIDS], views


def _time_views(bundle: FrameBundle, scene: EvaluationScene, repeat: int) -> ViewTimes:
    runs = [measured(bundle, scene, "estimate")[0] for _ in range(repeat + 1)][1:]
    return ViewTimes(n_views=len(bundle.frames), stages_ms=_medians(runs))


def _time_grid(silhouettes: SilhouetteSet, rig: RigCalibration, n: int, repeat: int) -> GridTimes:
    runs, n_faces = [], 0
    for _ in range(repeat + 1):
        fresh = {camera: replace(silhouette) for camera, silhouette in silhouettes.items()}
        times_s = [time.process_time()]
        hull = carve(prepare_views(fresh, rig), CarvingParameters(n=n))
        times_s.append(time.process_time())
        mesh = mesh_hull(hull)
        times_s.append(time.process_time())
        assert mesh is not None
        solid_of(mesh.vertices_mm, mesh.faces)
        times_s.append(time.process_time())
        n_faces = len(mesh.faces)
        stages_ms = 1000 * np.diff(times_s)
        runs.append(
            {**dict(zip(("carve", "mesh", "integrals"), stages_ms, strict=True)), "sum": sum(stages_ms)}
        )
    return GridTimes(n=n, n_faces=n_faces, stages_ms=_medians(runs[1:]))


def _medians(runs: Sequence[Mapping[str, float]]) -> dict[str, float]:
    return {stage: float(median(run[stage] for run in runs)) for stage in runs[0]}


def _write_jobs(folder: Path, size_mm: float, seed: int) -> list[MeasureJob]:
    """Write a bundle with its rig and background, and return the jobs that measure it repeatedly."""
    scene = build_scene(seed)
    write_rig(folder / "rig.json", scene.true_rig)
    write_background(folder / "background", scene.background)
    rig_file = RigFile(folder / "rig.json", scene.true_rig.calibration_id)
    write_bundle(
        folder / "bundle.tiff", _photographed(scene, size_mm), scene.true_rig.camera_ids, compression="none"
    )
    return [
        MeasureJob(
            bundle_path=folder / "bundle.tiff",
            camera_ids=scene.true_rig.camera_ids,
            rig_file=rig_file,
            background_path=folder / "background",
            out_dir=folder / str(number),
        )
        for number in range(N_BUNDLES)
    ]


def _together(n_workers: int, jobs: Sequence[MeasureJob]) -> WorkerTimes:
    context = multiprocessing.get_context("spawn")
    are_ready = context.Barrier(n_workers + 1, timeout=READY_S)
    with ProcessPoolExecutor(
        n_workers, mp_context=context, initializer=_prepare, initargs=(worker_context(), jobs[0], are_ready)
    ) as pool:
        times = [pool.submit(_cpu_ms, job) for job in jobs]
        are_ready.wait()
        start_s = time.perf_counter()
        cpu_ms = median(each.result() for each in times)
        elapsed_s = time.perf_counter() - start_s
    return WorkerTimes(n_workers=n_workers, stones_per_s=len(jobs) / elapsed_s, cpu_ms=cpu_ms)


def _prepare(context: WorkerContext, job: MeasureJob, are_ready: Barrier) -> None:
    initialize(context)
    measure(job)
    are_ready.wait()


def _cpu_ms(job: MeasureJob) -> float:
    start_s = time.process_time()
    measure(job)
    return 1000 * (time.process_time() - start_s)
