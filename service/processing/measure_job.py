"""The jobs of a worker process: from one bundle file to one result record and its files.

The offline command and the daemon call the same functions, so their results are equal bit for bit,
whatever the number of workers.
"""

import gc
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
from numba.core import event
from threadpoolctl import threadpool_limits

from drivers.files.compact_mesh import write_compact_mesh
from drivers.files.mesh_file import write_mesh
from drivers.files.recording import read_bundle
from drivers.files.rig_file import read_rig
from drivers.files.silhouette_file import write_silhouettes
from pipeline import carving, estimate, measuring, meshing, preview, refinement
from pipeline.frames import CameraId
from pipeline.particle import ParticleResult, PipelineParameters, measure_bundle
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import BackgroundModel, Segmenter
from pipeline.segmentation.background import learn_background as learn
from pipeline.segmentation.optics import observe_all
from pipeline.view_mapper import ViewMapper
from pipeline.views import consistency
from service.base.errors import WorkerFailure
from service.processing.backgrounds import read_background, write_background
from service.processing.segmenters import CLASSICAL, SegmenterPlan, build_segmenter, warm_up
from service.processing.worker_process import WarmUp, keep_freed_memory, worker_boundary
from service.results.fields import RUSH, Result
from service.results.record import optics_record, result_record

NICENESS = 10
"""Niceness of the workers above that of the daemon (nice(2))."""
MESH, COMPACT_MESH, SILHOUETTES, THUMBNAIL = RESULT_FILES = (
    "mesh.ply",
    "mesh.sfmesh",
    "silhouettes.tiff",
    preview.PREVIEW_NAME.format(preview.THUMBNAIL_PX),
)
"""Files of a result; a worker that crashed may have left others."""
GC_THRESHOLD = 20_000
"""New objects between two garbage collections: with Python's default, they take 9 % of the compiler's time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerContext:
    """Parameters that all jobs of a worker share."""

    parameters: PipelineParameters
    is_simulated: bool
    segmentation: SegmenterPlan = CLASSICAL
    compact_meshes: bool = False  # instead of PLY
    draws_thumbnails: bool = False  # of bodies, but in a rush


@dataclass(frozen=True, slots=True)
class RigFile:
    """A calibration's file, never rewritten under its name, and the id of its content."""

    path: Path
    calibration_id: str


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureJob:
    """One bundle to measure; its files are written into `out_dir`, which is created."""

    bundle_path: Path
    camera_ids: tuple[CameraId, ...]
    rig_file: RigFile
    background_path: Path | None
    out_dir: Path
    save_silhouettes: bool = False
    checked: bool = True  # whether pixels are compared with their checksums
    threads: int = 1  # views that are processed at a time
    is_rushed: bool = False  # others wait: the body is not refined


@dataclass(frozen=True, slots=True)
class MeasuredBundle:
    """The result record of one bundle, and why the segmentation network did not run as configured, if it did not."""

    record: Result
    network_trouble: str | None = None


@dataclass(frozen=True, slots=True)
class Worker:
    """State of a worker process that its jobs share."""

    context: WorkerContext
    segmenter: Segmenter


@lru_cache(maxsize=1)
def background_at(path: Path | None) -> BackgroundModel:
    """Return the model in a folder, cached: folders are never rewritten under their name."""
    return {} if path is None else read_background(path)


@lru_cache(maxsize=1)
def rig_in(file: RigFile) -> RigCalibration:
    """Return the calibration in a file, cached; raise `ValueError` when it has another id."""
    rig = read_rig(file.path)
    if rig.calibration_id != file.calibration_id:
        raise ValueError(f"{file.path} holds calibration {rig.calibration_id}, not {file.calibration_id}")
    return rig


_worker: Worker | None = None


def begin(context: WorkerContext) -> Worker:
    """Give this process the state that jobs need, and return it."""
    global _worker
    segmenter = build_segmenter(context.segmentation, context.parameters.segmentation)
    _worker = Worker(context=context, segmenter=segmenter)
    return _worker


def prepare(context: WorkerContext) -> list[WarmUp]:
    """Prepare this process for jobs; return the steps that compile what a stone needs, the longest first."""
    lower_priority()
    keep_freed_memory()
    gc.set_threshold(GC_THRESHOLD)
    segmenter = begin(context).segmenter
    steps: list[Callable[[], object]] = [
        partial(warm_up, segmenter),
        measuring.warm_up,
        consistency.warm_up,
        estimate.warm_up,
        partial(carving.warm_up, context.parameters.carving),
        meshing.warm_up,
    ]
    if context.draws_thumbnails:
        steps.append(preview.warm_up)
    if context.parameters.body.kind == "photo":
        steps.append(refinement.warm_up)
    if context.parameters.body.is_textured:
        steps.append(refinement.warm_up_texture)
    return [partial(compiles, step) for step in steps]


def prepare_to_learn(context: WorkerContext) -> list[WarmUp]:
    """Prepare this process for exposures of the empty rig alone."""
    prepare(context)
    return []


def compiles(step: Callable[[], object]) -> bool:
    """Run the step; return whether numba compiled something."""
    with event.install_recorder("numba:compile") as compilations:
        step()
    return bool(compilations.buffer)


