"""Reprojection errors of balls, of drops in the fit and of drops held out of it.

The reprojection error of a ball in a view is the offset between the axis of the cone of viewing rays that touch it
and the projection of its centre, which is fitted to all views of the same drop with the cameras fixed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.arrays import Floats, PointsUV
from pipeline.calibration.bundle_adjustment import (
    Noise,
    Solution,
    Tolerances,
    linearized,
    solve,
    triangulated,
)
from pipeline.calibration.robust_adjustment import Adjusted
from pipeline.calibration.sphere_image import Sightings, view_offsets_px
from pipeline.frames import CameraId

QUADRATIC = Noise(point_px=1e-3, wide_px=1e6)
"""Least squares without outliers; with the cameras fixed, the scale of the noise does not matter."""
N_FOLDS = 4
"""Number of parts of which each is held out once."""
MIN_FOLD_DROPS = 4
"""Least number of drops to calibrate with."""


def located_offsets_px(solution: Solution, sightings: Sightings) -> PointsUV:
    """Return the reprojection errors (V, 2) of balls that are located with the cameras of `solution` fixed."""
    n_drops = int(sightings.drop.max()) + 1
    start = replace(solution, centers_mm=triangulated(solution.cameras, sightings, n_drops))
    found = solve(start, sightings, noise=QUADRATIC, tolerances=Tolerances(), free_cameras=False)
    return view_offsets_px(sightings, linearized(found, sightings).residuals_px)[:, 1:]


def held_out_px(adjusted: Adjusted, tolerances: Tolerances) -> float | None:
    """Return the rms reprojection error of drops with a rig calibrated without them; `None` with too few drops."""
    drops, solution = np.arange(len(adjusted.drops)), adjusted.solution
    n_folds = min(N_FOLDS, len(drops))
    if n_folds == 0 or len(drops) - int(np.ceil(len(drops) / n_folds)) < MIN_FOLD_DROPS:
        return None
    squares: list[Floats] = []
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
    sightings: Sightings, offsets_px: PointsUV, camera_ids: Sequence[CameraId]
) -> Mapping[CameraId, float]:
    """Return for each camera that has any the rms length of its offsets (V, 2), px."""
    squares = (offsets_px**2).sum(axis=1)
    return {
        camera: float(np.sqrt(squares[sightings.camera == index].mean()))
        for index, camera in enumerate(camera_ids)
        if (sightings.camera == index).any()
    }
