"""From bundles to drops and from drops to a rig, for the command and the daemon alike."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from pipeline.calibration import (
    BallDrop,
    BallView,
    CalibrationProblem,
    CalibrationReport,
    calibrate,
    observe_ball,
    report_document,
)
from pipeline.calibration.ball_sizes import with_diameters
from pipeline.calibration.self_calibration import StoneCalibration, recalibrate
from pipeline.errors import ProblemCode
from pipeline.frames import BundleKind, FrameBundle
from pipeline.rig.cameras import RigCalibration, rig_to_document
from pipeline.segmentation import BackgroundModel, Segmenter, segment_all
from pipeline.views.epipolar_tangency import outlines_of
from service.calibration.states import Method


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


def refusal_of(problems: Sequence[CalibrationProblem]) -> str | None:
    """Return the fatal problems in one line, None when there are none."""
    return "; ".join(problem.detail for problem in problems if problem.is_fatal) or None


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