def initialize(context: WorkerContext) -> None:
    """Prepare this process for jobs, everything compiled."""
    for step in prepare(context):
        step()


def lower_priority(context: None = None) -> tuple[WarmUp, ...]:
    """Give this process a lower priority than the daemon, which receives the frames, and one thread a library."""
    os.nice(NICENESS)
    # N processes with M library threads each would only stall one another
    cv2.setNumThreads(1)
    threadpool_limits(1)
    return ()


def this_worker() -> Worker:
    """Return the state of this process; raise `WorkerFailure` before `initialize`."""
    if _worker is None:
        raise WorkerFailure("the worker was not initialized")
    return _worker


def measure(job: MeasureJob) -> MeasuredBundle:
    """Measure one bundle; return its record, and write its mesh, `silhouettes.tiff` and thumbnail.

    Raises `RecordingError` when nothing of the bundle can be read, `WorkerFailure` with the traceback as text for an
    exception that says nothing about the stone.
    """
    worker = this_worker()
    timings_ms: dict[str, float] = {}
    stage_start = time.perf_counter()
    # first of all: if the daemon ends now, it shows that a worker had this bundle
    job.out_dir.mkdir(parents=True, exist_ok=True)
    bundle = read_bundle(job.bundle_path, job.camera_ids, mapped=True, checked=job.checked)

    def on_stage(stage: str) -> None:
        nonlocal stage_start
        now = time.perf_counter()
        timings_ms[stage] = round(1000 * (now - stage_start), 2)
        stage_start = now

    parameters = worker.context.parameters
    skips_refinement = job.is_rushed and parameters.body.kind == "photo"
    if skips_refinement:
        body = replace(parameters.body, texture=bool(parameters.body.texture))
        parameters = replace(parameters, body=body, is_rushed=True)
    with worker_boundary():
        background = background_at(job.background_path)
        rig = rig_in(job.rig_file)
        on_stage("load")
        with view_mapper(job.threads) as mapper:
            result = measure_bundle(bundle, rig, background, worker.segmenter, parameters, on_stage, mapper)
        _write_files(job, result, worker.context)
        on_stage("write")
    timings_ms["total"] = round(sum(timings_ms.values()), 2)
    record = result_record(
        result,
        bundle.trigger,
        bundle=bundle.name,
        calibration_id=job.rig_file.calibration_id,
        is_simulated=worker.context.is_simulated,
        speed_at_gate_mm_s=parameters.fall.speed_at_gate_mm_s,
        timings_ms=timings_ms,
    )
    changes = {"mesh": None if result.mesh is None else MESH}
    if skips_refinement and result.measurement is not None:
        changes["refinement_fallback"] = RUSH
    seen = result.silhouettes.values()
    trouble = next((view.network_trouble for view in seen if view.network_trouble), None)
    return MeasuredBundle(record.model_copy(update=changes), trouble)


@contextmanager
def view_mapper(n_threads: int) -> Iterator[ViewMapper]:
    """Provide the `map` over views: the serial one, or that of a pool of threads."""
    if n_threads == 1:
        yield map
        return
    with ThreadPoolExecutor(n_threads, thread_name_prefix="views") as threads:
        yield threads.map


def _write_files(job: MeasureJob, result: ParticleResult, context: WorkerContext) -> None:
    if (mesh := result.mesh) is not None:
        write, name = (write_compact_mesh, COMPACT_MESH) if context.compact_meshes else (write_mesh, MESH)
        write(job.out_dir / name, mesh.vertices_mm, mesh.faces, result.greys)
        if context.draws_thumbnails and not job.is_rushed:
            png = preview.preview_png(mesh.vertices_mm, mesh.faces, result.greys, preview.THUMBNAIL_PX)
            (job.out_dir / THUMBNAIL).write_bytes(png)
    if job.save_silhouettes:
        seen = result.silhouettes
        size_px = next(iter(seen.values())).image_size_px
        regions = {camera: (silhouette.offset_uv, silhouette.labels) for camera, silhouette in seen.items()}
        write_silhouettes(job.out_dir / SILHOUETTES, regions, size_px)


def learn_background(
    *,
    bundle_path: Path,
    camera_ids: tuple[CameraId, ...],
    previous_path: Path | None,
    out_path: Path,
    threads: int = 1,
) -> dict[str, Any]:
    """Add one exposure of the empty rig to the background and write that into a new folder, `threads` views at a time.

    Returns the optics of each camera, see `service.results.record.optics_record`. Raises what `measure` raises.
    """
    bundle = read_bundle(bundle_path, camera_ids, mapped=True)
    with worker_boundary():
        previous = background_at(previous_path)

        def add(camera: CameraId) -> dict[str, Any]:
            known = {camera: previous[camera]} if camera in previous else {}
            seen = {camera: bundle.frames[camera]} if camera in bundle.frames else {}
            write_background(out_path, learn(known, seen))
            return optics_record(observe_all(seen, known))

        # camera by camera: all means at once are 84 MB of fresh memory
        with view_mapper(threads) as mapper:
            observed = mapper(add, sorted({*previous, *bundle.frames}))
            return {camera: figures for seen in observed for camera, figures in seen.items()}
