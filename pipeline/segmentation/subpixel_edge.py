"""The sub-pixel edge of a body, and the signed distance of every pixel to it.

The edge crosses the line between two neighbouring pixels on different sides where the interpolated
coverage is 1/2. Each pixel of the body beside the edge owns a short piece of it: through the mean of its
crossings, along the chain of its neighbours' points. Each second piece, twice as long, writes its distance into the
nodes around it, where the least one stays: every second pixel is one. Further out only the sign and the rough size of
a distance count: there the same is done for every sixth pixel and piece, and what lies between is interpolated.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled, compiled_within
from pipeline.segmentation.silhouette import COARSE_PX, FINE_PX, MARGIN_PX

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

FINE_REACH, COARSE_REACH = 4, 8
"""Into so many nodes to either side a piece of edge writes."""
NEAR_PX = FINE_PX * (FINE_REACH - 1)
"""Up to here the distance is the true one: the nearest piece has surely written. A cell of marching cubes is 4 to 5 px
wide."""
FINER = COARSE_PX // FINE_PX
"""Fine nodes for each coarse one."""
TANGENT_REACH = 3
"""The direction of the edge is the slope of the regression through so many points on either side."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edge:
    """The sub-pixel edge of a body in a region, cut into pieces."""

    body: Grey  # (h, w) not 0 on the silhouette, unknown pixels it may extend behind included
    points_uv: NDArray[np.float64]
    """(N, 2) the mean crossing of the edge beside each pixel of the body's contours, whole, the outer one first."""
    ends: NDArray[np.int64]  # (C + 1,) where the points of each contour begin, and after the last one
    seen: Mask  # (N,) whether grey levels gave it

    @property
    def outline_uv(self) -> NDArray[np.float64]:
        """Points (M, 2) in order around the outer contour, only where the edge was seen; a copy."""
        n_outer = self.ends[1]
        return self.points_uv[:n_outer].compress(self.seen[:n_outer], axis=0)

    def coarse_px(self) -> Array:
        """Signed distances of every `COARSE_PX`-th pixel, positive within, cut off at +-`MARGIN_PX`.

        They are rough: up to 3 px too small, hardly ever too large.
        """
        is_within = self.body[::COARSE_PX, ::COARSE_PX]
        distances = np.where(is_within, np.float32(MARGIN_PX), np.float32(-MARGIN_PX))
        _keep_nearest(distances, COARSE_PX, COARSE_REACH, self.points_uv, self.ends)
        return distances

    def fine_px(self, coarse_px: Array) -> Array:
        """Of every `FINE_PX`-th pixel: up to `NEAR_PX` to the sub-pixel edge, beyond as rough as the coarse ones."""
        distances = _between(coarse_px, self.body)
        _keep_nearest(distances, FINE_PX, FINE_REACH, self.points_uv, self.ends)
        return distances


