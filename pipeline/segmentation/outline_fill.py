"""Sub-pixel contours made whole again after their points were moved: no gaps between points, pixels labelled anew."""

import numpy as np

from pipeline.arrays import GreyImage, Indices, PointsUV
from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import INSIDE, MAX_STEP_PX, OUTSIDE, UNKNOWN

MAX_SPACING_PX = 1.5
"""Distance of neighbouring points beyond which others are put between them: each owns a short piece of the edge."""


def closed_up(points_uv: PointsUV, seen: GreyImage, ends: Indices) -> tuple[PointsUV, GreyImage, Indices]:
    """Return contours with points between those that lie apart, not seen where that is further than an outline's step.

    The contours' points (N, 2) begin and end at `ends` (C + 1,).
    """
    n_parts = np.empty(len(points_uv), np.int64)
    new_ends = np.empty_like(ends)
    n = _count_parts(points_uv, ends, n_parts, new_ends)
    if n == len(points_uv):
        return points_uv, seen, ends
    points, flags = np.empty((n, 2)), np.empty(n, np.uint8)
    _fill_parts(points_uv, seen, ends, n_parts, points, flags)
    return points, flags, new_ends


@compiled
def _count_parts(points_uv: PointsUV, ends: Indices, n_parts: Indices, new_ends: Indices) -> int:
    n = new_ends[0] = 0
    for contour in range(len(ends) - 1):
        for i in range(ends[contour], ends[contour + 1]):
            after = i + 1 if i + 1 < ends[contour + 1] else ends[contour]
            du, dv = points_uv[after, 0] - points_uv[i, 0], points_uv[after, 1] - points_uv[i, 1]
            n_parts[i] = max(int(np.ceil(np.sqrt(du * du + dv * dv) / MAX_SPACING_PX)), 1)
            n += n_parts[i]
        new_ends[contour + 1] = n
    return n


@compiled
def _fill_parts(
    points_uv: PointsUV, seen: GreyImage, ends: Indices, n_parts: Indices, points: PointsUV, flags: GreyImage
) -> None:
    n = 0
    for contour in range(len(ends) - 1):
        for i in range(ends[contour], ends[contour + 1]):
            after = i + 1 if i + 1 < ends[contour + 1] else ends[contour]
            du, dv = points_uv[after, 0] - points_uv[i, 0], points_uv[after, 1] - points_uv[i, 1]
            is_step = du * du + dv * dv <= MAX_STEP_PX * MAX_STEP_PX
            for part in range(n_parts[i]):
                share = part / n_parts[i]
                points[n, 0], points[n, 1] = points_uv[i, 0] + share * du, points_uv[i, 1] + share * dv
                flags[n] = seen[i] if part == 0 else seen[i] & seen[after] & is_step
                n += 1


@compiled
def redraw(points_uv: PointsUV, ends: Indices, labels: GreyImage) -> GreyImage:
    """Label pixels (h, w) anew by whether their centres lie within an odd number of closed contours; return which do.

    The contours' points (N, 2) begin and end at `ends` (C + 1,). What is unknown within stays so.
    """
    height, width = labels.shape
    body = np.empty_like(labels)
    turns = np.zeros((height, width), np.uint8)
    for contour in range(len(ends) - 1):
        before = ends[contour + 1] - 1
        for i in range(ends[contour], ends[contour + 1]):
            u, v, last_u, last_v = (
                points_uv[i, 0],
                points_uv[i, 1],
                points_uv[before, 0],
                points_uv[before, 1],
            )
            before = i
            first, end = int(np.ceil(min(v, last_v))), int(np.ceil(max(v, last_v)))
            for row in range(max(first, 0), min(end, height)):
                crossing = last_u + (row - last_v) / (v - last_v) * (u - last_u)
                column = max(int(np.ceil(crossing)), 0)
                if column < width:
                    turns[row, column] ^= np.uint8(1)
    for row in range(height):
        is_within = np.uint8(0)
        for column in range(width):
            is_within ^= turns[row, column]
            body[row, column] = INSIDE if is_within else OUTSIDE
            if labels[row, column] != UNKNOWN or not is_within:
                labels[row, column] = body[row, column]
    return body
