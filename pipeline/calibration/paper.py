"""The paper's calibration (its Algorithm 1), to the letter, as the reference to compare with.

For each drop: the centroids of the ball's silhouettes, the viewing rays through them by the initial matrices
P = K [R|t] (without distortion), and the point nearest to all of them (eq. 9). Then for each camera: the twelve
entries of P that minimise the sum of the distances (not of their squares) in px between the centroids and the
projections of those points (eq. 6), by SciPy's BFGS from the initial P.

What it cannot do. The points are made with the initial cameras and never corrected, and to first order wrong cameras
return an affine image of the true points, which a free P absorbs: the residuals fall from 70 px to hundredths, and
the shape and scale of what is measured stay as wrong as they were (the ball's diameter is not used). Repeating it
changes nothing. A free P has eleven degrees of freedom for two observations a drop: with eight drops close together
it is ill conditioned, and where BFGS stops depends on the units, which the paper leaves open: in px and mm after a
thousand iterations at focal lengths between 100 and 13000 px, in metres at residuals of 2 px. Here the twelve entries
are those of normalized image coordinates and of lengths in units of the camera's distance, all about 1: it converges
within fifty iterations, near the initial camera in all that the drops do not show. The centroid is not the image of
the centre. The principal point (640, 480) of its eq. 10 belongs to an image of 1280 x 960, not 1280 x 1024; here the
initial rig says where it is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy  # what is used of it is imported then
from numpy.typing import NDArray

from pipeline.calibration.drops import BallDrop
from pipeline.calibration.nearest_point import nearest_point
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.document import decompose_projection

Array = NDArray[np.float64]

LEAST_DROPS = 6
"""Two observations each for the eleven degrees of freedom of P."""


def ball_points_mm(drops: Sequence[BallDrop], rig: RigCalibration) -> Array:
    """(D, 3): for each drop, seen by at least two cameras, the point nearest to the rays through its centroids."""
    pinholes = {camera.id: replace(camera, distortion=np.zeros(5)) for camera in rig.cameras}
    points_mm = []
    for drop in drops:
        seen = [camera for camera in drop.views if camera in pinholes]
        origins_mm = np.array([pinholes[camera].center_mm for camera in seen])
        directions = np.concatenate([pinholes[camera].rays(drop.views[camera].center_uv) for camera in seen])
        points_mm.append(nearest_point(origins_mm, directions))
    return np.array(points_mm)


def refined(camera: CameraCalibration, points_mm: Array, centroids_uv: Array) -> CameraCalibration:
    """The camera whose P best projects points (N, 3) to centroids (N, 2).

    Raises
    ------
    RigError
        The best P is no camera's.
    """
    homogeneous = np.column_stack([points_mm, np.ones(len(points_mm))])
    lengths_mm = np.append(np.full(3, np.linalg.norm(camera.t_mm)), 1.0)

    def matrix(entries: Array) -> Array:
        return camera.K @ entries.reshape(3, 4) / lengths_mm

    def error_px(entries: Array) -> float:
        return float(distances_px(matrix(entries), homogeneous, centroids_uv).sum())

    initial = np.linalg.solve(camera.K, camera.projection) * lengths_mm / lengths_mm[0]
    found = scipy.optimize.minimize(error_px, initial.ravel(), method="BFGS")
    K, R, t_mm = decompose_projection(matrix(found.x), f"camera {camera.id}")
    return replace(camera, K=K, distortion=np.zeros(5), R=R, t_mm=t_mm)


def residuals_px(
    drops: Sequence[BallDrop], points_mm: Array, cameras: Sequence[CameraCalibration]
) -> Mapping[CameraId, float]:
    """Per camera the rms distance of the centroids from the projected points, as in the paper's Fig. 8."""
    residuals = {}
    for camera in cameras:
        seen = [d for d, drop in enumerate(drops) if camera.id in drop.views]
        homogeneous = np.column_stack([points_mm[seen], np.ones(len(seen))])
        distance_px = distances_px(camera.projection, homogeneous, centroids(drops, camera.id))
        residuals[camera.id] = float(np.sqrt(np.mean(distance_px**2)))
    return residuals


def centroids(drops: Sequence[BallDrop], camera: CameraId) -> Array:
    """(N, 2) of the silhouettes that this camera saw."""
    return np.array([drop.views[camera].center_uv for drop in drops if camera in drop.views]).reshape(-1, 2)


def distances_px(P: Array, homogeneous: Array, centroids_uv: Array) -> Array:
    """(N,) between centroids (N, 2) and the projections by P (3, 4) of points (N, 4)."""
    projected = homogeneous @ P.T
    return np.linalg.norm(projected[:, :2] / projected[:, 2:] - centroids_uv, axis=1)
