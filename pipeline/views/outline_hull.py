"""The corners of outlines' convex hulls: only they touch the lines, hence the planes, that touch the body.

The hull is that of the distorted image: over a silhouette a straight line is bent by less than 0.01 px. OpenCV finds
it, for points rounded to whole multiples of 2^-19 px (in images of up to 2048 px): it takes no double precision, and
single precision moves corners. That costs no more than a monotone chain of our own.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Flags, Indices, PointsUV
from pipeline.compiled import compiled
from pipeline.geometry.bounds import bounds
from pipeline.segmentation.silhouette import MAX_STEP_PX

ViewCorners = Annotated[NDArray[np.int64], "(V, H)"]
"""Indices of points of V stacked outlines, H each."""

MIN_POINTS = 3
"""Fewest points of an outline that has a convex hull."""
FIXED_POINT_BITS = 30
"""Size of whole numbers whose differences OpenCV multiplies in 64 bits without overflow."""
TILT = 1e-3
"""A hull begins at its corner of least u + TILT v: many points share a column, none that sum."""


class StackedOutlines(NamedTuple):
    """The outlines of V views in one array, one after the other."""

    points_uv: PointsUV  # (N, 2) of each view in order around the body
    ends: Indices  # (V + 1,) where each begins, and the end of the last

    @property
    def lengths(self) -> Indices:
        """Number of points (V,) of each outline."""
        return np.diff(self.ends)

    @property
    def owners(self) -> Indices:
        """Index (N,) of each point's view."""
        return np.repeat(np.arange(len(self.ends) - 1), self.lengths)


def stack_outlines(outlines_uv: Sequence[PointsUV]) -> StackedOutlines:
    """Return the outlines (N, 2) of several views as one array."""
    ends = np.cumsum([0, *map(len, outlines_uv)])
    return StackedOutlines(np.concatenate([*outlines_uv, np.empty((0, 2))]), ends)


def hull_corners(outlines: StackedOutlines) -> tuple[ViewCorners, Flags]:
    """Find the corners (V, H) of the outlines' convex hulls, in order, and the outlines (V,) without any gap.

    Every outline has `MIN_POINTS` points. A hull with fewer corners than the largest repeats its first.
    """
    points_uv, ends = outlines
    if len(points_uv) == 0:
        return np.zeros((0, 1), np.int64), np.zeros(0, np.bool_)
    along = points_uv[:, 0] + TILT * points_uv[:, 1]
    fixed_point = _fixed_point(points_uv)
    hulls = []
    for begin, end in pairwise(ends.tolist()):
        hull = cv2.convexHull(fixed_point[begin:end], returnPoints=False)[:, 0] + begin
        first = along[hull].argmin()
        hulls.append(np.concatenate([hull[first:], hull[:first]]))
    corners = np.empty((len(hulls), max(map(len, hulls))), np.int64)
    for row, hull in zip(corners, hulls, strict=True):
        row[: len(hull)], row[len(hull) :] = hull, hull[0]
    return corners, _are_closed(outlines)


def _fixed_point(points_uv: PointsUV) -> NDArray[np.int32]:
    """Return the points (N, 2) as whole multiples of a power of 2 px from their least coordinates."""
    low, high = bounds(points_uv)
    _, exponent = np.frexp((high - low).max())
    return np.rint(np.ldexp(points_uv - low, FIXED_POINT_BITS - exponent)).astype(np.int32)


def _are_closed(outlines: StackedOutlines) -> Flags:
    """Mark outlines (V,) without any gap; every outline has a point."""
    points_uv, ends = outlines
    previous = np.arange(-1, len(points_uv) - 1)
    previous[ends[:-1]] = ends[1:] - 1
    du, dv = (points_uv - points_uv[previous]).T
    return np.maximum.reduceat(du * du + dv * dv, ends[:-1]) <= MAX_STEP_PX * MAX_STEP_PX


def is_edge_seen(outlines: StackedOutlines, chosen: ViewCorners, reach: int) -> NDArray[np.bool_]:
    """Mark chosen points (V, A) whose `reach` steps before and after them have no gap."""
    is_seen = np.empty(chosen.shape, np.bool_)
    _look_for_gaps(outlines.points_uv, outlines.ends, chosen, reach, is_seen)
    return is_seen


@compiled
def _look_for_gaps(
    points: PointsUV, ends: Indices, chosen: ViewCorners, reach: int, is_seen: NDArray[np.bool_]
) -> None:
    """Fill in what `is_edge_seen` returns."""
    for view in range(chosen.shape[0]):
        begin, n = ends[view], ends[view + 1] - ends[view]
        for i in range(chosen.shape[1]):
            has_no_gap = True
            for step in range(chosen[view, i] - begin - reach, chosen[view, i] - begin + reach):
                start, end = begin + step % n, begin + (step + 1) % n
                u, v = points[end, 0] - points[start, 0], points[end, 1] - points[start, 1]
                has_no_gap &= u * u + v * v <= MAX_STEP_PX * MAX_STEP_PX
            is_seen[view, i] = has_no_gap
