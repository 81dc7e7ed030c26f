"""Measure a ball with a calibrated rig: centre, diameter, and deviation from a sphere.

A viewing ray that touches a sphere passes its centre at exactly one radius, from whatever side. So the distances
between the centre and all rays through the outlines tell everything: their mean is the radius; a part that varies
as the cosine of the direction is a wrong centre (of the ball, or in one camera's view); a difference between vertical
and horizontal is motion blur.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Directions, PointsMM, Values, Vector
from pipeline.calibration.coverage import ball_center_mm
from pipeline.calibration.drops import BallDrop
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration

MAX_ITERATIONS = 10
CONVERGED_MM = 1e-6
"""Largest correction of the ball's centre, along any axis, at which the iteration ends."""
RANK_TOLERANCE = 0.1
"""Relative singular value of a view's normals below which a direction counts as unobserved: the two across the
viewing direction are above, the third is below."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BallFit:
    """Centre and diameter of one ball, fitted to all its views."""

    center_mm: tuple[float, float, float]
    diameter_mm: float
    vertical_minus_horizontal_mm: float  # difference of the diameters; motion blur makes it positive
    residuals_px: Mapping[
        CameraId, float
    ]  # distance of the ball's centre in one view from that of all views together


def fit_ball(drop: BallDrop, rig: RigCalibration) -> BallFit | None:
    """Return the ball that best touches all viewing rays, by least squares; `None` with fewer than two views."""
    ball_mm = ball_center_mm(drop, rig)
    if ball_mm is None:
        return None
    cameras = [camera for camera in rig.cameras if camera.id in drop.views]
    rays = [camera.rays(drop.views[camera.id].outline_uv) for camera in cameras]
    origins_mm = np.repeat(
        [camera.center_mm for camera in cameras], [len(view_rays) for view_rays in rays], axis=0
    )
    directions = np.concatenate(rays)
    for _ in range(MAX_ITERATIONS):
        distances_mm, normals = _ray_distances(ball_mm, origins_mm, directions)
        flattening = normals[:, 2] ** 2 - 1 / 3
        design = np.column_stack([normals, np.ones(len(normals)), flattening])
        solution = np.linalg.lstsq(design, distances_mm, rcond=None)[0]
        ball_mm = ball_mm + solution[:3]
        if np.abs(solution[:3]).max() < CONVERGED_MM:
            break
    errors_mm = distances_mm - design @ solution
    ends = np.cumsum([len(view_rays) for view_rays in rays])[:-1]
    residuals_px = {
        camera.id: float(np.linalg.norm(np.linalg.lstsq(normal, error_mm, rcond=RANK_TOLERANCE)[0]))
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


def _ray_distances(
    ball_mm: Vector, origins_mm: PointsMM, directions: Directions
) -> tuple[Values, Directions]:
    """Return the distance of each ray from the ball's centre, and the unit vectors from it to the nearest points."""
    from_ball_mm = origins_mm - ball_mm
    feet_mm = from_ball_mm - np.sum(from_ball_mm * directions, axis=1, keepdims=True) * directions
    distances_mm = np.linalg.norm(feet_mm, axis=1)
    return distances_mm, feet_mm / distances_mm[:, None]