@compiled
def _between(nodes: Array, body: Grey) -> Array:
    """Distances of fine nodes of a body (h, w) between those of coarse ones, at least `NEAR_PX`, positive within."""
    height, width = -(-body.shape[0] // FINE_PX), -(-body.shape[1] // FINE_PX)
    n_rows, n_columns = nodes.shape
    distances = np.empty((height, width), np.float32)
    lines = np.empty((2, FINER * n_columns), np.float32)  # above and below
    for row in range(n_rows):
        for line in range(2):
            at = min(row + line, n_rows - 1)
            for column in range(n_columns):
                left, right = nodes[at, column], nodes[at, min(column + 1, n_columns - 1)]
                for u in range(FINER):
                    share = np.float32(u) / np.float32(FINER)
                    lines[line, FINER * column + u] = left + share * (right - left)
        for v in range(FINER * row, min(FINER * row + FINER, height)):
            share, here = np.float32(v - FINER * row) / np.float32(FINER), body[FINE_PX * v]
            for u in range(width):
                rough = abs(lines[0, u] + share * (lines[1, u] - lines[0, u]))
                distance = max(rough, np.float32(NEAR_PX))
                distances[v, u] = distance if here[FINE_PX * u] else -distance
    return distances


@compiled_within
def along(i: int, steps: int, n: int) -> int:
    """The index of the point so many steps after number i of n around a closed line, at most one turn away.

    To divide by n takes longer than all else.
    """
    after = i + steps
    if after < 0:
        return max(after + n, 0)
    return after if after < n else min(after - n, n - 1)


@compiled_within
def _piece(points_uv: NDArray[np.float64], first: int, n: int, i: int, half: int) -> tuple[np.float32, ...]:
    """Point, a little smoothed, inward normal and half the length of a piece of edge, as long as `half` points do.

    It is at point `i` of the contour of `n` points from `first` on, which runs with the body on its right.
    """
    along_u, along_v = 0.0, 0.0
    for k in range(1, TANGENT_REACH + 1):
        after, before = first + along(i, k, n), first + along(i, -k, n)
        along_u += k * (points_uv[after, 0] - points_uv[before, 0])
        along_v += k * (points_uv[after, 1] - points_uv[before, 1])
    length = max(np.sqrt(along_u * along_u + along_v * along_v), 1e-6)
    inward_u, inward_v = along_v / length, -along_u / length
    after, before = first + along(i, 1, n), first + along(i, -1, n)
    u, v = points_uv[first + i, 0], points_uv[first + i, 1]
    offset_u = (points_uv[before, 0] + points_uv[after, 0]) / 2 - u
    offset_v = (points_uv[before, 1] + points_uv[after, 1]) / 2 - v
    inwards = (offset_u * inward_u + offset_v * inward_v) / 2
    after, before = first + along(i, half, n), first + along(i, -half, n)
    chord_u = points_uv[after, 0] - points_uv[before, 0]
    chord_v = points_uv[after, 1] - points_uv[before, 1]
    return (
        np.float32(u + inwards * inward_u),
        np.float32(v + inwards * inward_v),
        np.float32(inward_u),
        np.float32(inward_v),
        np.float32(np.sqrt(chord_u * chord_u + chord_v * chord_v) / 2),
    )


@compiled
def _keep_nearest(
    distances: Array, spacing_px: int, reach: int, points_uv: NDArray[np.float64], ends: NDArray[np.int64]
) -> None:
    """Replace signed distances of every `spacing_px`-th pixel by those to pieces of edge around that are nearer.

    Of the points (N, 2) of contours, which begin and end at `ends` (C + 1,), every `spacing_px`-th has a piece, which
    reaches so many nodes to either side.
    """
    height, width = distances.shape
    flat = distances.reshape(-1)
    n_rows, n_columns = min(2 * reach, height), min(2 * reach, width)
    spacing = np.float32(spacing_px)
    for contour in range(len(ends) - 1):
        first, length = ends[contour], ends[contour + 1] - ends[contour]
        for i in range(0, length, spacing_px):
            place = _piece(points_uv, first, length, i, spacing_px // 2)
            point_u, point_v, inward_u, inward_v, half_px = place
            left = min(max(int(point_u / spacing) - reach + 1, 0), width - n_columns)
            top = min(max(int(point_v / spacing) - reach + 1, 0), height - n_rows)
            for row in range(top, top + n_rows):
                offset_u = spacing * np.float32(left) - point_u
                offset_v = spacing * np.float32(row) - point_v
                inwards_at_left = offset_u * inward_u + offset_v * inward_v
                along_at_left = offset_u * inward_v - offset_v * inward_u
                # unsigned indices, and a count in 32 bits, let LLVM take 8 pixels at a time
                start = np.uint64(row * width + left)
                for column in range(n_columns):
                    right_px = spacing * np.float32(np.int32(column))
                    inwards = inwards_at_left + right_px * inward_u
                    along = abs(along_at_left + right_px * inward_v)
                    beyond = max(along - half_px, np.float32(0))
                    distance = np.sqrt(inwards * inwards + beyond * beyond)
                    at = start + np.uint64(column)
                    known = flat[at]
                    signed = inwards if distance < 1 else (distance if known > 0 else -distance)
                    flat[at] = signed if distance < abs(known) else known
