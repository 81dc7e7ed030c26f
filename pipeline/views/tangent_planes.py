"""Where along a viewing ray the body can be: on the inner side of the planes that touch it.

A line that touches a silhouette's outline from outside, and the camera's centre, span a plane; the silhouette,
hence the body, is on one side of it. Where the edge was not seen all around, the silhouette may reach further than
its outline: there the planes are those around the view's whole region.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import View
from pipeline.compiled import compiled
from pipeline.rig.camera_arrays import CameraArrays
from pipeline.views.epipolar_tangency import OutlineHulls

Array = NDArray[np.float64]
Single = NDArray[np.float32]

N_ANGLES = 24
"""Planes a view."""
MOST_MM = 100.0
"""Of a ray is looked at to either side of its point, even if no plane ends it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planes:
    """P planes in the world frame: the body satisfies `normals @ x <= offsets_mm`."""

    normals: Array  # (P, 3) unit, outwards
    offsets_mm: Array  # (P,)
    mm_per_px: Array  # (P,) in the view's image, near the origin


def planes_around(views: Sequence[View], cameras: CameraArrays, hulls: OutlineHulls) -> Planes:
    """`N_ANGLES` planes through each camera's centre that touch the silhouette, or else its region."""
    angles = 2 * np.pi / N_ANGLES * np.arange(N_ANGLES)
    outwards = np.array([np.cos(angles), np.sin(angles)])
    along = outwards.T @ hulls.rays[:, :, :2].transpose(0, 2, 1)
    of_outlines = dict(zip(hulls.cameras, along.max(axis=2), strict=True))
    closed = {camera for camera, is_closed in zip(hulls.cameras, hulls.is_closed, strict=True) if is_closed}
    heights = [
        of_outlines[view[0].id] if view[0].id in closed else (_region_corners(view) @ outwards).max(axis=0)
        for view in views
    ]
    normals = np.empty((len(views), N_ANGLES, 3))
    normals[:, :, :2], normals[:, :, 2] = outwards.T, -np.array(heights)
    normals = normals @ cameras.R / np.sqrt(1 + normals[:, :, 2:] ** 2)
    eyes_mm = cameras.centers_mm
    mm_per_px = np.sqrt((eyes_mm * eyes_mm).sum(axis=1)) / cameras.focals_px
    return Planes(
        normals=normals.reshape(-1, 3),
        offsets_mm=(normals @ eyes_mm[:, :, None]).reshape(-1),
        mm_per_px=np.repeat(mm_per_px, N_ANGLES),
    )


def _region_corners(view: View) -> Array:
    """Where the viewing rays (4, 2) through the corners of the silhouette's region meet the plane at depth 1."""
    camera, silhouette = view
    height, width = silhouette.labels.shape
    return camera.flat_rays(
        silhouette.offset_uv + np.array([[0, 0], [width, 0], [0, height], [width, height]])
    )


def stretches_mm(planes: Planes, rays: Single, slack_px: float) -> tuple[Array, Array]:
    """From where to where (R,) planes, moved outwards, leave something of rays (6, R), points and directions.

    Of a ray of which they leave nothing it is the stretch between the planes that pass each other.
    """
    low_mm, high_mm = left_by(planes.normals, planes.offsets_mm + slack_px * planes.mm_per_px, rays)
    low_mm, high_mm = low_mm.clip(-MOST_MM, MOST_MM), high_mm.clip(-MOST_MM, MOST_MM)
    return np.minimum(low_mm, high_mm), np.maximum(low_mm, high_mm)


def left_by(normals: Array, offsets_mm: Array, rays: Array | Single) -> Array:
    """Ends (2, R) of what P planes leave of rays (6, R), points and directions; infinite where nothing ends one.

    In single precision: lengths of some ten mm are good to a few micrometres.
    """
    ends_mm = np.empty((2, rays.shape[1]), np.float32)
    ends_mm[0], ends_mm[1] = -np.inf, np.inf
    planes = np.column_stack([normals, offsets_mm]).astype(np.float32)
    _cut(planes, np.ascontiguousarray(rays, np.float32), ends_mm)
    return ends_mm.astype(np.float64)


@compiled
def _cut(planes: Single, rays: Single, ends_mm: Single) -> None:
    """Move the ends to what planes (P, 4), normals and offsets, leave.

    Rays in the inner loop: unlike the search for the least of all planes it runs in vectors.
    """
    zero, infinite = np.float32(0), np.float32(np.inf)
    for plane in range(len(planes)):
        x, y, z, offset_mm = planes[plane, 0], planes[plane, 1], planes[plane, 2], planes[plane, 3]
        for ray in range(rays.shape[1]):
            slope = rays[3, ray] * x + rays[4, ray] * y + rays[5, ray] * z
            reach_mm = offset_mm - (rays[0, ray] * x + rays[1, ray] * y + rays[2, ray] * z)
            end_mm = reach_mm / slope
            ends_mm[0, ray] = max(ends_mm[0, ray], end_mm if slope < zero else -infinite)
            ends_mm[1, ray] = min(ends_mm[1, ray], end_mm if slope > zero else infinite)
