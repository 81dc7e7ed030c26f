"""Find cameras that are exchanged in the rig file or at their plugs.

A camera that is a degree off its pose sees every ball shifted by the same hundred pixels; the *pattern* that the
balls form around their mean stays within a few pixels of the prediction for its place in the design. From another
place the same balls form another pattern. So each camera's image offset is left free, and images are assigned to
the places whose patterns they fit best.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # imports its submodules on use

from pipeline.arrays import Floats, PointsMM
from pipeline.calibration.drops import BallDrop
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration

N_REWEIGHTINGS = 20
N_ASSIGNMENTS = 4
"""Largest number of rounds of assigning images to places."""
MIN_MISFIT_PX = 1.0
"""Floor of the misfits in the weights, which stay finite."""
MIN_DROPS = 3
"""Least number of balls in a pattern; two points fit many places."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraOrder:
    """The place in the rig that each camera's images show; misfits are medians over the balls of a pattern."""

    place_of: Mapping[
        CameraId, CameraId
    ]  # camera that took the images -> camera of the rig file at that place
    own_misfit_px: Mapping[CameraId, float]  # of its images at the place that the rig file gives it
    misfit_px: Mapping[CameraId, float]  # of its images at `place_of`


def camera_order(drops: Sequence[BallDrop], rig: RigCalibration) -> CameraOrder | None:
    """Return the best assignment of images to places; `None` if too few drops show a pattern.

    The rig need not be accurate: errors of a few degrees do not matter.
    """
    patterns_uv = np.full((len(rig.cameras), len(drops), 2), np.nan)
    for i, camera in enumerate(rig.cameras):
        for j, drop in enumerate(drops):
            if camera.id in drop.views:
                patterns_uv[i, j] = drop.views[camera.id].center_uv
    is_judged = np.isfinite(patterns_uv[..., 0]).sum(axis=1) >= MIN_DROPS
    if is_judged.sum() < 3:
        return None
    ids = [camera.id for camera, judged in zip(rig.cameras, is_judged, strict=True) if judged]
    patterns_uv = patterns_uv[is_judged]
    scales = np.stack([_px_per_mm(rig.cameras[i]) for i in np.flatnonzero(is_judged)])
    places = np.arange(len(ids))
    for _ in range(N_ASSIGNMENTS):
        offsets_mm = _ball_offsets_mm(patterns_uv, scales[places])
        misfits_px = _misfits_px(patterns_uv, scales, offsets_mm)
        _, assigned = scipy.optimize.linear_sum_assignment(misfits_px)
        if (assigned == places).all():
            break
        places = assigned
    return CameraOrder(
        place_of={ids[i]: ids[place] for i, place in enumerate(places)},
        own_misfit_px={name: float(misfits_px[i, i]) for i, name in enumerate(ids)},
        misfit_px={name: float(misfits_px[i, places[i]]) for i, name in enumerate(ids)},
    )


def _px_per_mm(camera: CameraCalibration) -> Floats:
    """Return the derivative (2, 3) of the image point by the world point, at the origin."""
    steps_mm = np.concatenate([np.eye(3), -np.eye(3)])
    pixels_uv, _ = camera.project(steps_mm)
    return np.asarray((pixels_uv[:3] - pixels_uv[3:]).T / 2)


def _ball_offsets_mm(patterns_uv: Floats, scales: Floats) -> PointsMM:
    """Return the balls' places (N, 3), up to a common shift, from patterns (C, N, 2) seen under scales (C, 2, 3).

    The sum of distances is minimised, not of their squares: a few cameras or views that show something else do not
    matter.
    """
    n_cameras, n_drops = patterns_uv.shape[:2]
    cameras, drops = np.nonzero(np.isfinite(patterns_uv[..., 0]))
    design = np.zeros((len(cameras), 2, 3 * n_drops + 2 * n_cameras))
    for row, (i, j) in enumerate(zip(cameras, drops, strict=True)):
        design[row, :, 3 * j : 3 * j + 3] = scales[i]
        design[row, :, 3 * n_drops + 2 * i : 3 * n_drops + 2 * i + 2] = np.eye(2)
    seen_uv = patterns_uv[cameras, drops]
    weights = np.ones(len(cameras))
    for _ in range(N_REWEIGHTINGS):
        root = np.sqrt(weights)
        solution, *_ = np.linalg.lstsq(
            (design * root[:, None, None]).reshape(-1, design.shape[2]),
            (seen_uv * root[:, None]).ravel(),
            rcond=None,
        )
        weights = 1 / np.maximum(np.linalg.norm(design @ solution - seen_uv, axis=1), MIN_MISFIT_PX)
    return np.asarray(solution[: 3 * n_drops].reshape(-1, 3))


def _misfits_px(patterns_uv: Floats, scales: Floats, offsets_mm: PointsMM) -> Floats:
    """Return the median distance (C, C) between the pattern of a camera (row) and that of a place (column)."""
    predicted_uv = np.einsum("pij,nj->pni", scales, offsets_mm)
    difference_uv = patterns_uv[:, None] - predicted_uv[None]
    difference_uv -= np.nanmedian(difference_uv, axis=2, keepdims=True)
    return np.asarray(np.nanmedian(np.linalg.norm(difference_uv, axis=-1), axis=2))
