"""Bundle adjustment with outliers: views and drops that contradict the others are found, named and left out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from pipeline.arrays import Values
from pipeline.calibration.bundle_adjustment import (
    N_CAMERA,
    Noise,
    Solution,
    Tolerances,
    linearized,
    point_weights,
    prior_precision,
    solve,
    triangulated,
)
from pipeline.calibration.drops import BallDrop
from pipeline.calibration.sphere_image import N_SECTORS, Sightings, sightings_of, view_offsets_px
from pipeline.errors import CalibrationError, CalibrationProblem, ProblemCode
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration

APPROACH = (Noise(point_px=20.0, wide_px=1e6), Noise(point_px=1.0, wide_px=5.0))
"""Noise assumed in the first fits: far from the solution the priors must outweigh the outlines, whose residuals of
some 70 px are not linear in the parameters."""
MIN_VIEWS = 3
"""Least number of views of a drop."""
MIN_DROPS = 3
"""Least number of drops that must agree."""
MIN_NOISE_PX = 0.002
OUTLIER_SIGMAS = 8.0
MIN_OUTLIER_PX = 0.3
"""A view that is less off is no outlier: soft-L1 bounds its effect."""
ROUNDS = 12
"""Largest number of rounds, in each of which every camera may lose one view."""
MIN_SIZE_RATIO = 1.1
"""Least ratio of two balls' diameters by which an offset of the outlines can be told from a scale."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adjusted:
    """A solution with the drops and views it rests on."""

    drops: tuple[BallDrop, ...]  # those used, without the views left out
    drops_left_out: Mapping[str, str]
    views_left_out: Mapping[str, Mapping[CameraId, str]]
    sightings: Sightings
    solution: Solution
    noise: Noise
    free_edge: bool


def adjust(drops: Sequence[BallDrop], initial: RigCalibration, tolerances: Tolerances) -> Adjusted:
    """Solve for the rig that explains most of the drops.

    Raises
    ------
    CalibrationError
        Fewer than three drops agree with one another.
    """
    drops_left_out: dict[str, str] = {}
    views_left_out: dict[str, dict[CameraId, str]] = {}
    known = set(initial.camera_ids)
    drops = [
        replace(drop, views={camera: view for camera, view in drop.views.items() if camera in known})
        for drop in drops
    ]
    used = _seen_enough(drops, views_left_out, drops_left_out)
    sightings = sightings_of(used, initial.camera_ids)
    solution = Solution(
        initial=initial.cameras,
        parameters=np.zeros((len(initial.cameras), N_CAMERA)),
        centers_mm=triangulated(initial.cameras, sightings, len(used)),
    )
    for noise in APPROACH:
        solution = solve(solution, sightings, noise=noise, tolerances=tolerances)
    # twice, since the first time the noise is estimated from the approach's residuals
    solution = _refitted(solution, sightings, tolerances, _has_two_sizes(used))
    for _ in range(ROUNDS):
        solution = _refitted(solution, sightings, tolerances, _has_two_sizes(used))
        kept = _without_worst(used, solution, sightings, tolerances, views_left_out)
        kept = _seen_enough(kept, views_left_out, drops_left_out)
        if sum(len(drop.views) for drop in kept) == len(sightings):
            break
        names = {drop.name for drop in kept}
        solution = replace(
            solution, centers_mm=solution.centers_mm[np.array([drop.name in names for drop in used])]
        )
        used, sightings = kept, sightings_of(kept, initial.camera_ids)
    return Adjusted(
        drops=tuple(used),
        drops_left_out=drops_left_out,
        views_left_out=views_left_out,
        sightings=sightings,
        solution=solution,
        noise=_noise(solution, sightings),
        free_edge=_has_two_sizes(used),
    )


def _refitted(solution: Solution, sightings: Sightings, tolerances: Tolerances, free_edge: bool) -> Solution:
    """Solve again with the noise estimated from the present residuals."""
    return solve(
        solution if free_edge else replace(solution, edge_px=0.0),
        sightings,
        noise=_noise(solution, sightings),
        tolerances=tolerances,
        free_edge=free_edge,
    )


