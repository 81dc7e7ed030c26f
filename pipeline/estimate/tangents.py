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
from pipeline.rig.camera_arrays import arrays_of
from pipeline.views.outline_hull import goes_on, stacked
from pipeline.views.tangent_planes import left_by

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

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


def tangents_of(views: Sequence[View], center_mm: Array) -> Tangents:
    """Tangents at `N_ANGLES` angles of every view's outline; those beside a gap in it are left out.

    So are rays that miss the body.
    """
    cameras = arrays_of([camera for camera, _ in views])
    outlines = stacked([silhouette.outline_uv for _, silhouette in views])
    reach, farthest = np.full((len(views), N_ANGLES), -np.inf), np.empty((len(views), N_ANGLES), np.int64)
    _find_farthest(outlines.points_uv, outlines.ends, OUTWARDS, reach, farthest)
    is_known = goes_on(outlines, farthest, SEEN_POINTS)
    owners = np.repeat(np.arange(len(views)), N_ANGLES)
    flat = cameras.flat_rays(outlines.points_uv[farthest.ravel()], owners)
    # distortion bends a plane so little that each tangent's point is among these
    heights = OUTWARDS.T @ flat.reshape(-1, N_ANGLES, 2).transpose(0, 2, 1)
    best = heights.argmax(axis=2).ravel() + N_ANGLES * owners
    rays, planes = np.ones((2, len(views), N_ANGLES, 3))
    rays[:, :, :2] = flat[best].reshape(-1, N_ANGLES, 2)
    planes[:, :, :2], planes[:, :, 2] = OUTWARDS.T, -heights.max(axis=2)
    is_known = is_known.ravel()[best].reshape(-1, N_ANGLES)
    R, eyes_mm = cameras.R, cameras.centers_mm - center_mm
    normals, directions = (_unit((vectors @ R)[is_known]) for vectors in (planes, rays))
    eyes_mm = np.repeat(eyes_mm, is_known.sum(axis=1), axis=0)
    offsets_mm = (normals * eyes_mm).sum(axis=1)
    points_mm = eyes_mm - (directions * eyes_mm).sum(axis=1, keepdims=True) * directions
    low_mm, high_mm = segments_mm(normals, offsets_mm, points_mm, directions)
    touching = np.isfinite(high_mm - low_mm) & (high_mm - low_mm > -MAX_OVERLAP_MM)
    middle_mm = (low_mm + high_mm) / 2
    return Tangents(
        normals=normals[touching],
        offsets_mm=offsets_mm[touching],
        points_mm=points_mm[touching],
        directions=directions[touching],
        low_mm=np.minimum(low_mm, middle_mm)[touching],
        high_mm=np.maximum(high_mm, middle_mm)[touching],
    )


@compiled
def _find_farthest(points: Array, ends: Indices, outwards: Array, reach: Array, farthest: Indices) -> None:
    """Which points, of each outline (N, 2), are the farthest (V, A), and how far they reach, in each direction (2, A).

    In vectors, as the directions are last.
    """
    for view in range(len(reach)):
        for point in range(ends[view], ends[view + 1]):
            u, v = points[point, 0], points[point, 1]
            for angle in range(reach.shape[1]):
                height = u * outwards[0, angle] + v * outwards[1, angle]
                is_farther = height > reach[view, angle]
                reach[view, angle] = height if is_farther else reach[view, angle]
                farthest[view, angle] = point if is_farther else farthest[view, angle]


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.sqrt((vectors * vectors).sum(axis=1, keepdims=True)))


def segments_mm(
    normals: Array, offsets_mm: Array, points_mm: Array, directions: Array
) -> tuple[Array, Array]:
    """What all planes leave of each ray: from (N,) to (N,), infinite where nothing ends it."""
    low_mm, high_mm = left_by(
        normals, offsets_mm + SLACK_MM, np.concatenate([points_mm, directions], axis=1).T
    )
    return low_mm, high_mm
