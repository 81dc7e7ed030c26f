"""The jobs of a calibration, with those who have them done: observe a drop in its bundle, solve the rig from drops."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.errors import RecordingError
from drivers.files.durable import write_json
from drivers.files.recording import read_bundle
from drivers.files.rig_file import read_rig, write_rig
from pipeline.calibration import BallDrop, CalibrationError
from pipeline.calibration.ball_fit import fit_ball
from pipeline.calibration.ball_sizes import apparent_diameter_mm
from pipeline.frames import BundleKind
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.views.epipolar_tangency import epipolar_tangents, tangency_scores_px
from service.calibration.drop_files import ObservedDrop, SeenCircle, read_drop, write_drop
from service.calibration.drops import observe_drop, refusal_of, solve_drops
from service.calibration.files import REPORT, RIG
from service.calibration.states import Method
from service.processing.measure_job import MeasureJob, background_at, lower_priority, rig_in, this_worker
from service.processing.processing import KeepDrop
from service.processing.worker_pool import JobLostError, JobPool, WorkerPool
from service.processing.worker_process import worker_boundary
from service.results.fields import Result

OUTLINES = "outlines.npz"
"""File of a drop's outlines, in the folder of the job that measures it."""
SOLVE_DEADLINE_S = 300.0
"""The paper's method takes half a minute of one core."""


@dataclass(frozen=True, slots=True)
class ObserveJob:
    """A ball or stone to observe, in the bundle of a job that measures it; its outlines are written to `outlines`."""

    job: MeasureJob
    kind: BundleKind
    diameters_mm: tuple[float, ...]  # of the balls that may fall

    @property
    def outlines(self) -> Path:
        return self.job.out_dir / OUTLINES


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveJob:
    """A calibration to solve; `rig.json` and `report.json` are written to `folder`."""

    outline_paths: tuple[Path, ...]
    initial_path: Path  # rig file
    diameters_mm: tuple[float, ...]  # of the balls
    method: Method
    name: str
    created_at: str
    folder: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Solved:
    """The outcome of a `SolveJob`; without a `calibration_id` there is no solution."""

    calibration_id: str | None
    refusal: str | None
    """Why the solution must not be used, or there is none; None when it may be used."""


Solver = Callable[[SolveJob], Awaitable[Solved]]


def observe(wanted: ObserveJob) -> ObservedDrop:
    """Find the outlines of a drop in the views of a bundle and compare them with the calibration in use.

    Raises `RecordingError` if nothing of the bundle can be read, `WorkerFailure` for anything else.
    """
    job, worker = wanted.job, this_worker()
    bundle = read_bundle(job.bundle_path, job.camera_ids, mapped=True)
    with worker_boundary():
        rig = rig_in(job.rig_file)
        background = background_at(job.background_path)
        # never the network, whose training an edge must not depend on: views without comparison are left out
        segmenter = BackgroundSegmenter(worker.context.parameters.segmentation)
        drop = observe_drop(bundle, background, segmenter, wanted.kind)
        if wanted.kind is BundleKind.BALL:
            drop = _with_nearest_diameter(drop, wanted.diameters_mm, rig)
        write_drop(wanted.outlines, drop)
        return _observed(drop, rig, wanted.kind)


def solve(job: SolveJob) -> Solved:
    """Calibrate the rig from drops, in a process of its own; raise `WorkerFailure` for an unexpected exception."""
    with worker_boundary():
        drops = [read_drop(path) for path in job.outline_paths]
        initial = read_rig(job.initial_path)
        try:
            solved = solve_drops(
                drops,
                initial,
                method=job.method,
                diameters_mm=job.diameters_mm,
                created_at=job.created_at,
                name=job.name,
            )
        except CalibrationError as err:
            return Solved(calibration_id=None, refusal=refusal_of(err.problems))
        write_rig(job.folder / RIG, solved.rig)
        write_json(job.folder / REPORT, solved.report)
    return Solved(calibration_id=solved.rig.calibration_id, refusal=solved.refusal)


async def solve_apart(job: SolveJob) -> Solved:
    """Run the job in a process of its own; raise `JobLostError` or `WorkerStartError` when that fails."""
    async with WorkerPool(
        slots=1, deadline_s=SOLVE_DEADLINE_S, prepare=lower_priority, context=None
    ) as pool:  # bundles do not wait for it
        return await pool.run(solve, job)


@dataclass(frozen=True, slots=True, kw_only=True)
class DropCollector:
    """Observes the drops of one kind and passes each on as soon as its result is durable."""

    kind: BundleKind
    diameters_mm: tuple[float, ...]
    """Diameters of the balls that may fall; empty for stones."""
    add: Callable[[ObservedDrop, Result, Path | None], Awaitable[None]]
    """Called with a drop, its result record, and the file of its outlines, None when nothing was observed."""

    async def observe(self, pool: JobPool, job: MeasureJob) -> KeepDrop:
        """Find the outlines of a drop in a worker. Return the awaitable that keeps them once its result is durable.

        A drop that cannot be observed is passed on with the problem.
        """
        observing = ObserveJob(job, self.kind, self.diameters_mm)
        problem: str | None = None
        try:
            drop = await pool.run(observe, observing)
        except RecordingError as err:
            problem = err.problem
        except JobLostError as err:
            problem = str(err)

        async def keep(record: Result) -> None:
            if problem is None:
                await self.add(drop, record, observing.outlines)
            else:
                await self.add(ObservedDrop(bundle=record.bundle, problem=problem), record, None)

        return keep


def _with_nearest_diameter(drop: BallDrop, diameters_mm: tuple[float, ...], rig: RigCalibration) -> BallDrop:
    """Give a ball the requested diameter closest to its apparent size; the solution decides with all drops."""
    apparent_mm = apparent_diameter_mm(drop, rig)
    if not diameters_mm or apparent_mm is None:
        return drop
    nearest_mm = min(diameters_mm, key=lambda each: max(each / apparent_mm, apparent_mm / each))
    return replace(drop, diameter_mm=nearest_mm)


def _observed(drop: BallDrop, rig: RigCalibration, kind: BundleKind) -> ObservedDrop:
    circles = {
        camera: SeenCircle(
            center_uv=(float(view.center_uv[0]), float(view.center_uv[1])), radius_px=view.radius_px
        )
        for camera, view in drop.views.items()
    }
    observed = ObservedDrop(
        bundle=drop.name, diameter_mm=drop.diameter_mm, views=circles, refused=dict(drop.refused)
    )
    if kind is not BundleKind.BALL:
        outlines = {camera: view.outline_uv for camera, view in drop.views.items()}
        scores_px = tangency_scores_px(epipolar_tangents(outlines, rig)) if outlines else {}
        return replace(observed, residuals_px=scores_px)
    if (fit := fit_ball(drop, rig)) is None:
        return observed
    return replace(
        observed,
        center_mm=fit.center_mm,
        residuals_px=dict(fit.residuals_px),
        vertical_minus_horizontal_mm=fit.vertical_minus_horizontal_mm,
    )
