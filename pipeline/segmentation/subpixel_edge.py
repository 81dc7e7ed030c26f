"""The sub-pixel edge of a body, and the signed distance of every pixel to it.

The edge crosses the line between two neighbouring pixels on different sides where the interpolated
coverage is 1/2. Each pixel of the body beside the edge owns a short straight piece of it: through the mean of its
crossings, along the chain of its neighbours' points. Distances are computed on nodes, every second pixel: every second
piece, twice as long, writes its distance into the nodes around it, and the least one stays. Further out only the sign
and the rough size of a distance count: there the same is done for every sixth pixel and piece, and interpolated.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Flags, FloatImage, GreyImage, Indices, PointsUV
from pipeline.compiled import compiled, compiled_within
from pipeline.segmentation.silhouette import COARSE_PX, FINE_PX, MARGIN_PX

FINE_REACH_NODES, COARSE_REACH_NODES = 4, 8
"""Nodes to either side into which a piece of edge writes its distance."""
EXACT_PX = FINE_PX * (FINE_REACH_NODES - 1)
"""Distances are exact up to here: the nearest piece has surely written. A cell of marching cubes is 4 to 5 px wide."""
FINE_PER_COARSE = COARSE_PX // FINE_PX
"""Fine nodes for each coarse one."""
TANGENT_REACH = 3
"""Points on either side through which a regression gives the direction of the edge."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SubpixelEdge:
    """The sub-pixel edge of a body in a region, cut into pieces."""

    body: GreyImage  # (h, w) not 0 on the silhouette, unknown pixels it may extend behind included
    points_uv: PointsUV
    """The mean crossing of the edge beside each pixel of the body's contours, each whole, the outer one first."""
    ends: Indices  # (C + 1,) where the points of each contour begin, and after the last one
    seen: Flags  # whether grey levels gave the point

    @property
    def border_uv(self) -> PointsUV:
        """Points (N, 2) in order around the outer contour; a copy."""
        return self.points_uv[: self.ends[1]].copy()

    @property
    def outline_uv(self) -> PointsUV:
        """The points of the outer contour only where the edge was seen; a copy."""
        return self.points_uv[: self.ends[1]].compress(self.seen[: self.ends[1]], axis=0)

    def coarse_px(self) -> FloatImage:
        """Return signed distances of every `COARSE_PX`-th pixel, positive within, clipped to +-`MARGIN_PX`.

        They are rough: up to 3 px too small, hardly ever too large.
        """
        is_within = self.body[::COARSE_PX, ::COARSE_PX]
        distances = np.where(is_within, np.float32(MARGIN_PX), np.float32(-MARGIN_PX))
        _keep_nearest(distances, COARSE_PX, COARSE_REACH_NODES, self.points_uv, self.ends)
        return distances

    def fine_px(self, coarse_px: FloatImage) -> FloatImage:
        """Return signed distances of every `FINE_PX`-th pixel: exact to `EXACT_PX`, beyond as rough as the coarse."""
        distances = _interpolated(coarse_px, self.body)
        _keep_nearest(distances, FINE_PX, FINE_REACH_NODES, self.points_uv, self.ends)
        return distances


@compiled
def _interpolated(nodes: FloatImage, body: GreyImage) -> FloatImage:
    """Interpolate distances of coarse nodes to the fine ones of a body (h, w): at least `EXACT_PX`, positive within."""
    height, width = -(-body.shape[0] // FINE_PX), -(-body.shape[1] // FINE_PX)
    n_rows, n_columns = nodes.shape
    distances = np.empty((height, width), np.float32)
    lines = np.empty((2, FINE_PER_COARSE * n_columns), np.float32)  # above and below
    for row in range(n_rows):
        for line in range(2):
            at = min(row + line, n_rows - 1)
            for column in range(n_columns):
                left, right = nodes[at, column], nodes[at, min(column + 1, n_columns - 1)]
                for u in range(FINE_PER_COARSE):
                    share = np.float32(u) / np.float32(FINE_PER_COARSE)
                    lines[line, FINE_PER_COARSE * column + u] = left + share * (right - left)
        for v in range(FINE_PER_COARSE * row, min(FINE_PER_COARSE * row + FINE_PER_COARSE, height)):
            share, here = (
                np.float32(v - FINE_PER_COARSE * row) / np.float32(FINE_PER_COARSE),
                body[FINE_PX * v],
            )
            for u in range(width):
                rough = abs(lines[0, u] + share * (lines[1, u] - lines[0, u]))
                distance = max(rough, np.float32(EXACT_PX))
                distances[v, u] = distance if here[FINE_PX * u] else -distance
    return distances


@compiled_within
def cyclic_index(i: int, steps: int, n: int) -> int:
    """Return (i + steps) modulo n, for at most one turn around a closed line.

    A division by n would take longer than all else.
    """
    after = i + steps
    if after < 0:
        return max(after + n, 0)
    return after if after < n else min(after - n, n - 1)


@compiled_within
def _edge_piece(points_uv: PointsUV, first: int, n: int, i: int, half: int) -> tuple[np.float32, ...]:
    """Return a piece of edge: its point, a little smoothed, its inward normal, and half its length.

    It lies at point `i` of a contour, whose `n` points begin at `first` and run with the body on their right, and
    reaches `half` points to either side.
    """
    along_u, along_v = 0.0, 0.0
    for k in range(1, TANGENT_REACH + 1):
        after, before = first + cyclic_index(i, k, n), first + cyclic_index(i, -k, n)
        along_u += k * (points_uv[after, 0] - points_uv[before, 0])
        along_v += k * (points_uv[after, 1] - points_uv[before, 1])
    length = max(np.sqrt(along_u * along_u + along_v * along_v), 1e-6)
    inward_u, inward_v = along_v / length, -along_u / length
    after, before = first + cyclic_index(i, 1, n), first + cyclic_index(i, -1, n)
    u, v = points_uv[first + i, 0], points_uv[first + i, 1]
    offset_u = (points_uv[before, 0] + points_uv[after, 0]) / 2 - u
    offset_v = (points_uv[before, 1] + points_uv[after, 1]) / 2 - v
    inwards = (offset_u * inward_u + offset_v * inward_v) / 2
    after, before = first + cyclic_index(i, half, n), first + cyclic_index(i, -half, n)
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
    distances: FloatImage, spacing_px: int, reach: int, points_uv: PointsUV, ends: Indices
) -> None:
    """Replace signed distances on nodes, every `spacing_px`-th pixel, by those to nearer pieces of edge.

    Every `spacing_px`-th of the points of contours, which begin and end at `ends` (C + 1,), has a piece, which writes
    into the nodes up to `reach` to either side.
    """
    height, width = distances.shape
    flat = distances.reshape(-1)
    n_rows, n_columns = min(2 * reach, height), min(2 * reach, width)
    spacing = np.float32(spacing_px)
    for contour in range(len(ends) - 1):
        first, length = ends[contour], ends[contour + 1] - ends[contour]
        for i in range(0, length, spacing_px):
            place = _edge_piece(points_uv, first, length, i, spacing_px // 2)
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
