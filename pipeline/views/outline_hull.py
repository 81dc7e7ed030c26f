"""The corners of outlines' convex hulls: only they touch the lines, hence the planes, that touch the body.

The hull is that of the distorted image: over a silhouette a straight line is bent by less than 0.01 px.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Flags, Indices, PointsUV
from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import MAX_STEP_PX

ViewCorners = Annotated[NDArray[np.int64], "(V, H)"]
"""Indices of points of V stacked outlines, H each."""

MIN_POINTS = 3
"""Fewest points of an outline that has a convex hull."""
TILT = 1e-3
"""Slope, against the rows, of the line along which points are sorted: many share a column, none a place on it."""
IMAGE_SPACING_PX = 1e6
"""Offset between the outlines along that line, larger than any image: all are sorted at once."""


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
    n_views = len(ends) - 1
    along = points_uv[:, 0] + TILT * points_uv[:, 1] + IMAGE_SPACING_PX * outlines.owners
    chain, counts = np.empty(len(points_uv) + n_views, np.int64), np.empty(n_views, np.int64)
    is_closed = np.empty(n_views, np.bool_)
    _find_corners(points_uv, np.argsort(along), ends, chain, counts, is_closed)
    place = np.arange(counts.max(initial=1))
    first = ends[:-1] + np.arange(n_views)
    return chain[first[:, None] + np.where(place < counts[:, None], place, 0)], is_closed


@compiled
def _find_corners(
    points: PointsUV, order: Indices, ends: Indices, chain: Indices, counts: Indices, is_closed: Flags
) -> None:
    """Find hull corners by Andrew's monotone chain, forth and back along the points (N, 2) in their `order` (N,).

    Fills in the corners of each view, from `chain[ends[view] + view]` on, their `counts` (V,), and which outlines
    (V,) are closed.
    """
    for view in range(len(counts)):
        begin, end = ends[view], ends[view + 1]
        n, bottom = end - begin, begin + view
        length, least, longest, last = 0, 2, 0.0, end - 1
        for point in range(begin, end):
            u, v = points[point, 0] - points[last, 0], points[point, 1] - points[last, 1]
            longest, last = max(longest, u * u + v * v), point
        is_closed[view] = longest <= MAX_STEP_PX * MAX_STEP_PX
        for place in range(2 * n - 1):
            point = order[begin + place if place < n else end + n - 2 - place]
            if place == n:
                least = length + 1
            while length >= least:
                a, b = chain[bottom + length - 2], chain[bottom + length - 1]
                turn = (points[b, 0] - points[a, 0]) * (points[point, 1] - points[a, 1])
                turn -= (points[b, 1] - points[a, 1]) * (points[point, 0] - points[a, 0])
                if turn > 0:
                    break
                length -= 1
            chain[bottom + length] = point
            length += 1
        counts[view] = length - 1


def is_edge_seen(outlines: StackedOutlines, chosen: ViewCorners, reach: int) -> NDArray[np.bool_]:
    """Tell (V, A) for chosen points (V, A) whether the `reach` steps before and after them have no gap."""
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
