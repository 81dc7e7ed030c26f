"""The stretch of a viewing ray where the body can be: on the inner side of the planes that touch it.

A line that touches a silhouette's outline from outside, and the camera's centre, span a plane; the silhouette,
hence the body, is on one side of it. Where the edge was not seen all around, the silhouette may reach further than
its outline: there the planes are those around the view's whole region.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from pipeline.arrays import Directions, Floats, PointsUV, Singles, Values
from pipeline.compiled import compiled
from pipeline.rig.cameras import CameraCalibration
from pipeline.segmentation.silhouette import Silhouette
from pipeline.views.epipolar_tangency import OutlineHulls
from pipeline.views.prepared import PreparedViews

N_ANGLES = 24
"""Planes a view, evenly spread around its outline."""
MAX_HALF_LENGTH_MM = 100.0
"""Search limit along a ray, to either side of its point, where no plane ends it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Planes:
    """P planes in the world frame: the body satisfies `normals @ x <= offsets_mm`."""

    normals: Directions  # (P, 3) outwards
    offsets_mm: Values  # (P,)
    mm_per_px: Values  # (P,) in the view's image, near the origin


def planes_around(views: PreparedViews, hulls: OutlineHulls) -> Planes:
    """Return `N_ANGLES` planes through each camera's centre that touch its closed outline, or else its region."""
    angles = 2 * np.pi / N_ANGLES * np.arange(N_ANGLES)
    outwards = np.array([np.cos(angles), np.sin(angles)])
    along = outwards.T @ hulls.rays[:, :, :2].transpose(0, 2, 1)
    outline_heights = {
        camera: heights
        for camera, heights, is_closed in zip(hulls.cameras, along.max(axis=2), hulls.is_closed, strict=True)
        if is_closed
    }
    heights = [
        outline_heights[camera.id]
        if camera.id in outline_heights
        else (_region_corners(camera, silhouette) @ outwards).max(axis=0)
        for camera, silhouette in zip(views.calibrations, views.silhouettes, strict=True)
    ]
    normals = np.empty((len(views), N_ANGLES, 3))
    normals[:, :, :2], normals[:, :, 2] = outwards.T, -np.array(heights)
    normals = normals @ views.cameras.R / np.sqrt(1 + normals[:, :, 2:] ** 2)
    centers_mm = views.cameras.centers_mm
    mm_per_px = np.sqrt((centers_mm * centers_mm).sum(axis=1)) / views.cameras.focals_px
    return Planes(
        normals=normals.reshape(-1, 3),
        offsets_mm=(normals @ centers_mm[:, :, None]).reshape(-1),
        mm_per_px=np.repeat(mm_per_px, N_ANGLES),
    )


def _region_corners(camera: CameraCalibration, silhouette: Silhouette) -> PointsUV:
    """Return the normalized coordinates (4, 2) of the corners of the silhouette's region."""
    height, width = silhouette.labels.shape
    return camera.normalized_coordinates(
        silhouette.offset_uv + np.array([[0, 0], [width, 0], [0, height], [width, height]])
    )


def stretches_mm(planes: Planes, lines: Singles, slack_px: float) -> tuple[Values, Values]:
    """Return from where to where (R,) along lines (6, R) the body can be, with planes moved outwards by the slack.

    Of a line of which the planes leave nothing it is the stretch between those that pass each other.
    """
    low_mm, high_mm = clip_lines(planes.normals, planes.offsets_mm + slack_px * planes.mm_per_px, lines)
    low_mm = low_mm.clip(-MAX_HALF_LENGTH_MM, MAX_HALF_LENGTH_MM)
    high_mm = high_mm.clip(-MAX_HALF_LENGTH_MM, MAX_HALF_LENGTH_MM)
    return np.minimum(low_mm, high_mm), np.maximum(low_mm, high_mm)


def clip_lines(
    normals: Directions, offsets_mm: Values, lines: Floats | Singles, least_slope: float = 0.0
) -> Annotated[Floats, "(2, R)"]:
    """Return the ends (2, R) of what P planes leave of lines (6, R); infinite where no plane ends one.

    A line is a point and a unit direction. A plane that it meets at a sine of at most `least_slope` ends none.
    In single precision: lengths of some ten mm are good to a few micrometres.
    """
    ends_mm = np.empty((2, lines.shape[1]), np.float32)
    ends_mm[0], ends_mm[1] = -np.inf, np.inf
    planes = np.column_stack([normals, offsets_mm]).astype(np.float32)
    _clip(planes, np.ascontiguousarray(lines, np.float32), np.float32(least_slope), ends_mm)
    return ends_mm.astype(np.float64)


@compiled
def _clip(planes: Singles, lines: Singles, least_slope: np.float32, ends_mm: Singles) -> None:
    """Move the ends (2, R) to what planes (P, 4), normals and offsets, leave of the lines (6, R).

    Lines in the inner loop: unlike the search for the least of all planes it runs in vectors.
    """
    infinite = np.float32(np.inf)
    for plane in range(len(planes)):
        x, y, z, offset_mm = planes[plane, 0], planes[plane, 1], planes[plane, 2], planes[plane, 3]
        for line in range(lines.shape[1]):
            slope = lines[3, line] * x + lines[4, line] * y + lines[5, line] * z
            reach_mm = offset_mm - (lines[0, line] * x + lines[1, line] * y + lines[2, line] * z)
            end_mm = reach_mm / slope
            ends_mm[0, line] = max(ends_mm[0, line], end_mm if slope < -least_slope else -infinite)
            ends_mm[1, line] = min(ends_mm[1, line], end_mm if slope > least_slope else infinite)
