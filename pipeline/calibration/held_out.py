"""Balls against a rig: where each view shows a ball's centre, beside where all views together have it.

The *offset* of a view is that of the axis of the cone of viewing rays that touch the ball from the projection of the
ball's centre, which is fitted to all views of the same drop with the cameras held: the reprojection error of a ball.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration.bundle_adjustment import (
    Noise,
    Solution,
    Tolerances,
    linearized,
    solve,
    triangulated,
)
from pipeline.calibration.robust import Adjusted
from pipeline.calibration.sphere_image import Sightings, view_offsets_px
from pipeline.frames import CameraId

Array = NDArray[np.float64]

QUADRATIC = Noise(point_px=1e-3, wide_px=1e6)
"""Every view counts, and only the balls are free: the scale of the noise does not matter."""
N_FOLDS = 4
LEAST_FOLD_DROPS = 4


def located_offsets_px(solution: Solution, sightings: Sightings) -> Array:
    """Offsets (V, 2) px, in each view, of balls that are located with the cameras of `solution` held."""
    n_drops = int(sightings.drop.max()) + 1
    start = replace(solution, centers_mm=triangulated(solution.cameras, sightings, n_drops))
    found = solve(start, sightings, noise=QUADRATIC, tolerances=Tolerances(), free_cameras=False)
    return view_offsets_px(sightings, linearized(found, sightings).residuals_px)[:, 1:]


def held_out_px(adjusted: Adjusted, tolerances: Tolerances) -> float | None:
    """Rms distance of ball centres from where a rig has them that was calibrated without these drops."""
    drops, solution = np.arange(len(adjusted.drops)), adjusted.solution
    n_folds = min(N_FOLDS, len(drops))
    if n_folds == 0 or len(drops) - int(np.ceil(len(drops) / n_folds)) < LEAST_FOLD_DROPS:
        return None
    squares: list[Array] = []
    for k in range(n_folds):
        is_held = drops % n_folds == k
        fitted = solve(
            replace(solution, centers_mm=solution.centers_mm[~is_held]),
            adjusted.sightings.of_drops(drops[~is_held]),
            noise=adjusted.noise,
            tolerances=tolerances,
            free_edge=adjusted.free_edge,
        )
        held = adjusted.sightings.of_drops(drops[is_held])
        offsets_px = located_offsets_px(fitted, held)
        squares.append((offsets_px**2).sum(axis=1))
    return float(np.sqrt(np.concatenate(squares).mean()))


def rms_by_camera(
    sightings: Sightings, offsets_px: Array, camera_ids: Sequence[CameraId]
) -> Mapping[CameraId, float]:
    """Rms distance in px of the offsets (V, 2) of each camera that has any."""
    squares = (offsets_px**2).sum(axis=1)
    return {
        camera: float(np.sqrt(squares[sightings.camera == index].mean()))
        for index, camera in enumerate(camera_ids)
        if (sightings.camera == index).any()
    }
