"""Silhouettes of a ball, computed without images: input to compile loops with before the first stone."""

import numpy as np

from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.segmentation.silhouette import (
    INSIDE,
    MARGIN_PX,
    OUTSIDE,
    KnownDistances,
    Silhouette,
    ViewStatus,
)

RADIUS_MM = 5.0


def ball_silhouettes(rig: RigCalibration) -> dict[CameraId, Silhouette]:
    """Return the silhouettes of a ball in the middle of the rig, one per camera."""
    return {camera.id: _silhouette(camera) for camera in rig.cameras}


def _silhouette(camera: CameraCalibration) -> Silhouette:
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle_mm = RADIUS_MM * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    outline_uv = camera.project(circle_mm @ camera.R[:2])[0]
    left, top = np.floor(outline_uv.min(axis=0)).astype(int) - MARGIN_PX
    right, bottom = np.ceil(outline_uv.max(axis=0)).astype(int) + MARGIN_PX
    center_uv = outline_uv.mean(axis=0)
    u, v = np.arange(left, right) - center_uv[0], np.arange(top, bottom) - center_uv[1]
    radius_px = np.linalg.norm(outline_uv - center_uv, axis=1).mean()
    from_center_px = np.sqrt(np.add.outer(v * v, u * u).astype(np.float32))
    distance_px = np.clip(np.float32(radius_px) - from_center_px, -MARGIN_PX, MARGIN_PX)
    return Silhouette(
        camera=camera.id,
        status=ViewStatus.OK,
        image_size_px=camera.image_size_px,
        offset_uv=(int(left), int(top)),
        labels=np.where(distance_px > 0, INSIDE, OUTSIDE),
        outline_uv=outline_uv,
        distances=KnownDistances(distance_px),
    )