def _seen_enough(
    drops: Sequence[BallDrop],
    views_left_out: Mapping[str, Mapping[CameraId, str]],
    left_out: dict[str, str],
) -> list[BallDrop]:
    """Return the drops with enough agreeing views; the reasons for the others are added to `left_out`."""
    kept = []
    for drop in drops:
        n_views, n_bad = len(drop.views), len(views_left_out.get(drop.name, ()))
        if n_bad > n_views:
            left_out[drop.name] = (
                f"{n_bad} of {n_bad + n_views} views contradict the other drops: a ball of another size, "
                "or not all cameras exposed together"
            )
        elif n_views < MIN_VIEWS:
            left_out[drop.name] = f"only {n_views} usable views, {MIN_VIEWS} are needed"
        else:
            kept.append(drop)
    if len(kept) < MIN_DROPS:
        problem = CalibrationProblem(
            code=ProblemCode.TOO_FEW_DROPS,
            detail=f"only {len(kept)} of {len(kept) + len(left_out)} drops agree with one another, {MIN_DROPS} are "
            "needed: check that each exposure shows one ball, of the diameter entered, and drop more",
        )
        raise CalibrationError([problem])
    return kept


def _has_two_sizes(drops: Sequence[BallDrop]) -> bool:
    sizes_mm = [drop.diameter_mm for drop in drops if drop.diameter_mm is not None]
    return bool(sizes_mm) and max(sizes_mm) / min(sizes_mm) > MIN_SIZE_RATIO


def _noise(solution: Solution, sightings: Sightings) -> Noise:
    """Estimate the noise from the centres' residuals, since the errors of one view's points are correlated."""
    offsets_px = view_offsets_px(sightings, linearized(solution, sightings).residuals_px)[:, 1:]
    n_unknowns = solution.parameters.size + solution.centers_mm.size
    # with few drops the priors determine part of the unknowns
    freedom = max(1 - n_unknowns / (3 * len(sightings)), 0.25)
    center_px = max(1.4826 * float(np.median(np.abs(offsets_px))) / sqrt(freedom), MIN_NOISE_PX)
    point_px = center_px * sqrt(N_SECTORS / 2)
    return Noise(point_px=point_px, wide_px=3 * point_px)


def _without_worst(
    drops: Sequence[BallDrop],
    solution: Solution,
    sightings: Sightings,
    tolerances: Tolerances,
    left_out: dict[str, dict[CameraId, str]],
) -> list[BallDrop]:
    """Return the drops without the worst outlier of each camera, which is added to `left_out`.

    An outlier is a view that shows the ball elsewhere, or of another size, than all views together. It also bends its
    camera and shifts its ball, so that sound views seem to be off: these are judged after its removal.
    """
    offsets_px = view_offsets_px(sightings, linearized(solution, sightings).residuals_px)
    noise = _noise(solution, sightings)
    misfits_px = _studentized_px(solution, sightings, noise, tolerances)
    greatest_px = max(OUTLIER_SIGMAS * noise.center_px, MIN_OUTLIER_PX)
    worst_of_drop_px = np.zeros(len(drops))
    np.maximum.at(worst_of_drop_px, sightings.drop, misfits_px)
    kept = list(drops)
    for index, camera in enumerate(solution.initial):
        own = np.flatnonzero(sightings.camera == index)
        if len(own) == 0:
            continue
        worst = own[np.argmax(misfits_px[own])]
        number = int(sightings.drop[worst])
        if misfits_px[worst] <= max(greatest_px, worst_of_drop_px[number] / 2):
            continue
        larger, du, dv = offsets_px[worst]
        left_out.setdefault(drops[number].name, {})[camera.id] = (
            f"{np.hypot(du, dv):.2f} px beside its place and {larger:+.2f} px in radius, by all views together"
        )
        others = {owner: view for owner, view in kept[number].views.items() if owner != camera.id}
        kept[number] = replace(kept[number], views=others)
    return kept


def _studentized_px(solution: Solution, sightings: Sightings, noise: Noise, tolerances: Tolerances) -> Values:
    """Return the studentized residual of each view (V,), px: corrected for its own pull on the solution.

    Without the view the sum of squares would fall by e^T W (I - H)^-1 e, where H is the hat matrix of its points. A
    camera with few views of far drops pulls so strongly that the plain residuals would blame the other cameras.
    """
    blocks = linearized(solution, sightings)
    weights = point_weights(blocks, sightings, noise)
    precision = prior_precision(len(solution.initial), len(solution.centers_mm), tolerances)
    normal, _ = blocks.normal_equations(weights, len(precision))
    inverse = np.linalg.inv(normal + precision)
    own = inverse[blocks.unknowns[:, :, None], blocks.unknowns[:, None, :]]
    followed = blocks.jacobian @ own @ blocks.jacobian.transpose(0, 2, 1) * weights[:, None, :]
    unbent_px = np.linalg.solve(np.eye(N_SECTORS) - followed, blocks.residuals_px[..., None])[..., 0]
    # as a shift of the circle, half of whose square appears in its points' radial residuals on average
    squares = (sightings.weights * blocks.residuals_px * unbent_px).sum(axis=1)
    return np.sqrt(np.maximum(squares, 0) / (N_SECTORS / 2))
