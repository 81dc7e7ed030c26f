"""Exact silhouettes of spheres, without images: ground truth for carving and consistency."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.segmentation.silhouette import (
    FINE_PX,
    INSIDE,
    MARGIN_PX,
    OUTSIDE,
    UNKNOWN,
    KnownDistances,
    Silhouette,
    SilhouetteSet,
    ViewStatus,
)

SPARSE_PX = 8


def sphere_silhouette(
    camera: CameraCalibration, center_mm: NDArray[np.float64], radius_mm: float
) -> Silhouette:
    """Labels and signed distances from the angle between each pixel's ray and the tangent cone."""
    offset = center_mm - camera.center_mm
    tangent_angle = np.arcsin(radius_mm / np.linalg.norm(offset))
    ((u, v),) = camera.project(center_mm[None])[0]
    reach_px = int(np.tan(tangent_angle) * camera.focal_px * 1.05) + MARGIN_PX
    left, top = int(u) - reach_px, int(v) - reach_px
    slope_u, slope_v = _slopes(camera, left, top, 2 * reach_px)
    x, y, z = camera.R @ offset / np.linalg.norm(offset)
    cosine = (x * slope_u + y * slope_v + z) / np.sqrt(slope_u**2 + slope_v**2 + 1)
    angle = np.arccos(np.clip(cosine, -1, 1))
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
        distances=KnownDistances(np.clip(distance_px, -MARGIN_PX, MARGIN_PX)),
        outline_uv=camera.project(camera.center_mm + 300 * cone)[0],
    )


def _slopes(
    camera: CameraCalibration, left: int, top: int, size_px: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slopes (h, w) to the optical axis of the rays through a square of pixels, to 1e-3 px.

    A lens bends so little that between every `SPARSE_PX`-th pixel they are linear.
    """
    nodes = np.arange(0, size_px + SPARSE_PX, SPARSE_PX)
    grid_v, grid_u = np.meshgrid(top + nodes, left + nodes, indexing="ij")
    rays = camera.rays(np.stack([grid_u, grid_v], axis=-1).reshape(-1, 2)) @ camera.R.T
    weights = np.maximum(1 - np.abs(np.arange(size_px)[:, None] - nodes) / SPARSE_PX, 0)
    slope_u, slope_v = (
        weights @ (rays[:, axis] / rays[:, 2]).reshape(len(nodes), -1) @ weights.T for axis in range(2)
    )
    return slope_u, slope_v


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


def distances_of(silhouette: Silhouette) -> NDArray[np.float32]:
    """The signed distances (h, w) of all pixels: those that a silhouette was made with, else between the fine ones."""
    if isinstance(silhouette.distances, KnownDistances):
        return silhouette.distances.distance_px
    nodes_vu = np.indices(silhouette.labels.shape) / FINE_PX
    return np.asarray(map_coordinates(silhouette.fine_px, nodes_vu, order=1, mode="nearest"))


def hidden(silhouette: Silhouette, at: int, share: float) -> Silhouette:
    """The silhouette with a disc around the outline's point `at` unknown; its radius is a share of the width."""
    outline_uv = silhouette.outline_uv
    radius_px = share * np.ptp(outline_uv[:, 0])
    height, width = silhouette.labels.shape
    v, u = np.mgrid[:height, :width]
    center_u, center_v = outline_uv[at] - silhouette.offset_uv
    within_px = (radius_px - np.hypot(u - center_u, v - center_v)).clip(-MARGIN_PX, MARGIN_PX)
    known = np.linalg.norm(outline_uv - outline_uv[at], axis=1) > radius_px
    distance_px = np.maximum(distances_of(silhouette), within_px).astype(np.float32)
    return replace(
        silhouette,
        labels=np.where(within_px > 0, UNKNOWN, silhouette.labels),
        outline_uv=outline_uv[known],
        distances=KnownDistances(distance_px),
    )
