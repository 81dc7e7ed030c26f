"""What a worker process does: one bundle file in, one result record and its files out.

The offline command and the daemon run these very functions, so their results are equal bit for bit,
whatever the number of workers.
"""

import os
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import trimesh
from threadpoolctl import threadpool_limits

from drivers.recording import read_bundle, write_bundle
from drivers.rig_file import read_rig
from pipeline import estimate
from pipeline.frames import CameraId
from pipeline.measuring import measure_shape
from pipeline.particle import ParticleResult, PipelineParameters, measure_bundle
from pipeline.rig import RigCalibration
from pipeline.segmentation import BackgroundModel
from pipeline.segmentation.background import learn_background as learn
from pipeline.segmentation.choice import ChoosingSegmenter
from pipeline.segmentation.optics import observe_all
from service.background_file import read_background, write_background
from service.errors import WorkerFailure
from service.record import optics_record, result_record
from service.segmenters import CLASSICAL, SegmenterPlan, build_segmenter, warm_up


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerContext:
    """What all jobs of a worker share."""

    parameters: PipelineParameters
    is_simulated: bool
    speed_at_gate_mm_s: float = 0.0  # of the stones, as the gate's beam closes
    segmentation: SegmenterPlan = CLASSICAL


@dataclass(frozen=True, slots=True)
class RigFile:
    """A calibration: its file, never rewritten under its name, and the id its content has."""

    path: Path
    calibration_id: str


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureJob:
    """One bundle to measure; its files go into `out_dir`, which is made."""

    bundle_path: Path
    camera_ids: tuple[CameraId, ...]
    rig: RigFile
    background_path: Path | None
    out_dir: Path
    archive: bool = False  # keep the frames as `bundle.tiff`
    save_silhouettes: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class LearnJob:
    """One exposure of the empty rig to fold into the background."""

    bundle_path: Path
    camera_ids: tuple[CameraId, ...]
    previous_path: Path | None
    out_path: Path


@dataclass(slots=True)
class Worker:
    """A worker process: what its jobs share, and what it keeps from one to the next."""

    context: WorkerContext
    segmenter: ChoosingSegmenter
    background_path: Path | None = None
    background: BackgroundModel | None = None
    rig_file: RigFile | None = None
    rig: RigCalibration | None = None

    def background_at(self, path: Path | None) -> BackgroundModel:
        """The model in a file; the last one is kept, files are never rewritten under their name."""
        if path is None:
            return {}
        if self.background is None or path != self.background_path:
            self.background, self.background_path = read_background(path), path
        return self.background

    def rig_in(self, file: RigFile) -> RigCalibration:
        """The calibration in a file; the last one is kept. `ValueError` when it is not the one that is meant."""
        if self.rig is None or file != self.rig_file:
            rig = read_rig(file.path)
            if rig.calibration_id != file.calibration_id:
                raise ValueError(
                    f"{file.path} holds calibration {rig.calibration_id}, not {file.calibration_id}"
                )
            self.rig, self.rig_file = rig, file
        return self.rig


_worker: Worker | None = None


def initialize(context: WorkerContext) -> None:
    """Prepare this process.

    Ends with a first measurement, which also builds the tables that all later ones share.
    """
    global _worker
    step_back()
    segmenter = build_segmenter(context.segmentation, context.parameters.segmentation)
    warm_up(segmenter)
    _worker = Worker(context=context, segmenter=segmenter)
    estimate.warm_up()
    measure_shape(trimesh.creation.icosphere(subdivisions=2, radius=5.0))


def step_back(context: None = None) -> None:
    """Frames come first: this process yields the processor to the daemon, and uses one core."""
    os.nice(10)
    # N processes with M library threads each would only stall one another
    cv2.setNumThreads(1)
    threadpool_limits(1)


def this_worker() -> Worker:
    """Return what this process keeps; raise `WorkerFailure` before `initialize`."""
    if _worker is None:
        raise WorkerFailure("the worker was not initialized")
    return _worker


@contextmanager
def worker_boundary() -> Iterator[None]:
    """Turn whatever goes wrong within into a `WorkerFailure` with the traceback as text: it travels home as it is."""
    try:
        yield
    except Exception as err:  # noqa: BLE001 - the one place where everything is caught
        raise WorkerFailure("".join(traceback.format_exception(err))) from None


def measure(job: MeasureJob) -> dict[str, Any]:
    """The result record of one bundle; writes `mesh.ply`, `silhouettes/<camera>.png` and `bundle.tiff`.

    Raises
    ------
    RecordingError
        Nothing of the bundle can be read.
    WorkerFailure
        Anything that is not the stone's fault; carries the traceback as text.
    """
    worker = this_worker()
    timings_ms: dict[str, float] = {}
    stage_start = time.perf_counter()
    bundle = read_bundle(job.bundle_path, job.camera_ids)

    def on_stage(stage: str) -> None:
        nonlocal stage_start
        now = time.perf_counter()
        timings_ms[stage] = round(1000 * (now - stage_start), 2)
        stage_start = now

    with worker_boundary():
        background = worker.background_at(job.background_path)
        rig = worker.rig_in(job.rig)
        on_stage("load")
        result = measure_bundle(
            bundle, rig, background, worker.segmenter, worker.context.parameters, on_stage
        )
        _write_files(job, result)
        if job.archive:
            write_bundle(job.out_dir / "bundle.tiff", bundle, job.camera_ids, compression="zstd")
        on_stage("write")
    timings_ms["total"] = round(sum(timings_ms.values()), 2)
    record = result_record(
        result,
        bundle.trigger,
        bundle=bundle.name,
        calibration_id=job.rig.calibration_id,
        is_simulated=worker.context.is_simulated,
        speed_at_gate_mm_s=worker.context.speed_at_gate_mm_s,
        timings_ms=timings_ms,
    )
    record["mesh"] = None if result.mesh is None else "mesh.ply"
    return record


def _write_files(job: MeasureJob, result: ParticleResult) -> None:
    job.out_dir.mkdir(parents=True, exist_ok=True)
    if result.mesh is not None:
        mesh = trimesh.Trimesh(result.mesh.vertices_mm, result.mesh.faces, process=False)
        mesh.export(job.out_dir / "mesh.ply")
    if job.save_silhouettes:
        folder = job.out_dir / "silhouettes"
        folder.mkdir(exist_ok=True)
        for camera, silhouette in result.silhouettes.items():
            # no parameters: with any of them OpenCV takes four times as long
            cv2.imwrite(str(folder / f"{camera}.png"), silhouette.label_image())


def learn_background(job: LearnJob) -> dict[str, Any]:
    """Fold one exposure of the empty rig into the background and write it as a new file.

    Returns the optical figures of each camera, see `record.optics_record`.

    Raises
    ------
    RecordingError
        Nothing of the bundle can be read.
    WorkerFailure
        Anything else, with the traceback as text.
    """
    bundle = read_bundle(job.bundle_path, job.camera_ids)
    with worker_boundary():
        previous = {} if job.previous_path is None else read_background(job.previous_path)
        write_background(job.out_path, learn(previous, bundle.frames))
        return optics_record(observe_all(bundle.frames, previous))
