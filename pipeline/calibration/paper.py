"""The paper's calibration (its Algorithm 1), implemented to the letter, as a reference to compare with.

For each drop: the centroids of the ball's silhouettes, the viewing rays through them by the initial matrices
P = K [R|t] (without distortion), and the point nearest to all of them (eq. 9). Then for each camera: the twelve
entries of P that minimise the sum of the distances (not of their squares) in px between the centroids and the
projections of those points (eq. 6), by SciPy's BFGS from the initial P.

Limits of the method. The points are triangulated with the initial cameras and never corrected. To first order, wrong
cameras yield an affine image of the true points, which a free P absorbs: the residuals fall from 70 px to hundredths,
while shape and scale of what is measured stay as wrong as before (the ball's diameter is not used). Iterating changes
nothing. A free P has eleven degrees of freedom for two observations per drop: with eight drops close together it is
ill conditioned, and where BFGS stops depends on the units, which the paper leaves open: in px and mm after a thousand
iterations at focal lengths between 100 and 13000 px, in metres at residuals of 2 px. Here the twelve entries are those
of normalized image coordinates and of lengths in units of the camera's distance, all about 1: BFGS converges within
fifty iterations, close to the initial camera in all that the drops do not determine. The centroid is not the image of
the centre. The principal point (640, 480) of eq. 10 belongs to an image of 1280 x 960, not 1280 x 1024; here it is
that of the initial rig.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import scipy  # imports its submodules on use

from pipeline.arrays import Floats, PointsMM, PointsUV, Values
from pipeline.calibration.drops import BallDrop, BallView
from pipeline.frames import CameraId, FrameBundle
from pipeline.rig.camera_arrays import nearest_point
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.document import decompose_projection
from pipeline.segmentation import Segmenter, Silhouette, segment_all
from pipeline.segmentation.silhouette import INSIDE

MIN_DROPS = 6
"""Two observations each for the eleven degrees of freedom of P."""


def observe_centroids(bundle: FrameBundle, masks: Segmenter, diameter_mm: float | None) -> BallDrop:
    """Return the ball of one exposure by the centroids of its masks, in all views that show one."""
    found = segment_all(bundle.frames, {}, masks).values()
    views = {each.camera: _view_of(each) for each in found if each.is_usable}
    refused = {each.camera: f"no ball in its mask: {each.status}" for each in found if not each.is_usable}
    return BallDrop(
        name=bundle.name, diameter_mm=diameter_mm, views=views, refused={**bundle.missing, **refused}
    )


def _view_of(silhouette: Silhouette) -> BallView:
    rows, columns = np.nonzero(silhouette.labels == INSIDE)
    center_uv = np.array([columns.mean(), rows.mean()]) + silhouette.offset_uv
    radius_px = float(np.sqrt(len(rows) / np.pi))
    distances = np.linalg.norm(silhouette.outline_uv - center_uv, axis=1) - radius_px
    rms_px = float(np.sqrt(np.mean(distances**2)))
    return BallView(outline_uv=silhouette.outline_uv, center_uv=center_uv, radius_px=radius_px, rms_px=rms_px)


def ball_points_mm(drops: Sequence[BallDrop], rig: RigCalibration) -> PointsMM:
    """Return for each of D drops, seen by at least two cameras, the point nearest to the rays through its centroids."""
    pinholes = {camera.id: replace(camera, distortion=np.zeros(5)) for camera in rig.cameras}
    points_mm = []
    for drop in drops:
        seen = [camera for camera in drop.views if camera in pinholes]
        origins_mm = np.array([pinholes[camera].center_mm for camera in seen])
        directions = np.concatenate([pinholes[camera].rays(drop.views[camera].center_uv) for camera in seen])
        points_mm.append(nearest_point(origins_mm, directions))
    return np.array(points_mm)


def refined(camera: CameraCalibration, points_mm: PointsMM, centroids_uv: PointsUV) -> CameraCalibration:
    """Return the camera whose P best projects the points to the centroids.

    Raises
    ------
    RigError
        No camera has the best P.
    """
    homogeneous = np.column_stack([points_mm, np.ones(len(points_mm))])
    lengths_mm = np.append(np.full(3, np.linalg.norm(camera.t_mm)), 1.0)

    def matrix(entries: Values) -> Floats:
        return camera.K @ entries.reshape(3, 4) / lengths_mm

    def error_px(entries: Values) -> float:
        return float(distances_px(matrix(entries), homogeneous, centroids_uv).sum())

    initial = np.linalg.solve(camera.K, camera.projection) * lengths_mm / lengths_mm[0]
    found = scipy.optimize.minimize(error_px, initial.ravel(), method="BFGS")
    K, R, t_mm = decompose_projection(matrix(found.x), f"camera {camera.id}")
    return replace(camera, K=K, distortion=np.zeros(5), R=R, t_mm=t_mm)


def residuals_px(
    drops: Sequence[BallDrop], points_mm: PointsMM, cameras: Sequence[CameraCalibration]
) -> Mapping[CameraId, float]:
    """Return for each camera the rms distance of the centroids from the projected points, as in the paper's Fig. 8."""
    residuals = {}
    for camera in cameras:
        seen = [d for d, drop in enumerate(drops) if camera.id in drop.views]
        homogeneous = np.column_stack([points_mm[seen], np.ones(len(seen))])
        distance_px = distances_px(camera.projection, homogeneous, centroids(drops, camera.id))
        residuals[camera.id] = float(np.sqrt(np.mean(distance_px**2)))
    return residuals


def centroids(drops: Sequence[BallDrop], camera: CameraId) -> PointsUV:
    """Return the centroids of the silhouettes that a camera saw."""
    return np.array([drop.views[camera].center_uv for drop in drops if camera in drop.views]).reshape(-1, 2)


def distances_px(P: Floats, homogeneous: Floats, centroids_uv: PointsUV) -> Values:
    """Return the distances between centroids and the projections by P (3, 4) of homogeneous points (N, 4)."""
    projected = homogeneous @ P.T
    return np.linalg.norm(projected[:, :2] / projected[:, 2:] - centroids_uv, axis=1)
