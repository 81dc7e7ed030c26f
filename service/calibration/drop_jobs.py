"""The jobs of a worker for a calibration: observe a drop in its bundle, solve the rig from all drops."""

from dataclasses import dataclass, replace
from pathlib import Path

from drivers.files.durable import write_json
from drivers.files.recording import read_bundle
from drivers.files.rig_file import read_rig, write_rig
from pipeline.calibration import (
    BallDrop,
    CalibrationError,
    CalibrationProblem,
)
from pipeline.calibration.ball_fit import fit_ball
from pipeline.calibration.ball_sizes import apparent_diameter_mm
from pipeline.frames import BundleKind, CameraId
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.views.epipolar_tangency import epipolar_tangents, tangency_scores_px
from service.calibration.drop_files import ObservedDrop, SeenCircle, read_drop, write_drop
from service.calibration.drops import observe_drop, refusal_of, solve_drops
from service.calibration.plan import Method
from service.processing.measure_job import RigFile, background_at, rig_in, this_worker
from service.processing.worker_process import worker_boundary


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserveJob:
    """A ball or stone to observe; its outlines are written to `out_path`."""

    bundle_path: Path
    camera_ids: tuple[CameraId, ...]
    rig_file: RigFile
    background_path: Path | None
    kind: BundleKind
    diameters_mm: tuple[float, ...]  # of the balls that may fall
    out_path: Path


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
    problems: tuple[CalibrationProblem, ...]

    @property
    def refusal(self) -> str | None:
        """Return the reason not to use the solution, None when it may be used."""
        return refusal_of(self.problems)


def observe(job: ObserveJob) -> ObservedDrop:
    """Find the outlines of a drop in the views of a bundle and compare them with the calibration in use.

    Raises
    ------
    RecordingError
        Nothing of the bundle can be read.
    WorkerFailure
        Anything else, with the traceback as text.
    """
    worker = this_worker()
    bundle = read_bundle(job.bundle_path, job.camera_ids, mapped=True)
    with worker_boundary():
        rig = rig_in(job.rig_file)
        background = background_at(job.background_path)
        # never the network, whose training an edge must not depend on: views without comparison are left out
        segmenter = BackgroundSegmenter(worker.context.parameters.segmentation)
        drop = observe_drop(bundle, background, segmenter, job.kind)
        if job.kind is BundleKind.BALL:
            drop = _with_nearest_diameter(drop, job.diameters_mm, rig)
            observed = _observed_ball(drop, rig)
        else:
            observed = _observed_stone(drop, rig)
        write_drop(job.out_path, drop)
    return observed


def solve(job: SolveJob) -> Solved:
    """Calibrate the rig from drops, in a process of its own.

    Raises
    ------
    WorkerFailure
        An unexpected exception, with the traceback as text; why nothing can be solved is in the `Solved`.
    """
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
            return Solved(calibration_id=None, problems=err.problems)
        write_rig(job.folder / "rig.json", solved.rig)
        write_json(job.folder / "report.json", solved.report)
    return Solved(calibration_id=solved.rig.calibration_id, problems=solved.problems)


def _with_nearest_diameter(drop: BallDrop, diameters_mm: tuple[float, ...], rig: RigCalibration) -> BallDrop:
    """Give a ball the requested diameter closest to its apparent size; the solution decides with all drops."""
    apparent_mm = apparent_diameter_mm(drop, rig)
    if not diameters_mm or apparent_mm is None:
        return drop
    nearest_mm = min(diameters_mm, key=lambda each: max(each / apparent_mm, apparent_mm / each))
    return replace(drop, diameter_mm=nearest_mm)


def _observed_ball(drop: BallDrop, rig: RigCalibration) -> ObservedDrop:
    observed = _observed(drop)
    fit = fit_ball(drop, rig)
    if fit is None:
        return observed
    return replace(
        observed,
        center_mm=fit.center_mm,
        residuals_px=dict(fit.residuals_px),
        vertical_minus_horizontal_mm=fit.vertical_minus_horizontal_mm,
    )


def _observed_stone(drop: BallDrop, rig: RigCalibration) -> ObservedDrop:
    outlines = {camera: view.outline_uv for camera, view in drop.views.items()}
    scores_px = tangency_scores_px(epipolar_tangents(outlines, rig)) if outlines else {}
    return replace(_observed(drop), residuals_px=scores_px)


def _observed(drop: BallDrop) -> ObservedDrop:
    circles = {
        camera: SeenCircle(
            center_uv=(float(view.center_uv[0]), float(view.center_uv[1])), radius_px=view.radius_px
        )
        for camera, view in drop.views.items()
    }
    return ObservedDrop(
        bundle=drop.name, diameter_mm=drop.diameter_mm, views=circles, refused=dict(drop.refused)
    )
