"""Outlines of convex bodies as every camera sees them, without images: ground truth for what watches the rig."""

from collections.abc import Mapping
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from support.outcomes import result

from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.views.consistency import ConsistencyParameters, displaced_views
from pipeline.views.epipolar_tangency import epipolar_tangents, image_shifts_px, tangency_scores_px
from service.results.fields import Result

Array = NDArray[np.float64]


def stone_points(rng: np.random.Generator, size_mm: float | None = None) -> Array:
    """Corners (N, 3) of a random convex body, 8 to 30 mm long, up to 2 mm off the centre."""
    longest_mm = rng.uniform(8, 30) if size_mm is None else size_mm
    corners = rng.normal(size=(rng.integers(12, 60), 3))
    corners /= np.linalg.norm(corners, axis=1, keepdims=True)
    corners *= longest_mm / 2 * np.array([1, rng.uniform(0.5, 1), rng.uniform(0.4, 1)])
    turned: Array = corners @ Rotation.random(rng=rng).as_matrix().T
    return turned + rng.uniform(-2, 2, size=3)


def seen_by(
    camera: CameraCalibration, points_mm: Array, rng: np.random.Generator, noise_px: float = 0.0
) -> Array:
    """Outline (N, 2) of the convex hull of points (N, 3), a point every pixel, each off by `noise_px` (sd)."""
    pixels_uv, _ = camera.project(points_mm)
    corners = cv2.convexHull(pixels_uv.astype(np.float32), returnPoints=False)[:, 0]
    start = pixels_uv[corners]
    step = np.roll(start, -1, axis=0) - start
    pieces = [
        corner + side * np.linspace(0, 1, max(int(np.linalg.norm(side)), 1), endpoint=False)[:, None]
        for corner, side in zip(start, step, strict=True)
    ]
    outline = np.concatenate(pieces)
    return outline + noise_px * rng.normal(size=outline.shape)


def stone_outlines(
    rig: RigCalibration, rng: np.random.Generator, noise_px: float = 0.0
) -> dict[CameraId, Array]:
    """What all cameras see of one random stone."""
    points_mm = stone_points(rng)
    return {camera.id: seen_by(camera, points_mm, rng, noise_px) for camera in rig.cameras}


def bumped(rig: RigCalibration, camera: str, turn_deg: Array) -> RigCalibration:
    """The rig with one camera turned about its own centre by a rotation vector (3,) in its own frame, degrees."""

    def turned(view: CameraCalibration) -> CameraCalibration:
        R = Rotation.from_rotvec(np.deg2rad(turn_deg)).as_matrix() @ view.R
        return replace(view, R=R, t_mm=-R @ view.center_mm)

    cameras = tuple(turned(view) if view.id == camera else view for view in rig.cameras)
    return replace(rig, cameras=cameras)


def watch_record(outlines: Mapping[CameraId, Array], rig: RigCalibration) -> Result:
    """What the rig's watch reads of the result of a stone with these outlines."""
    tangents = epipolar_tangents(outlines, rig)
    scores_px = tangency_scores_px(tangents)
    dropped, _ = displaced_views(tangents, scores_px, ConsistencyParameters())
    return result(
        outcome="measured",
        calibration_id=rig.calibration_id,
        tangency_px=scores_px,
        image_shifts_px=image_shifts_px(tangents),
        dropped_views={camera: str(why) for camera, why in dropped.items()},
    )
