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
from pipeline.segmentation.silhouette import is_beside_gap

Array = NDArray[np.float64]

N_ANGLES = 60
"""Tangents an outline: every 6 degrees."""
SLACK_MM = 0.004
"""By which planes are moved outwards before they cut rays: a tenth of a pixel. Planes that nearly contain
a ray would otherwise cut it anywhere, by the noise of the outlines."""
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
    per_view = [_tangents_of_view(view, center_mm) for view in views]
    normals, offsets_mm, points_mm, directions = (
        np.concatenate([part[i] for part in per_view]) for i in range(4)
    )
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


def _tangents_of_view(view: View, center_mm: Array) -> tuple[Array, Array, Array, Array]:
    """Normals, offsets, feet and directions of one view."""
    camera, silhouette = view
    outline_uv = silhouette.outline_uv
    if len(outline_uv) < 3:
        return np.empty((0, 3)), np.empty(0), np.empty((0, 3)), np.empty((0, 3))
    angles = 2 * np.pi / N_ANGLES * np.arange(N_ANGLES)
    outwards = np.column_stack([np.cos(angles), np.sin(angles)])
    # distortion bends the plane so little that each tangent's point is among these
    candidates = np.unique((outwards @ outline_uv.T).argmax(axis=1))
    rays = camera.rays(outline_uv[candidates]) @ camera.R.T
    flat = rays[:, :2] / rays[:, 2:]
    heights = flat @ outwards.T
    best = heights.argmax(axis=0)
    known = ~is_beside_gap(outline_uv)[candidates][best]
    best, outwards, heights = best[known], outwards[known], heights.max(axis=0)[known]

    normals = np.column_stack([outwards, -heights])
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True) @ camera.R
    directions = rays[best] @ camera.R
    eye_mm = camera.center_mm - center_mm
    points_mm = eye_mm - (directions @ eye_mm)[:, None] * directions
    return normals, normals @ eye_mm, points_mm, directions


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
