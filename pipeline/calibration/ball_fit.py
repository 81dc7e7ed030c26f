"""A ball measured with a rig as it is: where it was, how large it looks, whether it is round.

A viewing ray that touches a sphere passes its centre at exactly one radius, however the ball is seen. So the
distances between the centre and all rays through the outlines say everything: their mean is the radius, what
turns with the direction is a wrong centre (of the ball, or in one view of that camera), what differs between the
vertical and the horizontal is blur, since the ball moves while it is exposed.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration.coverage import ball_center_mm
from pipeline.calibration.drops import BallDrop
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration

MAX_ITERATIONS = 10
CONVERGED_MM = 1e-6
ALONG_THE_AXIS = 0.1
"""Of the singular values of a view's normals: the two across the viewing direction are more, the third is less."""

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class BallFit:
    """One ball, from all its views."""

    center_mm: tuple[float, float, float]
    diameter_mm: float
    vertical_minus_horizontal_mm: float  # of the diameter
    residuals_px: Mapping[CameraId, float]  # of the ball's centre in each view, against all views together


def fit_ball(drop: BallDrop, rig: RigCalibration) -> BallFit | None:
    """The ball that touches all viewing rays best, by least squares; `None` with fewer than two views."""
    ball_mm = ball_center_mm(drop, rig)
    if ball_mm is None:
        return None
    cameras = [camera for camera in rig.cameras if camera.id in drop.views]
    rays = [camera.rays(drop.views[camera.id].outline_uv) for camera in cameras]
    origins_mm = np.repeat([camera.center_mm for camera in cameras], [len(each) for each in rays], axis=0)
    directions = np.concatenate(rays)
    for _ in range(MAX_ITERATIONS):
        distances_mm, normals = _touching(ball_mm, origins_mm, directions)
        flattening = normals[:, 2] ** 2 - 1 / 3
        design = np.column_stack([normals, np.ones(len(normals)), flattening])
        solution = np.linalg.lstsq(design, distances_mm, rcond=None)[0]
        ball_mm = ball_mm + solution[:3]
        if np.abs(solution[:3]).max() < CONVERGED_MM:
            break
    errors_mm = distances_mm - design @ solution
    ends = np.cumsum([len(each) for each in rays])[:-1]
    residuals_px = {
        camera.id: float(np.linalg.norm(np.linalg.lstsq(normal, error_mm, rcond=ALONG_THE_AXIS)[0]))
        * camera.focal_px
        / float(np.linalg.norm(camera.center_mm - ball_mm))
        for camera, normal, error_mm in zip(
            cameras, np.split(normals, ends), np.split(errors_mm, ends), strict=True
        )
    }
    return BallFit(
        center_mm=(float(ball_mm[0]), float(ball_mm[1]), float(ball_mm[2])),
        diameter_mm=2 * float(solution[3]),
        vertical_minus_horizontal_mm=2 * float(solution[4]),
        residuals_px=residuals_px,
    )


def _touching(ball_mm: Array, origins_mm: Array, directions: Array) -> tuple[Array, Array]:
    """Distance (N,) of each ray from the centre, and the unit normals (N, 3) where the rays pass it."""
    from_ball_mm = origins_mm - ball_mm
    feet_mm = from_ball_mm - np.sum(from_ball_mm * directions, axis=1, keepdims=True) * directions
    distances_mm = np.linalg.norm(feet_mm, axis=1)
    return distances_mm, feet_mm / distances_mm[:, None]
