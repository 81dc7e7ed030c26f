"""Pixels that may be body where its edge was not seen: up to the tangents of the edge on either side.

The outline of a convex body lies, between two of its points, within the triangle of their chord and the tangents at
both. So where the edge was not seen all of that triangle is unknown, and with it the bay that the edge seemed to have
there. A hole whose rim is mostly not that of a hole is no hole.
"""

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import GreyImage, Indices, PointsUV, Vector2
from pipeline.segmentation.silhouette import OUTSIDE, UNKNOWN

TANGENT_POINTS = 16
"""Points of seen edge beside a gap, at most, through which its tangent is drawn."""
MIN_TANGENT_POINTS = 6
MIN_RUN_POINTS, BENT_POINTS = 27, 6
"""Fewest seen points in a row that count as a piece of the body's edge, and how many at its ends may bend."""
MAX_HEIGHT = 1.0
"""Greatest height of the triangle, relative to the gap: nearly parallel tangents meet anywhere."""
MAX_DOUBTFUL_SHARE = 0.5
"""Share of a hole's rim that is doubtful beyond which it is taken for a patch of the body that looks like the wall."""


def fill_doubtful_hole(labels: GreyImage, rim_uv: PointsUV, n_doubtful: int) -> None:
    """Make a hole of `labels` (h, w) unknown if too much of its rim (N, 2) is doubtful."""
    if n_doubtful > MAX_DOUBTFUL_SHARE * len(rim_uv):
        make_unknown(labels, rim_uv)


def bridge_gaps(labels: GreyImage, points_uv: PointsUV, seen: GreyImage) -> bool:
    """Make unknown what may be body beyond the unseen stretches of an outer contour (N, 2); return whether any was.

    The contour has the body on its right.
    """
    n_marked, last_uv = cv2.countNonZero(labels), np.array(labels.shape[::-1]) - 2
    for first, end in _gaps(_without_short_runs(seen)):
        gap = np.arange(first - 1, end + 1) % len(points_uv)
        if ((points_uv[gap] < 1) | (points_uv[gap] > last_uv)).any():
            continue  # the body leaves the region: there is no other side
        before_uv, after_uv = points_uv[gap[0]], points_uv[gap[-1]]
        corner_uv = _corner(
            before_uv,
            after_uv,
            _direction(points_uv, seen, first - 1, -1),
            _direction(points_uv, seen, end, 1),
        )
        make_unknown(labels, np.concatenate([points_uv[gap], corner_uv]))
    return cv2.countNonZero(labels) > n_marked


def _without_short_runs(seen: GreyImage) -> GreyImage:
    """Return flags (N,) of runs of seen points, without their ends, and none that texture may have made."""
    around = np.concatenate([seen, seen, seen])[None]
    whole = cv2.erode(around, np.ones((1, MIN_RUN_POINTS), np.uint8))
    kept = cv2.dilate(whole, np.ones((1, MIN_RUN_POINTS - 2 * BENT_POINTS), np.uint8))
    return np.asarray(kept[0, len(seen) : 2 * len(seen)], np.uint8)


def _gaps(seen: GreyImage) -> Iterator[tuple[int, int]]:
    """Yield the first of each run of unseen points and the seen one after it, which may be beyond the last."""
    if not seen.any():
        return
    starts: Indices = np.flatnonzero((seen == 0) & (np.roll(seen, 1) != 0))
    ends = np.flatnonzero((seen != 0) & (np.roll(seen, 1) == 0))
    for start in starts.tolist():
        after = ends[ends > start]
        yield start, int(after[0]) if len(after) else int(ends[0]) + len(seen)


def _direction(points_uv: PointsUV, seen: GreyImage, at: int, step: int) -> Vector2 | None:
    """Return the unit direction in which the seen edge beyond a point leads to it, `None` where it is too short."""
    n = 0
    while n < TANGENT_POINTS and seen[(at + step * (n + 1)) % len(seen)]:
        n += 1
    if n < MIN_TANGENT_POINTS:
        return None
    own_uv = points_uv[(at + step * np.arange(n + 1)) % len(points_uv)]
    along = np.linspace(1, -1, n + 1) @ own_uv
    return np.asarray(along / max(np.hypot(*along), 1e-6))


def _corner(before_uv: Vector2, after_uv: Vector2, ahead: Vector2 | None, back: Vector2 | None) -> PointsUV:
    """Return where the tangents at both ends of a gap meet (0 or 1, 2), no higher above the chord than allowed."""
    chord = after_uv - before_uv
    length_px = float(np.hypot(*chord))
    if length_px < 1e-6:
        return np.empty((0, 2))
    along = chord / length_px
    outwards = np.array([-along[1], along[0]])
    # angles of both tangents above the chord; where one is not known, the outline is taken for symmetric
    known = [each for each in (ahead, back) if each is not None]
    if not known:
        return np.empty((0, 2))
    first, second = (
        float(np.arctan2(each @ outwards, side * (each @ along)))
        for each, side in (
            (known[0], 1 if ahead is not None else -1),
            (known[-1], -1 if back is not None else 1),
        )
    )
    if min(first, second) <= 0:  # a convex outline cannot reach further than the chord
        return np.empty((0, 2))
    height_px, at_px = MAX_HEIGHT * length_px, length_px / 2
    if first + second < np.pi:
        distance_px = length_px * np.sin(second) / np.sin(first + second)
        if distance_px * np.sin(first) < height_px:
            height_px, at_px = distance_px * np.sin(first), distance_px * np.cos(first)
    return (before_uv + at_px * along + height_px * outwards)[None]


def make_unknown(labels: GreyImage, polygon_uv: PointsUV) -> None:
    """Label unknown what is outside and within a polygon (N, 2)."""
    corners: NDArray[np.int32] = np.rint(polygon_uv).astype(np.int32)
    u, v, width, height = cv2.boundingRect(corners)
    left, top = max(u, 0), max(v, 0)
    part = labels[top : v + height, left : u + width]
    if not part.size:
        return
    within = np.zeros(part.shape, np.uint8)
    cv2.fillPoly(within, [corners - [left, top]], 1)
    part[(within != 0) & (part == OUTSIDE)] = UNKNOWN
