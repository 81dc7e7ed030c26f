"""The corners of outlines' convex hulls: what touches the lines, hence the planes, that touch the body.

The hull is that of the distorted image: over a silhouette a straight line is bent by less than 0.01 px.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import MAX_STEP_PX

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]

TILT = 1e-3
"""Points are sorted along a line that much off the rows: many share a column, none the place on that line."""
APART_PX = 1e6
"""Farther than points of one image are from each other."""


class Outlines(NamedTuple):
    """V outlines, one after the other."""

    points_uv: Array  # (N, 2) each in order around a body
    ends: Indices  # (V + 1,) where each begins, and the end of the last

    @property
    def owners(self) -> Indices:
        """Whose each point (N,) is."""
        return np.repeat(np.arange(len(self.ends) - 1), np.diff(self.ends))


def stacked(outlines_uv: Sequence[Array]) -> Outlines:
    """Outlines (N, 2) of several views."""
    ends = np.cumsum([0, *map(len, outlines_uv)])
    return Outlines(np.concatenate([*outlines_uv, np.empty((0, 2))]), ends)


def hull_corners(outlines: Outlines) -> tuple[Indices, Flags]:
    """The corners (V, H) of the outlines' convex hulls, in order, and which outlines (V,) have no gap anywhere.

    Outlines have more than 2 points. Where a hull has fewer corners than another its first is repeated.
    """
    points_uv, ends = outlines
    n_views = len(ends) - 1
    along = points_uv[:, 0] + TILT * points_uv[:, 1] + APART_PX * outlines.owners
    chain, counts = np.empty(len(points_uv) + n_views, np.int64), np.empty(n_views, np.int64)
    is_closed = np.empty(n_views, np.bool_)
    _corners(points_uv, np.argsort(along), ends, chain, counts, is_closed)
    place = np.arange(counts.max(initial=1))
    first = ends[:-1] + np.arange(n_views)
    return chain[first[:, None] + np.where(place < counts[:, None], place, 0)], is_closed


@compiled
def _corners(
    points: Array, order: Indices, ends: Indices, chain: Indices, counts: Indices, is_closed: Flags
) -> None:
    """Andrew's monotone chain, there and back along the points (N, 2) of each outline in their order (N,).

    Fills in corners, from place `ends[view] + view` of the `chain` on, how many they are, and whether there is a gap.
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


def goes_on(outlines: Outlines, which: Indices, reach: int) -> Flags:
    """Whether outlines have no gap among the `reach` steps before and after some of their points (V, A)."""
    found = np.empty(which.shape, np.bool_)
    _go_on(outlines.points_uv, outlines.ends, which, reach, found)
    return found


@compiled
def _go_on(points: Array, ends: Indices, which: Indices, reach: int, found: Flags) -> None:
    for view in range(which.shape[0]):
        begin, n = ends[view], ends[view + 1] - ends[view]
        for i in range(which.shape[1]):
            is_seen = True
            for step in range(which[view, i] - begin - reach, which[view, i] - begin + reach):
                start, end = begin + step % n, begin + (step + 1) % n
                u, v = points[end, 0] - points[start, 0], points[end, 1] - points[start, 1]
                is_seen &= u * u + v * v <= MAX_STEP_PX * MAX_STEP_PX
            found[view, i] = is_seen
