"""Checks of a solution: against the initial rig, by its residuals, and by its uncertainty."""

from collections.abc import Iterator, Sequence

import numpy as np

from pipeline.calibration.acceptance_limits import AcceptanceLimits
from pipeline.calibration.ball_sizes import either_wrong, ratio_per_edge_px
from pipeline.calibration.bundle_adjustment import Tolerances
from pipeline.calibration.drops import BallDrop
from pipeline.calibration.movement import image_changes_px, steps
from pipeline.calibration.report import CalibrationReport, FoundLenses, NumberWithSd, ScaleSource
from pipeline.calibration.robust_adjustment import adjust
from pipeline.calibration.uncertainty import common_factors, covariance
from pipeline.errors import CalibrationProblem, ProblemCode, RigError
from pipeline.rig.cameras import RigCalibration, rig_to_document
from pipeline.rig.document import rig_from_document

UNKNOWN_DISTANCE_MM = 30.0
"""Prior of the cameras' places where only the balls are to determine their distance."""


def plausibility_problems(report: CalibrationReport) -> Iterator[CalibrationProblem]:
    """Yield the problem that the solution is no valid rig document."""
    try:
        rig_from_document(rig_to_document(report.rig))
    except RigError as err:
        camera = None if err.camera_index is None else report.rig.camera_ids[err.camera_index]
        remedy = (
            "with so few drops the paper's free matrices do not converge; drop more, or use the method bundle"
            if report.rig.method == "paper"
            else "a camera was moved or turned by far; put it back in its place"
        )
        yield CalibrationProblem(
            code=ProblemCode.IMPLAUSIBLE_RIG,
            detail=f"the drops lead to an impossible rig ({err}): {remedy}",
            camera=camera,
        )


