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
    corners = _corners(outline_uv)
    return corners, goes_on(outline_uv, corners, reach)


@compiled
def _corners(points: Array) -> NDArray[np.int64]:
    """Andrew's monotone chain, there and back along points (N, 2) that go once around, either way."""
    n = len(points)
    order, n_ordered = np.empty(n + 1, np.int64), 0
    first, last, area = 0, 0, 0.0
    for i in range(n):
        area += points[i - 1, 0] * points[i, 1] - points[i, 0] * points[i - 1, 1]
        first = i if _place(points, i) < _place(points, first) else first
        last = i if _place(points, i) > _place(points, last) else last
    turn = 1 if area > 0 else -1
    for start, end, ahead in ((first, last, 1), (last, first, -1)):
        order[n_ordered] = start
        n_ordered += 1
        least, point = n_ordered, start
        for _ in range(n - 1):
            point += turn
            point = point - n if point == n else (n - 1 if point < 0 else point)
            if _turn(points, start, end, point) >= 0:
                continue
            at = n_ordered  # nearly the end: between the two ends an outline hardly ever goes back
            while at > least and ahead * (_place(points, order[at - 1]) - _place(points, point)) > 0:
                order[at] = order[at - 1]
                at -= 1
            order[at] = point
            n_ordered += 1
    order[n_ordered] = first
    chain, length, least = np.empty(n + 1, np.int64), 0, 2
    for point in order[: n_ordered + 1]:
        while length >= least and _turn(points, chain[length - 2], chain[length - 1], point) <= 0:
            length -= 1
        chain[length] = point
        length += 1
        if point == last:
            least = length + 1
    return chain[: length - 1].copy()


@compiled
def _place(points: Array, i: int) -> float:
    return points[i, 0] + TILT * points[i, 1]


@compiled
def _turn(points: Array, a: int, b: int, c: int) -> float:
    """Positive where the way from a over b to c turns from u to v."""
    along_u, along_v = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    return along_u * (points[c, 1] - points[b, 1]) - along_v * (points[c, 0] - points[b, 0])


@compiled
def goes_on(points: Array, which: NDArray[np.int64], reach: int) -> NDArray[np.bool_]:
    """Whether an outline (N, 2) has no gap among the `reach` steps before and after some of its points (H,)."""
    n = len(points)
    seen = np.empty(len(which), np.bool_)
    for i in range(len(which)):
        seen[i] = True
        for step in range(-reach, reach):
            start, end = (which[i] + step) % n, (which[i] + step + 1) % n
            u, v = points[end, 0] - points[start, 0], points[end, 1] - points[start, 1]
            seen[i] &= u * u + v * v <= MAX_STEP_PX * MAX_STEP_PX
    return seen


@compiled
def is_closed(points: Array) -> bool:
    """Whether an outline (N, 2) has no gap anywhere."""
    longest = 0.0
    for i in range(len(points)):
        u, v = points[i, 0] - points[i - 1, 0], points[i, 1] - points[i - 1, 1]
        longest = max(longest, u * u + v * v)
    return longest <= MAX_STEP_PX * MAX_STEP_PX
