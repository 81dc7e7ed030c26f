"""The corners of an outline's convex hull: what touches the lines, hence the planes, that touch the body.

The hull is that of the distorted image: over a silhouette a straight line is bent by less than 0.01 px.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import MAX_STEP_PX

Array = NDArray[np.float64]

TILT = 1e-3
"""Points are sorted along a line that much off the rows: many share a column, none the place on that line."""


def hull_corners(outline_uv: Array, reach: int = 1) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The corners of the convex hull of an outline (N, 2), N > 2, in order, as indices (H,), and which can be trusted.

    Of those the edge was seen as far as the `reach`-th point on either side; from others the body may reach further.
    """
    corners = _corners(outline_uv, np.argsort(outline_uv[:, 0] + TILT * outline_uv[:, 1]))
    return corners, goes_on(outline_uv, corners, reach)


@compiled
def _corners(points: Array, order: NDArray[np.int64]) -> NDArray[np.int64]:
    """Andrew's monotone chain, there and back along the points (N, 2) in their order (N,)."""
    n = len(order)
    chain, length, least = np.empty(2 * n, np.int64), 0, 2
    for place in range(2 * n - 1):
        point = order[place if place < n else 2 * n - 2 - place]
        if place == n:
            least = length + 1
        while length >= least:
            a, b = chain[length - 2], chain[length - 1]
            turn = (points[b, 0] - points[a, 0]) * (points[point, 1] - points[a, 1])
            turn -= (points[b, 1] - points[a, 1]) * (points[point, 0] - points[a, 0])
            if turn > 0:
                break
            length -= 1
        chain[length] = point
        length += 1
    return chain[: length - 1].copy()


@compiled
def goes_on(points: Array, which: NDArray[np.int64], reach: int) -> NDArray[np.bool_]:
    """Whether an outline (N, 2) has no gap among the `reach` steps before and after some of its points (H,)."""
    n = len(points)
    goes_on = np.empty(len(which), np.bool_)
    for i in range(len(which)):
        goes_on[i] = True
        for step in range(-reach, reach):
            start, end = (which[i] + step) % n, (which[i] + step + 1) % n
            u, v = points[end, 0] - points[start, 0], points[end, 1] - points[start, 1]
            goes_on[i] &= u * u + v * v <= MAX_STEP_PX * MAX_STEP_PX
    return goes_on


@compiled
def is_closed(points: Array) -> bool:
    """Whether an outline (N, 2) has no gap anywhere."""
    longest = 0.0
    for i in range(len(points)):
        u, v = points[i, 0] - points[i - 1, 0], points[i, 1] - points[i - 1, 1]
        longest = max(longest, u * u + v * v)
    return longest <= MAX_STEP_PX * MAX_STEP_PX
