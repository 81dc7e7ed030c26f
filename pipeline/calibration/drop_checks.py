"""Checks of the drops before anything is solved: number, spread, camera order, sizes of the balls."""

from collections import Counter
from collections.abc import Iterator, Sequence
from statistics import median_low

from pipeline.calibration.acceptance_limits import AcceptanceLimits
from pipeline.calibration.ball_sizes import MAX_SCATTER, apparent_diameter_mm, either_wrong, ratio_per_edge_px
from pipeline.calibration.camera_order import camera_order
from pipeline.calibration.coverage import coverage
from pipeline.calibration.drops import BallDrop
from pipeline.errors import CalibrationProblem, ProblemCode
from pipeline.rig.cameras import RigCalibration


def too_few_drops(
    usable: Sequence[BallDrop], drops: Sequence[BallDrop], limits: AcceptanceLimits
) -> CalibrationProblem:
    """Return the problem that fewer drops than needed are usable."""
    reasons = Counter(reason for drop in drops for reason in drop.refused.values())
    why = "".join(f"; views were refused as {reason} ({n})" for reason, n in reasons.most_common(2))
    return CalibrationProblem(
        code=ProblemCode.TOO_FEW_DROPS,
        detail=f"only {len(usable)} of {len(drops)} drops are seen by {limits.min_views} cameras or more, "
        f"{limits.min_drops} are needed and {limits.good_drops} wanted{why}: drop more balls through the centre",
    )


def number_problems(
    usable: Sequence[BallDrop], initial: RigCalibration, limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    """Yield problems of few drops, in all or in one camera."""
    if len(usable) < limits.good_drops:
        yield CalibrationProblem(
            code=ProblemCode.FEW_DROPS,
            detail=f"{len(usable)} drops are few: from {limits.good_drops} on outliers are found reliably",
            is_fatal=False,
        )
    for camera in initial.camera_ids:
        n_seen = sum(camera in drop.views for drop in usable)
        if n_seen >= limits.good_camera_drops or n_seen == len(usable):
            continue
        reasons = Counter(drop.refused.get(camera, "no frame") for drop in usable if camera not in drop.views)
        why = ", ".join(f"{reason} ({n})" for reason, n in reasons.most_common(2))
        yield CalibrationProblem(
            code=ProblemCode.CAMERA_SAW_TOO_FEW,
            detail=f"camera {camera} saw {n_seen} of {len(usable)} drops whole (else {why}), "
            f"{limits.good_camera_drops} are wanted: look at its images, drop balls where it sees them",
            camera=camera,
            is_fatal=n_seen < limits.min_camera_drops,
        )


def order_problems(
    usable: Sequence[BallDrop], initial: RigCalibration, limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    """Yield cameras whose images show another camera's place, or none."""
    order = camera_order(usable, initial)
    if order is None:
        return
    misplaced = {
        camera: place
        for camera, place in order.place_of.items()
        if place != camera
        and order.own_misfit_px[camera]
        > max(limits.swap_misfit_px, limits.swap_ratio * order.misfit_px[camera])
    }
    for camera, place in misplaced.items():
        evidence = (
            f"the balls' pattern fits to {order.misfit_px[camera]:.0f} px "
            f"instead of {order.own_misfit_px[camera]:.0f}"
        )
        if misplaced.get(place) != camera:
            yield CalibrationProblem(
                code=ProblemCode.CAMERAS_SWAPPED,
                detail=f"the images of {camera} show the view of {place} in the initial rig ({evidence}): "
                "put the cameras in order, in the rig file or at their plugs",
                camera=camera,
            )
        elif camera < place:
            yield CalibrationProblem(
                code=ProblemCode.CAMERAS_SWAPPED,
                detail=f"cameras {camera} and {place} are swapped: each shows the view of the other in the "
                f"initial rig ({evidence}): exchange them in the rig file or at their plugs",
                camera=camera,
            )
    for camera, misfit_px in order.misfit_px.items():
        if misfit_px > limits.strange_misfit_px:
            yield CalibrationProblem(
                code=ProblemCode.CAMERA_OUT_OF_PLACE,
                detail=f"camera {camera} shows the balls where neither its own place nor another's has them (their "
                f"pattern is {misfit_px:.0f} px off): is it mirrored, turned, or a trigger late?",
                camera=camera,
            )


def size_problems(
    usable: Sequence[BallDrop], initial: RigCalibration, limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    """Yield problems of apparent sizes that differ among drops of one ball, or from the entered diameters."""
    groups: dict[float, dict[str, float]] = {}
    for drop in usable:
        size_mm = apparent_diameter_mm(drop, initial)
        if drop.diameter_mm is not None and size_mm is not None:
            groups.setdefault(drop.diameter_mm, {})[drop.name] = size_mm
    typical_mm = {entered: median_low(sizes.values()) for entered, sizes in groups.items()}
    for entered, sizes in groups.items():
        odd = {name: mm for name, mm in sizes.items() if abs(mm / typical_mm[entered] - 1) > MAX_SCATTER}
        if odd:
            names = ", ".join(f"{name} ({mm:.1f} mm)" for name, mm in odd.items())
            yield CalibrationProblem(
                code=ProblemCode.MIXED_SIZES,
                detail=f"not all drops are of one ball: many look {typical_mm[entered]:.1f} mm in the initial rig, "
                f"but {names}: enter both diameters, or leave these out",
                is_fatal=len(odd) > limits.good_left_out_share * len(sizes),
            )
        elif abs(typical_mm[entered] / entered - 1) * 100 > limits.apparent_size_percent:
            yield CalibrationProblem(
                code=ProblemCode.WRONG_DIAMETER,
                detail=f"the ball was entered as {entered:g} mm, but looks {typical_mm[entered]:.1f} mm in the initial "
                "rig: correct the diameter, or the focal lengths in the rig file",
            )
    if len(groups) < 2:
        return
    (small, small_seen), (large, large_seen) = sorted(typical_mm.items())[:: len(groups) - 1]
    relative = (small_seen / large_seen) / (small / large)
    edge_px = (relative - 1) / ratio_per_edge_px(small, large, initial)
    if abs(edge_px) > limits.max_apparent_edge_px:
        yield CalibrationProblem(
            code=ProblemCode.WRONG_DIAMETER,
            detail=f"a ball's diameter is wrong: they look as 1 to {large_seen / small_seen:.4f}, but were entered as "
            f"1 to {large / small:.4f}: {either_wrong(small, large, relative)}; measure both",
        )


def column_problems(
    usable: Sequence[BallDrop], initial: RigCalibration, limits: AcceptanceLimits
) -> Iterator[CalibrationProblem]:
    """Yield the problem that the drops fill a thin column only."""
    seen = coverage(usable, initial)
    width_mm = seen.spread_mm[1]
    if width_mm < limits.good_column_mm:
        extent = " x ".join(f"{mm:.0f}" for mm in seen.extent_mm)
        yield CalibrationProblem(
            code=ProblemCode.THIN_COLUMN,
            detail=f"the drops fill only {extent} mm (x, y, z; {width_mm:.1f} mm standard deviation across, "
            f"{limits.good_column_mm:g} are wanted): lengths beside them would be extrapolated; spread the drops: "
            f"{seen.missing or 'further out'}",
            is_fatal=width_mm < limits.min_column_mm,
        )
