"""What a worker does for a calibration: it observes a drop in its bundle, and solves the rig from all drops."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drivers.files.durable import write_json
from drivers.files.recording import read_bundle
from drivers.files.rig_file import read_rig, write_rig
from pipeline.calibration import (
    BallDrop,
    BallView,
    CalibrationError,
    Problem,
    calibrate,
    observe_ball,
    report_document,
)
from pipeline.calibration.ball_fit import fit_ball
from pipeline.calibration.ball_sizes import apparent_diameter_mm, with_diameters
from pipeline.calibration.self_calibration import StoneCalibration, recalibrate
from pipeline.errors import ProblemCode
from pipeline.frames import BundleKind, CameraId, FrameBundle
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import BackgroundModel, Segmenter, segment_all
from pipeline.views.epipolar_tangency import epipolar_tangents, outlines_of, tangency_scores_px
from service.calibration.drop_files import ObservedDrop, SeenCircle, read_drop, write_drop
from service.processing.measure_job import RigFile, this_worker
from service.processing.worker_process import worker_boundary

Method = Literal["bundle", "paper", "stones"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ObserveJob:
    """One ball or stone to observe; its outlines go to `out_path`."""

    bundle_path: Path
    camera_ids: tuple[CameraId, ...]
    rig: RigFile
    background_path: Path | None
    kind: BundleKind
    diameters_mm: tuple[float, ...]  # of the balls that fall
    out_path: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class SolveJob:
    """A calibration to solve; `rig.json` and `report.json` go into `folder`."""

    outline_paths: tuple[Path, ...]
    initial_path: Path  # rig file
    diameters_mm: tuple[float, ...]  # of the balls
    method: Method
    name: str
    created_at: str
    folder: Path


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """What came of it; without a `calibration_id` nothing could be solved."""

    calibration_id: str | None
    problems: tuple[Problem, ...]

    @property
    def refusal(self) -> str | None:
        """Why it must not be used."""
        return "; ".join(problem.detail for problem in self.problems if problem.is_fatal) or None


def observe(job: ObserveJob) -> ObservedDrop:
    """Find the outlines in the views of a bundle and compare them with the calibration in use.

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
        rig = worker.rig_in(job.rig)
        background = worker.background_at(job.background_path)
        # never the network: a view that cannot be compared with the empty rig is better left out of a calibration
        segmenter = worker.segmenter.classical
        if job.kind is BundleKind.BALL:
            drop = _sized(observe_ball(bundle, background, segmenter, None), job.diameters_mm, rig)
            observed = _ball_against(drop, rig)
        else:
            drop = _stone(bundle, background, segmenter)
            observed = _stone_against(drop, rig)
        write_drop(job.out_path, drop)
    return observed


def solve(job: SolveJob) -> Solution:
    """Calibrate the rig from drops.

    Raises
    ------
    WorkerFailure
        Anything but the reasons why nothing can be solved, with the traceback as text.
    """
    with worker_boundary():
        drops = [read_drop(path) for path in job.outline_paths]
        initial = read_rig(job.initial_path)
        try:
            rig, problems, document = _calibrated(job, drops, initial)
        except CalibrationError as err:
            return Solution(calibration_id=None, problems=err.problems)
        write_rig(job.folder / "rig.json", rig)
        write_json(job.folder / "report.json", document)
    return Solution(calibration_id=rig.calibration_id, problems=problems)


def _calibrated(
    job: SolveJob, drops: Sequence[BallDrop], initial: RigCalibration
) -> tuple[RigCalibration, tuple[Problem, ...], Mapping[str, Any]]:
    """The rig, what is to be said of it, and its report."""
    if job.method == "stones":
        stones = [{camera: view.outline_uv for camera, view in drop.views.items()} for drop in drops]
        found = recalibrate(stones, initial, created_at=job.created_at, name=job.name)
        problems = _stone_problems(found)
        return found.rig, problems, _stone_document(found, initial, drops, problems)
    balls = with_diameters(drops, initial, job.diameters_mm)
    report = calibrate(balls, initial, method=job.method, created_at=job.created_at, name=job.name)
    return report.rig, report.problems, report_document(report)


def _sized(drop: BallDrop, diameters_mm: tuple[float, ...], rig: RigCalibration) -> BallDrop:
    """The drop with that diameter of those entered which is nearest to what it looks like; all drops decide later."""
    apparent_mm = apparent_diameter_mm(drop, rig)
    if not diameters_mm or apparent_mm is None:
        return drop
    nearest_mm = min(diameters_mm, key=lambda each: max(each / apparent_mm, apparent_mm / each))
    return replace(drop, diameter_mm=nearest_mm)


def _ball_against(drop: BallDrop, rig: RigCalibration) -> ObservedDrop:
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


def _stone(bundle: FrameBundle, background: BackgroundModel, segmenter: Segmenter) -> BallDrop:
    """A stone's outlines in the place of a ball's."""
    silhouettes = segment_all(bundle.frames, background, segmenter)
    views = {}
    for camera, outline_uv in outlines_of(silhouettes).items():
        center_uv = outline_uv.mean(axis=0)
        radius_px = float(np.linalg.norm(outline_uv - center_uv, axis=1).mean())
        views[camera] = BallView(outline_uv=outline_uv, center_uv=center_uv, radius_px=radius_px, rms_px=0.0)
    refused = {camera: str(seen.status) for camera, seen in silhouettes.items() if not seen.is_usable}
    return BallDrop(name=bundle.name, diameter_mm=None, views=views, refused={**bundle.missing, **refused})


def _stone_against(drop: BallDrop, rig: RigCalibration) -> ObservedDrop:
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


def _stone_problems(found: StoneCalibration) -> tuple[Problem, ...]:
    if found.is_acceptable:
        return ()
    worst = max(found.scores_after_px, key=lambda camera: found.scores_after_px[camera])
    detail = (
        f"camera {worst} still contradicts the others by {found.scores_after_px[worst]:.2f} px: let more stones fall,"
        " or drop the ball"
    )
    return (Problem(code=ProblemCode.CONTRADICTION, detail=detail, camera=worst),)


def _stone_document(
    found: StoneCalibration,
    initial: RigCalibration,
    drops: Sequence[BallDrop],
    problems: Sequence[Problem],
) -> Mapping[str, Any]:
    """As far as it goes, in the words of a report on balls."""
    return {
        "method": "stones",
        "calibration_id": found.rig.calibration_id,
        "initial_calibration_id": initial.calibration_id,
        "scale": "not_observable",
        "drops_used": [drop.name for drop in drops],
        "residuals_before_px": dict(found.scores_before_px),
        "residuals_after_px": dict(found.scores_after_px),
        "moved": {camera: asdict(movement) for camera, movement in found.moved.items()},
        "held_out_px": max(found.scores_after_px.values(), default=None),
        "uncertainty": None,
        "is_acceptable": found.is_acceptable,
        "problems": [asdict(problem) for problem in problems],
    }
