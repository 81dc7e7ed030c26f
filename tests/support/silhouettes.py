"""Exact silhouettes of spheres, without images: ground truth for carving and consistency."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId
from pipeline.rig import CameraCalibration, RigCalibration
from pipeline.segmentation.silhouette import INSIDE, MARGIN_PX, OUTSIDE, Silhouette, SilhouetteSet, ViewStatus


def sphere_silhouette(
    camera: CameraCalibration, center_mm: NDArray[np.float64], radius_mm: float
) -> Silhouette:
    """Labels and signed distances from the angle between each pixel's ray and the tangent cone."""
    offset = center_mm - camera.center_mm
    tangent_angle = np.arcsin(radius_mm / np.linalg.norm(offset))
    ((u, v),) = camera.project(center_mm[None])[0]
    reach_px = int(np.tan(tangent_angle) * camera.focal_px * 1.05) + MARGIN_PX
    left, top = int(u) - reach_px, int(v) - reach_px
    grid_v, grid_u = np.mgrid[top : top + 2 * reach_px, left : left + 2 * reach_px]
    rays = camera.rays(np.stack([grid_u, grid_v], axis=-1).reshape(-1, 2))
    cosine = rays @ offset / np.linalg.norm(offset)
    angle = np.arccos(np.clip(cosine, -1, 1)).reshape(grid_u.shape)
    distance_px = ((tangent_angle - angle) * camera.focal_px).astype(np.float32)

    # the outline: rays on the tangent cone
    axis = offset / np.linalg.norm(offset)
    first = np.linalg.svd(axis[None])[2][1]
    second = np.cross(axis, first)
    phi = np.linspace(0, 2 * np.pi, 720, endpoint=False)[:, None]
    cone = np.cos(tangent_angle) * axis + np.sin(tangent_angle) * (np.cos(phi) * first + np.sin(phi) * second)
    return Silhouette(
        camera=camera.id,
        status=ViewStatus.OK,
        image_size_px=camera.image_size_px,
        offset_uv=(left, top),
        labels=np.where(distance_px > 0, INSIDE, OUTSIDE),
        measure_distance=lambda: np.clip(distance_px, -MARGIN_PX, MARGIN_PX),
        outline_uv=camera.project(camera.center_mm + 300 * cone)[0],
    )


def sphere_silhouettes(
    rig: RigCalibration,
    center_mm: Iterable[float] = (0.0, 0.0, 0.0),
    radius_mm: float = 7.5,
    cameras: Iterable[CameraId] | None = None,
) -> SilhouetteSet:
    """Silhouettes of one sphere in all cameras, or in some."""
    center = np.array(list(center_mm), dtype=np.float64)
    wanted = set(rig.camera_ids if cameras is None else cameras)
    return {
        camera.id: sphere_silhouette(camera, center, radius_mm)
        for camera in rig.cameras
        if camera.id in wanted
    }
