"""The sub-pixel edge of a body, and the signed distance of every pixel to it.

The edge crosses the line between two neighbouring pixels on different sides where the interpolated
coverage is 1/2. Each pixel of the body beside the edge owns a short piece of it: through the mean of its
crossings, along the chain of its neighbours' points. The distance of any pixel is that to the nearest
piece, which OpenCV's labelled distance transform finds.
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

NEAR_PX = 10
"""Up to here the distance is the true one: a cell of marching cubes, 4 to 5 px wide, reaches no further. Beyond,
where only the sign and the rough size count, it is OpenCV's, to the pixels beside the edge."""
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

        It is that to the sub-pixel edge up to `NEAR_PX`, and cut off at +-`MARGIN_PX`.
        """
        height, width = self.body.shape
        pixels_uv = np.concatenate(self.contours)[:, 0]
        owners = pixels_uv[:, 1] * np.int32(width) + pixels_uv[:, 0]
        elsewhere = np.ones((height, width), np.uint8)
        elsewhere.flat[owners] = 0
        rough, nearest = cv2.distanceTransformWithLabels(
            elsewhere, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
        )
        piece_of = np.zeros(len(owners) + 1, np.int32)
        piece_of[nearest.flat[owners]] = np.arange(len(owners), dtype=np.int32)
        pieces = np.concatenate([_pieces(part) for part in np.split(self.points_uv, self._ends[:-1])])
        return _refined(
            np.asarray(rough, np.float32),
            np.asarray(nearest, np.int32),
            self.body,
            piece_of,
            pieces,
            np.float32(MARGIN_PX),
        )

    @property
    def _ends(self) -> NDArray[np.int64]:
        return np.cumsum([len(contour) for contour in self.contours])


def _pieces(points_uv: NDArray[np.float64]) -> Array:
    """Points (N, 2) of a contour that runs with the body on its right, a little smoothed, and their normals: (N, 4)."""
    tangents = np.zeros_like(points_uv)
    for k in range(1, TANGENT_REACH + 1):
        tangents += k * (np.roll(points_uv, -k, axis=0) - np.roll(points_uv, k, axis=0))
    tangents /= np.maximum(np.linalg.norm(tangents, axis=1, keepdims=True), 1e-6)
    inward = np.stack([tangents[:, 1], -tangents[:, 0]], axis=1)
    between = (np.roll(points_uv, 1, axis=0) + np.roll(points_uv, -1, axis=0)) / 2
    offsets = np.sum((between - points_uv) * inward, axis=1, keepdims=True) / 2
    return np.concatenate([points_uv + offsets * inward, inward], axis=1, dtype=np.float32)


@compiled
def _refined(
    rough: Array,
    nearest: NDArray[np.int32],
    body: Grey,
    piece_of: NDArray[np.int32],
    pieces: Array,
    margin_px: np.float32,
) -> Array:
    """Signed distances (h, w) from the rough ones and the label of the piece that is nearest, or next to it."""
    height, width = body.shape
    distances = np.empty((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            side = np.float32(1) if body[v, u] else np.float32(-1)
            # the edge is half a pixel outside of the outermost pixels of the body
            distance = min(rough[v, u] + side / 2, margin_px)
            across = distance
            if distance < NEAR_PX:
                distance = margin_px
                own = piece_of[nearest[v, u]]
                for piece in range(max(own - 1, 0), min(own + 2, len(pieces))):
                    point_u, point_v, inward_u, inward_v = pieces[piece]
                    offset_u, offset_v = np.float32(u) - point_u, np.float32(v) - point_v
                    inwards = offset_u * inward_u + offset_v * inward_v
                    along = abs(offset_u * inward_v - offset_v * inward_u)
                    beyond = max(along - np.float32(HALF_PIECE_PX), np.float32(0))
                    candidate = np.sqrt(inwards * inwards + beyond * beyond)
                    if candidate < distance:
                        distance, across = candidate, inwards
            distances[v, u] = across if distance < 1 else side * distance
    return distances
