"""From bundles to drops and from drops to a rig: functions for the command, and jobs of workers for the daemon."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drivers.errors import RecordingError
from drivers.files.durable import write_json
from drivers.files.recording import read_bundle
from drivers.files.rig_file import read_rig, write_rig
from pipeline.calibration import (
    BallDrop,
    BallView,
    CalibrationError,
    CalibrationProblem,
    CalibrationReport,
    calibrate,
    observe_ball,
    report_document,
)
from pipeline.calibration.ball_fit import fit_ball
from pipeline.calibration.ball_sizes import apparent_diameter_mm, with_diameters
from pipeline.calibration.self_calibration import StoneCalibration, recalibrate
from pipeline.errors import ProblemCode
from pipeline.frames import BundleKind, FrameBundle
from pipeline.rig.cameras import RigCalibration, rig_to_document
from pipeline.segmentation import BackgroundModel, Segmenter, segment_all
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.views.epipolar_tangency import epipolar_tangents, outlines_of, tangency_scores_px
from service.base.messages import Code, CodedFinding, CodedText, joined
from service.calibration.drop_files import ObservedDrop, SeenCircle, read_drop, write_drop
from service.calibration.files import REPORT, RIG
from service.calibration.states import Method
from service.processing.measure_job import MeasureJob, background_at, lower_priority, rig_in, this_worker
from service.processing.processing import KeepDrop
from service.processing.worker_pool import JobPool, WorkerPool
from service.processing.worker_process import worker_boundary
from service.processing.worker_slot import JobLostError
from service.results.fields import Result

OUTLINES = "outlines.npz"
"""File of a drop's outlines, in the folder of the job that measures it."""
SOLVE_DEADLINE_S = 300.0
"""The paper's method takes half a minute of one core."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SolvedRig:
    """A rig solved from drops, and the evidence for it."""

    evidence: CalibrationReport | StoneCalibration
    problems: tuple[CalibrationProblem, ...]
    report: Mapping[str, Any]
    """The evidence and the problems, JSON-ready."""

    @property
    def rig(self) -> RigCalibration:
        """Return the rig that was solved."""
        return self.evidence.rig

    @property
    def refusal(self) -> str | None:
        """Return the reason not to use the rig, None when it may be used."""
        return refusal_of(self.problems)


def refusal_of(problems: Sequence[CalibrationProblem]) -> CodedText | None:
    """Return the fatal problems in one line, None when there are none."""
    return joined([_coded(problem) for problem in problems if problem.is_fatal])


def _coded(problem: CalibrationProblem) -> CodedText:
    subjects = () if problem.camera is None else (f"camera:{problem.camera}",)
    parameters = {"problem": str(problem.code), "reported": problem.detail}
    found = CodedFinding(code=Code.CALIBRATION_PROBLEM, subjects=subjects, parameters=parameters)
    return CodedText(problem.detail, [found])


def observe_drop(
    bundle: FrameBundle, background: BackgroundModel, segmenter: Segmenter, kind: BundleKind
) -> BallDrop:
    """Find the outlines of a ball, or of a stone, in the views of a bundle; a stone has no diameter."""
    if kind is BundleKind.BALL:
        return observe_ball(bundle, background, segmenter, None)
    silhouettes = segment_all(bundle.frames, background, segmenter)
    views = {}
    for camera, outline_uv in outlines_of(silhouettes).items():
        center_uv = outline_uv.mean(axis=0)
        radius_px = float(np.linalg.norm(outline_uv - center_uv, axis=1).mean())
        views[camera] = BallView(outline_uv=outline_uv, center_uv=center_uv, radius_px=radius_px, rms_px=0.0)
    refused = {camera: str(seen.status) for camera, seen in silhouettes.items() if not seen.is_usable}
    return BallDrop(name=bundle.name, diameter_mm=None, views=views, refused={**bundle.missing, **refused})


def solve_drops(
    drops: Sequence[BallDrop],
    initial: RigCalibration,
    *,
    method: Method,
    diameters_mm: Sequence[float],
    created_at: str,
    name: str,
) -> SolvedRig:
    """Calibrate the rig from drops, starting from an initial one; raise `CalibrationError` with the problems."""
    match method:
        case Method.STONES:
            stones = [{camera: view.outline_uv for camera, view in drop.views.items()} for drop in drops]
            found = recalibrate(stones, initial, created_at=created_at, name=name)
            problems = _contradictions(found)
            return SolvedRig(
                evidence=found, problems=problems, report=_stone_report(found, initial, drops, problems)
            )
        case Method.BUNDLE | Method.PAPER:
            balls = with_diameters(drops, initial, diameters_mm)
            kind: Literal["bundle", "paper"] = "bundle" if method is Method.BUNDLE else "paper"
            report = calibrate(balls, initial, method=kind, created_at=created_at, name=name)
            return SolvedRig(evidence=report, problems=report.problems, report=report_document(report))


def _contradictions(found: StoneCalibration) -> tuple[CalibrationProblem, ...]:
    if found.is_acceptable:
        return ()
    worst = max(found.scores_after_px, key=lambda camera: found.scores_after_px[camera])
    detail = (
        f"camera {worst} still contradicts the others by {found.scores_after_px[worst]:.2f} px: let more stones fall,"
        " or calibrate with a ball"
    )
    return (CalibrationProblem(code=ProblemCode.CONTRADICTION, detail=detail, camera=worst),)


def _stone_report(
    found: StoneCalibration,
    initial: RigCalibration,
    drops: Sequence[BallDrop],
    problems: Sequence[CalibrationProblem],
) -> Mapping[str, Any]:
    """Return the evidence under the keys of a report on balls where these apply, and under its own."""
    return {
        "method": "stones",
        "calibration_id": found.rig.calibration_id,
        "initial_calibration_id": initial.calibration_id,
        "scale": "not_observable",
        "drops_used": [drop.name for drop in drops],
        "stones_fitted": found.n_fitted,
        "stones_judging": found.n_judges,
        "residuals_before_px": dict(found.scores_before_px),
        "residuals_after_px": dict(found.scores_after_px),
        "tangency_before_px": dict(found.scores_before_px),
        "tangency_after_px": dict(found.scores_after_px),
        "moved": {camera: asdict(movement) for camera, movement in found.moved.items()},
        "held_out_px": max(found.scores_after_px.values(), default=None),
        "uncertainty": None,
        "is_acceptable": found.is_acceptable,
        "problems": [asdict(problem) for problem in problems],
        "rig": rig_to_document(found.rig),
    }


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


def observe(job: MeasureJob, kind: BundleKind, diameters_mm: tuple[float, ...]) -> ObservedDrop:
    """Find the outlines of a drop in the views of a measured bundle and compare them with the calibration in use.

    `diameters_mm` are those of the balls that may fall. Raises `RecordingError` if nothing of the bundle can be read,
    `WorkerFailure` for anything else.
    """
    worker = this_worker()
    bundle = read_bundle(job.bundle_path, job.camera_ids, mapped=True)
    with worker_boundary():
        rig = rig_in(job.rig_file)
        background = background_at(job.background_path)
        # never the network, whose training an edge must not depend on: views without comparison are left out
        segmenter = BackgroundSegmenter(worker.context.parameters.segmentation)
        drop = observe_drop(bundle, background, segmenter, kind)
        if kind is BundleKind.BALL:
            drop = _with_nearest_diameter(drop, diameters_mm, rig)
        write_drop(job.out_dir / OUTLINES, drop)
        return _observed(drop, rig, kind)


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
        return await pool.run(partial(solve, job))


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
        problem: str | None = None
        try:
            drop = await pool.run(partial(observe, job, self.kind, self.diameters_mm))
        except RecordingError as err:
            problem = err.problem
        except JobLostError as err:
            problem = str(err)

        async def keep(record: Result) -> None:
            if problem is None:
                await self.add(drop, record, job.out_dir / OUTLINES)
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
