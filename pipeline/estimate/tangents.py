"""What the outlines say for certain: tangent planes of the body, and rays that touch it.

The line that touches a silhouette's outline from outside, and the camera's centre, span a plane the body
touches from one side; the viewing ray through the point of contact touches the body itself, somewhere.
Where, the other views' planes bound: the body is on their inner side, so the ray touches on the segment
they leave of it. Near *frontier points*, where the tangent planes of two views coincide, next to nothing
is left, and at a corner that several views see the segments shrink to the corner.

Lengths are relative to a point near the body, so that single precision holds micrometres.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import View
from pipeline.compiled import compiled
from pipeline.outline_hull import hull_corners

Array = NDArray[np.float64]

N_ANGLES = 60
"""Tangents an outline: every 6 degrees."""
SLACK_MM = 0.004
"""By which planes are moved outwards before they cut rays: a tenth of a pixel. Planes that nearly contain
a ray would otherwise cut it anywhere, by the noise of the outlines."""
SEEN_POINTS = 10
"""A tangent is left out if the edge was not seen so many points to either side of where it touches: closer to a gap
it may be the noise of the outline that has it touch there, and not beyond."""
MAX_OVERLAP_MM = 0.3
"""A ray that the planes leave less than minus this much of misses the body: its view is at odds with others."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tangents:
    """Touching rays and planes of all views, N of each; points relative to `center_mm`.

    The body satisfies `normals @ x <= offsets_mm`, and touches its plane on `points_mm + t directions`
    at some t from `low_mm` to `high_mm`.
    """

    center_mm: Array  # (3,) world frame
    normals: Array  # (N, 3) unit, outwards
    offsets_mm: Array  # (N,)
    points_mm: Array  # (N, 3) foot of the centre on the ray
    directions: Array  # (N, 3) unit, away from the camera
    low_mm: Array  # (N,)
    high_mm: Array  # (N,)

    @property
    def lengths_mm(self) -> Array:
        """Lengths (N,) of the segments."""
        return self.high_mm - self.low_mm

    def at(self, rays: NDArray[np.int64], t_mm: Array) -> Array:
        """Points (R, 3) on rays (R,)."""
        return self.points_mm[rays] + t_mm[:, None] * self.directions[rays]


def tangents_of(views: Sequence[View], center_mm: Array) -> Tangents:
    """Tangents at `N_ANGLES` angles of every view's outline, those beside a gap in it left out.

    An outline without points gives none, and rays that miss the body are left out.
    """
    cameras = [camera for camera, _ in views]
    per_view = [_touching_view(view) for view in views]
    index = np.repeat(np.arange(len(views)), [len(planes) for planes, _ in per_view])
    R = np.array([camera.R for camera in cameras])[index]
    eyes_mm = np.array([camera.center_mm - center_mm for camera in cameras])[index]
    normals, directions = (
        (_unit(np.concatenate(parts))[:, None] @ R)[:, 0] for parts in zip(*per_view, strict=True)
    )
    offsets_mm = (normals * eyes_mm).sum(axis=1)
    points_mm = eyes_mm - (directions * eyes_mm).sum(axis=1, keepdims=True) * directions
    low_mm, high_mm = segments_mm(normals, offsets_mm, points_mm, directions)
    touching = np.isfinite(high_mm - low_mm) & (high_mm - low_mm > -MAX_OVERLAP_MM)
    middle_mm = (low_mm + high_mm) / 2
    low_mm, high_mm = np.minimum(low_mm, middle_mm), np.maximum(high_mm, middle_mm)
    return Tangents(
        center_mm=center_mm,
        normals=normals[touching],
        offsets_mm=offsets_mm[touching],
        points_mm=points_mm[touching],
        directions=directions[touching],
        low_mm=low_mm[touching],
        high_mm=high_mm[touching],
    )


def _touching_view(view: View) -> tuple[Array, Array]:
    """Normals (T, 3) of planes through the camera's centre that touch the outline, and rays (T, 3) to where they do.

    Both in the camera's frame, of any length.
    """
    camera, silhouette = view
    outline_uv = silhouette.outline_uv
    if len(outline_uv) < 3:
        return np.empty((0, 3)), np.empty((0, 3))
    angles = 2 * np.pi / N_ANGLES * np.arange(N_ANGLES)
    outwards = np.column_stack([np.cos(angles), np.sin(angles)])
    corners, goes_on = hull_corners(outline_uv, SEEN_POINTS)
    # distortion bends the plane so little that each tangent's point is among these
    candidates = (outwards @ outline_uv[corners].T).argmax(axis=1)
    rays = np.ones((len(candidates), 3))
    rays[:, :2] = camera.flat_rays(outline_uv[corners[candidates]])
    heights = rays[:, :2] @ outwards.T
    best = heights.argmax(axis=0)
    normals = np.column_stack([outwards, -heights.max(axis=0)])
    known = goes_on[candidates][best]
    return normals[known], rays[best[known]]


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def segments_mm(
    normals: Array, offsets_mm: Array, points_mm: Array, directions: Array
) -> tuple[Array, Array]:
    """What all planes leave of each ray: from (N,) to (N,), infinite where nothing ends it."""
    planes = np.column_stack([normals, offsets_mm + SLACK_MM])
    low_mm, high_mm = _left_by(planes, np.ascontiguousarray(np.vstack([points_mm.T, directions.T])))
    return low_mm, high_mm


@compiled
def _left_by(planes: Array, rays: Array) -> Array:
    """Ends (2, N) of what planes (P, 4), normals and offsets, leave of rays (6, N), points and directions.

    Rays in the inner loop: unlike the search for the least of all planes it runs in vectors.
    """
    ends_mm = np.empty((2, rays.shape[1]))
    ends_mm[0], ends_mm[1] = -np.inf, np.inf
    for plane in range(len(planes)):
        x, y, z, offset_mm = planes[plane, 0], planes[plane, 1], planes[plane, 2], planes[plane, 3]
        for ray in range(rays.shape[1]):
            slope = rays[3, ray] * x + rays[4, ray] * y + rays[5, ray] * z
            reach_mm = offset_mm - (rays[0, ray] * x + rays[1, ray] * y + rays[2, ray] * z)
            end_mm = reach_mm / slope
            ends_mm[0, ray] = max(ends_mm[0, ray], end_mm if slope < 0 else -np.inf)
            ends_mm[1, ray] = min(ends_mm[1, ray], end_mm if slope > 0 else np.inf)
    return ends_mm