def left_out_problems(
    report: CalibrationReport, drops: Sequence[BallDrop], limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    """Yield the problem that too few drops remain, or that many contradict the others."""
    n_used, n_left_out = len(report.drops_used), len(report.drops_left_out)
    is_fatal = n_used < limits.min_drops
    if is_fatal or n_left_out > limits.good_left_out_share * len(drops):
        reasons = "; ".join(f"{name}: {reason}" for name, reason in list(report.drops_left_out.items())[:3])
        yield CalibrationProblem(
            code=ProblemCode.TOO_FEW_DROPS if is_fatal else ProblemCode.MANY_DROPS_LEFT_OUT,
            detail=f"only {n_used} of {len(drops)} drops could be used ({reasons}): drop more balls, one at a time",
            is_fatal=is_fatal,
        )


def step_problems(
    report: CalibrationReport, drops: Sequence[BallDrop], limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    """Yield cameras whose images shifted between two drops."""
    focal_px = {camera.id: camera.focal_px for camera in report.rig.cameras}
    for camera, step in steps(drops, report.rig, report.ball_centers_mm).items():
        if step.shift_px > limits.step_px and step.significance > limits.step_significance:
            yield CalibrationProblem(
                code=ProblemCode.CAMERA_MOVED_DURING_DROPS,
                detail=f"camera {camera} moved while the balls fell: after {step.after} its images are shifted by "
                f"{step.shift_px:.1f} px ({_as_rotation(step.shift_px, focal_px[camera])}): fasten it and drop again",
                camera=camera,
            )


def contradiction_problems(
    report: CalibrationReport, drops: Sequence[BallDrop], limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    """Yield cameras most of whose views contradict the others' and were left out."""
    for camera in report.rig.camera_ids:
        seen = [drop.name for drop in drops if camera in drop.views and drop.name in report.drops_used]
        n_against = sum(camera in report.views_left_out.get(name, {}) for name in seen)
        if n_against > limits.max_contradicting_share * len(seen):
            yield CalibrationProblem(
                code=ProblemCode.CAMERA_CONTRADICTS,
                detail=f"camera {camera} contradicts the others in {n_against} of {len(seen)} drops: is it loose, "
                "or its exposure not that of the others? Fasten it and drop again",
                camera=camera,
            )


def moved_problems(report: CalibrationReport, limits: AcceptanceLimits) -> Iterator[CalibrationProblem]:
    """Yield cameras that are not where the initial rig has them."""
    shifts_px = image_changes_px(report.rig, report.initial)
    median_px = float(np.median(list(shifts_px.values())))
    focal_px = {camera.id: camera.focal_px for camera in report.rig.cameras}
    for camera, shift_px in shifts_px.items():
        if shift_px > max(limits.moved_px, limits.moved_ratio * median_px):
            yield CalibrationProblem(
                code=ProblemCode.CAMERA_MOVED,
                detail=f"camera {camera} does not stand where the initial rig has it: its image is shifted by "
                f"{shift_px:.1f} px ({_as_rotation(shift_px, focal_px[camera])}), the others' by {median_px:.1f} px; "
                "the new calibration corrects it, see that it is fastened",
                camera=camera,
                is_fatal=False,
            )


def scale_problems(
    report: CalibrationReport, drops: Sequence[BallDrop], limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    """Yield problems of scale: deviations from the design, which has distances accurately and focal lengths roughly.

    A ball entered 5 percent too large makes the whole rig 5 percent larger, a longer focal length only enlarges its
    images: perspective tells one from the other.
    """
    if report.scale is not ScaleSource.BALL_DIAMETER:
        yield CalibrationProblem(
            code=ProblemCode.SCALE_NOT_OBSERVABLE,
            detail="the scale cannot be observed without the diameter of a ball: lengths are those of the initial rig, "
            "some tenths of a percent off as built, 9 percent if its focal length is only the lens's name",
            is_fatal=False,
        )
    if report.scale is not ScaleSource.BALL_DIAMETER or report.rig.method == "paper":
        return
    distance, focal = factors_by_balls(drops, report.initial)
    distance_percent, focal_percent = 100 * (distance.value - 1), 100 * (focal.value - 1)
    sd_percent = 100 * distance.sd
    where = "further away" if distance_percent > 0 else "nearer"
    perspective = f"{abs(distance_percent):.2f} +- {sd_percent:.2f} percent {where}"
    if abs(distance_percent) > max(limits.distance_percent, 4 * sd_percent):
        likely = ", ".join(
            f"{diameter_mm / distance.value:.2f} instead of {diameter_mm:g} mm"
            for diameter_mm in sorted({drop.diameter_mm for drop in drops if drop.diameter_mm is not None})
        )
        yield CalibrationProblem(
            code=ProblemCode.WRONG_DIAMETER,
            detail=f"the ball's diameter is wrong: with it all cameras stand {perspective} than the initial "
            f"rig has them; likely it is {likely}: measure it (if it is right, correct the initial rig)",
        )
    elif abs(focal_percent) > limits.focal_percent and abs(focal_percent) < 4 * sd_percent:
        yield CalibrationProblem(
            code=ProblemCode.FOCAL_LENGTH_OR_DIAMETER,
            detail=f"all focal lengths come out {focal_percent:+.1f} percent from the initial rig's, and these drops "
            "cannot tell a wrong focal length in the rig file from a wrong diameter of the ball (perspective shows "
            f"the distances to +- {sd_percent:.1f} percent only): spread the drops, or measure the ball",
        )
    elif abs(focal_percent) > limits.focal_percent:
        hint = " (a 25 mm lens focused at 300 mm has +9.1)" if 7 < focal_percent < 11 else ""
        yield CalibrationProblem(
            code=ProblemCode.FOCAL_LENGTH,
            detail=f"all focal lengths are {focal_percent:+.1f} percent from the initial rig's{hint}; the new "
            "calibration corrects it (the ball's diameter is not the cause: by perspective the cameras stand "
            f"{perspective} than the initial rig has them)",
            is_fatal=False,
        )
    yield from _odd_lenses(report, limits)


def factors_by_balls(drops: Sequence[BallDrop], initial: RigCalibration) -> tuple[NumberWithSd, NumberWithSd]:
    """Return the common factors of distances and of focal lengths to the initial rig's, as the balls alone show them.

    The drops are adjusted once more for this, almost without a prior on the distances.
    """
    tolerances = Tolerances(center_mm=UNKNOWN_DISTANCE_MM)
    adjusted = adjust(drops, initial, tolerances)
    return common_factors(
        adjusted.solution,
        covariance(
            adjusted.solution,
            adjusted.sightings,
            noise=adjusted.noise,
            tolerances=tolerances,
            free_edge=adjusted.free_edge,
        ),
    )


def _odd_lenses(report: CalibrationReport, limits: AcceptanceLimits) -> Iterator[CalibrationProblem]:
    """Yield cameras whose focal length deviates from the other cameras'."""
    for camera, initial in zip(report.rig.cameras, report.initial.cameras, strict=True):
        percent = 100 * (camera.focal_px / initial.focal_px / report.focal_factor.value - 1)
        if abs(percent) > limits.focal_percent:
            yield CalibrationProblem(
                code=ProblemCode.FOCAL_LENGTH,
                detail=f"the focal length of camera {camera.id} is {percent:+.1f} percent from the other cameras'; the "
                "new calibration corrects it, see that it has the right lens and is focused",
                camera=camera.id,
                is_fatal=False,
            )


def focus_problems(report: CalibrationReport, limits: AcceptanceLimits) -> Iterator[CalibrationProblem]:
    """Yield cameras that are sharpest beside the middle of the measuring volume."""
    if not isinstance(report.lenses, FoundLenses):
        return
    middles_mm = {camera.id: float(camera.t_mm[2]) for camera in report.rig.cameras}
    for camera, focus_mm in report.lenses.focus_mm.items():
        middle_mm = middles_mm[camera]
        off_mm = focus_mm.value - middle_mm
        if abs(off_mm) > max(limits.good_focus_mm, limits.focus_significance * focus_mm.sd):
            yield CalibrationProblem(
                code=ProblemCode.OUT_OF_FOCUS,
                detail=f"camera {camera} is sharpest {abs(off_mm):.1f} +- {focus_mm.sd:.1f} mm "
                f"{'behind' if off_mm > 0 else 'before'} the middle of the measuring volume: focus it on the middle, "
                f"{middle_mm:.0f} mm away, fasten it and calibrate again",
                camera=camera,
                is_fatal=False,
            )


def residual_problems(report: CalibrationReport, limits: AcceptanceLimits) -> Iterator[CalibrationProblem]:
    """Yield cameras with large residuals, and a large residual of the drops held out."""
    # large residuals of the paper's method are no fault of the drops
    is_strict = report.rig.method != "paper"
    for camera, residual_px in report.residuals_after_px.items():
        if residual_px > limits.good_residual_px:
            yield CalibrationProblem(
                code=ProblemCode.LARGE_RESIDUAL,
                detail=f"camera {camera} sees the balls {residual_px:.2f} px (rms) beside where the solution has them, "
                f"{limits.good_residual_px:g} is sound: look for a loose camera, a wet lens, bodies besides the ball",
                camera=camera,
                is_fatal=is_strict and residual_px > limits.max_residual_px,
            )
    if report.held_out_px is not None and report.held_out_px > limits.good_residual_px:
        yield CalibrationProblem(
            code=ProblemCode.LARGE_HELD_OUT_RESIDUAL,
            detail=f"balls that were not used are {report.held_out_px:.2f} px (rms) beside their prediction, "
            f"{limits.good_residual_px:g} is sound: more drops, further apart",
            is_fatal=is_strict and report.held_out_px > limits.max_residual_px,
        )


def uncertainty_problems(report: CalibrationReport, limits: AcceptanceLimits) -> Iterator[CalibrationProblem]:
    """Yield the problem that lengths are too uncertain."""
    if report.uncertainty is not None:
        percent = report.uncertainty.length_sd_percent
        if report.scale is ScaleSource.BALL_DIAMETER and percent > limits.good_length_percent:
            yield CalibrationProblem(
                code=ProblemCode.UNCERTAIN_LENGTHS,
                detail=f"lengths are known to {percent:.2f} percent only, {limits.good_length_percent:g} is sound: "
                "more drops, further apart",
                is_fatal=percent > limits.max_length_percent,
            )


def edge_problems(
    report: CalibrationReport, drops: Sequence[BallDrop], limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    """Yield the problem of a large offset of all outlines, as balls of two sizes show it."""
    offset_px = report.edge_offset_px
    if offset_px is not None and abs(offset_px) > limits.good_edge_px:
        diameters_mm = [drop.diameter_mm for drop in drops if drop.diameter_mm is not None]
        small_mm, large_mm = min(diameters_mm), max(diameters_mm)
        relative = 1 + offset_px * ratio_per_edge_px(small_mm, large_mm, report.rig)
        yield CalibrationProblem(
            code=ProblemCode.LARGE_EDGE_OFFSET,
            detail=f"by the two diameters all outlines are {offset_px:+.2f} px too large, up to "
            f"{limits.good_edge_px:g} is sound: {either_wrong(small_mm, large_mm, relative)}, or the images are "
            "out of focus; measure both balls",
            is_fatal=abs(offset_px) > limits.max_edge_px,
        )


def _as_rotation(shift_px: float, focal_px: float) -> str:
    return f"as if turned by {np.rad2deg(shift_px / focal_px):.2g} degrees"
