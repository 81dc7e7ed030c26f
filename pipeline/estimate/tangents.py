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
from pipeline.outline_hull import goes_on

Array = NDArray[np.float64]

N_ANGLES = 60
"""Tangents an outline: every 6 degrees."""
OUTWARDS = np.array(
    [np.cos(2 * np.pi / N_ANGLES * np.arange(N_ANGLES)), np.sin(2 * np.pi / N_ANGLES * np.arange(N_ANGLES))]
)
"""The directions (2, N_ANGLES) of the image that the tangents' normals have in it."""
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
    """Touching rays and planes of all views, N of each; points relative to the centre given.

    The body satisfies `normals @ x <= offsets_mm`, and touches its plane on `points_mm + t directions`
    at some t from `low_mm` to `high_mm`.
    """

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

    def lines(self) -> Array:
        """Points, directions and ends of the segments (N, 8)."""
        return np.column_stack([self.points_mm, self.directions, self.low_mm, self.high_mm])


def tangents_of(views: Sequence[View], center_mm: Array) -> Tangents:
    """Tangents at `N_ANGLES` angles of every view's outline, those beside a gap in it left out.

    An outline without points gives none, and rays that miss the body are left out.
    """
    lines = [np.empty((0, 10))]
    for camera, silhouette in views:
        outline_uv = silhouette.outline_uv
        if len(outline_uv) >= 3:
            farthest = _farthest(outline_uv, OUTWARDS)
            # distortion bends a plane so little that each tangent's point is among these
            flat = camera.flat_rays(outline_uv[farthest])
            is_known = goes_on(outline_uv, farthest, SEEN_POINTS)
            lines.append(_touching(flat, is_known, OUTWARDS, camera.R, camera.center_mm - center_mm))
    normals, offsets_mm, points_mm, directions = np.split(np.concatenate(lines), [3, 4, 7], axis=1)
    low_mm, high_mm = segments_mm(normals, offsets_mm[:, 0], points_mm, directions)
    touching = np.isfinite(high_mm - low_mm) & (high_mm - low_mm > -MAX_OVERLAP_MM)
    middle_mm = (low_mm + high_mm) / 2
    return Tangents(
        normals=normals[touching],
        offsets_mm=offsets_mm[touching, 0],
        points_mm=points_mm[touching],
        directions=directions[touching],
        low_mm=np.minimum(low_mm, middle_mm)[touching],
        high_mm=np.maximum(high_mm, middle_mm)[touching],
    )


@compiled
def _farthest(points: Array, outwards: Array) -> NDArray[np.int64]:
    """The points, of (N, 2), that are farthest in each direction (2, A); in vectors, as the directions are last."""
    n_angles = outwards.shape[1]
    reach, farthest = np.full(n_angles, -np.inf), np.zeros(n_angles, np.int64)
    for point in range(len(points)):
        u, v = points[point, 0], points[point, 1]
        for angle in range(n_angles):
            height = u * outwards[0, angle] + v * outwards[1, angle]
            is_farther = height > reach[angle]
            reach[angle] = height if is_farther else reach[angle]
            farthest[angle] = point if is_farther else farthest[angle]
    return farthest


@compiled
def _touching(flat: Array, is_known: NDArray[np.bool_], outwards: Array, R: Array, eye_mm: Array) -> Array:
    """Tangents of one view, with those rays (C, 2) of its camera that touch one, if the edge beside is known (C,).

    A row each: normal and offset of the plane, foot of the centre on the ray, and its direction.
    """
    tangents, n = np.empty((outwards.shape[1], 10)), 0
    for angle in range(outwards.shape[1]):
        x, y = outwards[0, angle], outwards[1, angle]
        best, z = 0, -np.inf
        for ray in range(len(flat)):
            height = flat[ray, 0] * x + flat[ray, 1] * y
            if height > z:
                best, z = ray, height
        if not is_known[best]:
            continue
        u, v = flat[best, 0], flat[best, 1]
        to_normal, to_direction = 1 / np.sqrt(x * x + y * y + z * z), 1 / np.sqrt(u * u + v * v + 1)
        offset_mm, along_mm = 0.0, 0.0
        for k in range(3):
            normal = (x * R[0, k] + y * R[1, k] - z * R[2, k]) * to_normal
            direction = (u * R[0, k] + v * R[1, k] + R[2, k]) * to_direction
            offset_mm += normal * eye_mm[k]
            along_mm += direction * eye_mm[k]
            tangents[n, k], tangents[n, 7 + k] = normal, direction
        tangents[n, 3] = offset_mm
        for k in range(3):
            tangents[n, 4 + k] = eye_mm[k] - along_mm * tangents[n, 7 + k]
        n += 1
    return tangents[:n]


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
