"""The sub-pixel edge of a body, and the signed distance of every pixel to it.

The edge crosses the line between two neighbouring pixels on different sides where the interpolated
coverage is 1/2. Each pixel of the body beside the edge owns a short piece of it: through the mean of its
crossings, along the chain of its neighbours' points. Each piece writes its distance into the pixels around
it, where the least one stays. Further out only the sign and the rough size of a distance count: there the
same is done for every `SPACING_PX`-th pixel, and what lies between is interpolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import MARGIN_PX

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]
Mask = NDArray[np.bool_]
Contours = Sequence[NDArray[np.int32]]

REACH = 8
"""A piece of edge writes into so many pixels to either side. A cell of marching cubes is 4 to 5 px wide."""
NEAR_PX = REACH - 1
"""Up to here the distance is the true one: the nearest piece has surely written."""
SPACING_PX = -(-MARGIN_PX // NEAR_PX)
"""Between the pixels that the distances further out are found for."""
HALF_PIECE_PX = 1.0
"""Half the length of the piece of edge that a pixel owns."""
TANGENT_REACH = 3
"""The direction of the edge is the slope of the regression through so many points on either side."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edge:
    """The sub-pixel edge of a body in a region, cut into pieces."""

    body: Grey  # (h, w) not 0 on the silhouette, unknown pixels it may extend behind included
    contours: Contours  # of the body, unabridged, the outer one first
    points_uv: NDArray[np.float64]  # (N, 2) the mean crossing of the edge beside each pixel of the contours
    seen: Mask  # (N,) whether grey levels gave it

    @property
    def outline_uv(self) -> NDArray[np.float64]:
        """Points (M, 2) in order around the outer contour, only where the edge was seen."""
        n_outer = len(self.contours[0])
        return self.points_uv[:n_outer][self.seen[:n_outer]]

    def distance_px(self) -> Array:
        """Signed distance (h, w) to the edge, positive within.

        Up to `NEAR_PX` it is that to the sub-pixel edge. Beyond it is rough: up to 3 px too small, hardly ever
        too large, and cut off at +-`MARGIN_PX`.
        """
        height, width = self.body.shape
        pieces = _pieces(self.points_uv, np.cumsum([len(contour) for contour in self.contours]))
        rows, columns = (
            np.minimum(np.arange(SPACING_PX // 2, size + SPACING_PX - 1, SPACING_PX), size - 1)
            for size in (height, width)
        )
        sparse = np.where(self.body[np.ix_(rows, columns)], np.float32(MARGIN_PX), np.float32(-MARGIN_PX))
        _keep_nearest(sparse, pieces, SPACING_PX)
        widened = np.asarray(cv2.resize(sparse, (SPACING_PX * len(columns), len(rows))), np.float32)
        distances = _between(widened, self.body)
        _keep_nearest(distances, pieces, 1)
        return distances


@compiled
def _pieces(points_uv: NDArray[np.float64], ends: NDArray[np.int64]) -> Array:
    """Points, a little smoothed, and inward normals of the pieces of edge: (N, 4).

    Contours, whose points end at `ends` (C,), run with the body on their right.
    """
    pieces = np.empty((len(points_uv), 4), np.float32)
    first = 0
    for end in ends:
        n = end - first
        for i in range(n):
            along_u, along_v = 0.0, 0.0
            for k in range(1, TANGENT_REACH + 1):
                after, before = first + (i + k) % n, first + (i - k) % n
                along_u += k * (points_uv[after, 0] - points_uv[before, 0])
                along_v += k * (points_uv[after, 1] - points_uv[before, 1])
            length = max(np.sqrt(along_u * along_u + along_v * along_v), 1e-6)
            inward_u, inward_v = along_v / length, -along_u / length
            after, before = first + (i + 1) % n, first + (i - 1) % n
            u, v = points_uv[first + i, 0], points_uv[first + i, 1]
            offset_u = (points_uv[before, 0] + points_uv[after, 0]) / 2 - u
            offset_v = (points_uv[before, 1] + points_uv[after, 1]) / 2 - v
            inwards = (offset_u * inward_u + offset_v * inward_v) / 2
            pieces[first + i, 0], pieces[first + i, 1] = u + inwards * inward_u, v + inwards * inward_v
            pieces[first + i, 2], pieces[first + i, 3] = inward_u, inward_v
        first = end
    return pieces


@compiled
def _between(rows: Array, body: Grey) -> Array:
    """Distances (h, w) between those of every `SPACING_PX`-th row, at least `NEAR_PX`, positive within the body."""
    height, width = body.shape
    distances = np.empty((height, width), np.float32)
    for v in range(height):
        at = max(np.float32(v - (SPACING_PX - 1) / 2) / np.float32(SPACING_PX), np.float32(0))
        above, below = int(at), min(int(at) + 1, len(rows) - 1)
        weight = at - np.float32(above)
        for u in range(width):
            rough = (1 - weight) * rows[above, u] + weight * rows[below, u]
            distance = max(abs(rough), np.float32(NEAR_PX))
            distances[v, u] = distance if body[v, u] else -distance
    return distances


@compiled
def _keep_nearest(distances: Array, pieces: Array, spacing_px: int) -> None:
    """Replace signed distances (h, w) of every `spacing_px`-th pixel by those to pieces around that are nearer.

    Of the pieces, too, only every `spacing_px`-th is looked at, and taken to be so much longer.
    """
    height, width = distances.shape
    flat = distances.reshape(-1)
    n_rows, n_columns = min(2 * REACH, height), min(2 * REACH, width)
    spacing, first_px = np.float32(spacing_px), np.float32((spacing_px - 1) / 2)
    half_px = np.float32(HALF_PIECE_PX) + first_px
    for piece in range(0, len(pieces), spacing_px):
        point_u, point_v = pieces[piece, 0], pieces[piece, 1]
        inward_u, inward_v = pieces[piece, 2], pieces[piece, 3]
        left = min(max(int((point_u - first_px) / spacing) - REACH + 1, 0), width - n_columns)
        top = min(max(int((point_v - first_px) / spacing) - REACH + 1, 0), height - n_rows)
        for row in range(top, top + n_rows):
            offset_u = first_px + spacing * np.float32(left) - point_u
            offset_v = first_px + spacing * np.float32(row) - point_v
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
