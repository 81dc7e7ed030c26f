"""From coverage to the signed distance of every pixel to the sub-pixel edge.

The edge crosses the line between two neighbouring pixels on different sides where the interpolated
coverage is 1/2. Each pixel beside the edge owns a short piece of it through the mean
of its crossings, square to the local gradient; the distance of any pixel is that to the piece owned
by the nearest such pixel (found by OpenCV's labelled distance transform).
"""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from pipeline.segmentation.silhouette import MARGIN_PX

NEAR_PX = 10
"""Up to here the distance is the true one: a cell of marching cubes, 4 to 5 px wide, reaches no further. Beyond,
where only the sign and the rough size count, it is OpenCV's, to the pixels beside the edge."""
HALF_PIECE_PX = 2.0
"""Half the length of the piece of edge that a pixel owns: the nearest pixel that OpenCV names may be one
beside the nearest one."""


def signed_distance(
    body: NDArray[np.bool_], coverage: NDArray[np.float32], unknown: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Distance in px to the edge of `body`, positive within, and the edge points that were seen.

    Distances are those to the sub-pixel edge up to `NEAR_PX` and cut off at +-`MARGIN_PX`.

    Parameters
    ----------
    body
        (h, w) the silhouette, unknown pixels it may extend behind included.
    coverage
        (h, w) share of the pixel covered by the body, 0..1.
    unknown
        (h, w) pixels whose coverage means nothing; the edge beside them lies half-way between pixels.

    Returns
    -------
    tuple
        Distances (h, w) float32, and the points (N, 2) as (u, v) of this region around the outer contour.
    """
    level = np.where(unknown, body, coverage).astype(np.float32)
    edge_u, edge_v, count, seen = _edge_points(body, level, unknown)
    beside = count > 0
    pixels_v, pixels_u = _positions(beside)
    points_u = edge_u[beside] / count[beside]
    points_v = edge_v[beside] / count[beside]

    # the gradient of the slightly smoothed silhouette points inwards
    smooth = cv2.GaussianBlur(np.where(body, np.maximum(level, 0.5), np.minimum(level, 0.5)), (0, 0), 1.5)
    gradient_u = cv2.Sobel(smooth, cv2.CV_32F, 1, 0)[beside]
    gradient_v = cv2.Sobel(smooth, cv2.CV_32F, 0, 1)[beside]
    norm = np.maximum(np.hypot(gradient_u, gradient_v), 1e-6)
    normal_u, normal_v = gradient_u / norm, gradient_v / norm

    rough, owner = cv2.distanceTransformWithLabels(
        (~beside).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    index_of = np.zeros(int(owner.max()) + 1, np.int32)
    index_of[owner[pixels_v, pixels_u]] = np.arange(len(pixels_u), dtype=np.int32)
    pieces = np.stack([points_u, points_v, normal_u, normal_v], axis=1).astype(np.float32)

    side = np.where(body, np.float32(1), np.float32(-1))
    signed = side * np.minimum(rough, np.float32(MARGIN_PX))
    near = rough < NEAR_PX
    near_v, near_u = (pixels.astype(np.float32) for pixels in _positions(near))
    piece_u, piece_v, inward_u, inward_v = pieces[index_of[owner[near]]].T
    offset_u, offset_v = near_u - piece_u, near_v - piece_v
    across = offset_u * inward_u + offset_v * inward_v
    along = np.abs(offset_u * inward_v - offset_v * inward_u)
    distance = np.hypot(across, np.maximum(along - np.float32(HALF_PIECE_PX), 0))
    signed[near] = np.where(distance < 1, across, side[near] * distance)

    contours, _ = cv2.findContours(body.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    around = np.concatenate(contours)[:, 0]  # pixels of the body beside the edge, (u, v)
    around = around[(beside & seen)[around[:, 1], around[:, 0]]]
    outline = pieces[index_of[owner[around[:, 1], around[:, 0]]], :2].astype(np.float64)
    return signed, outline


def _edge_points(
    body: NDArray[np.bool_], level: NDArray[np.float32], unknown: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Per pixel: sums of u and v of its crossings, their number, and whether both sides were known at each."""
    shape = body.shape
    sum_u, sum_v, count = (np.zeros(shape, np.float32) for _ in range(3))
    seen = np.ones(shape, bool)
    for axis in (0, 1):
        first = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        second = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        crossing_v, crossing_u = _positions(body[first] != body[second])
        # under a Gaussian blur of any width the probit of the coverage is linear across the edge
        a, b = (ndtri(np.clip(level[side][crossing_v, crossing_u], 0.02, 0.98)) for side in (first, second))
        known = ~(unknown[first] | unknown[second])[crossing_v, crossing_u]
        straddles = (a * b <= 0) & known
        share = np.where(straddles, a / np.where(a == b, 1, a - b), 0.5).astype(np.float32)
        point_u = crossing_u + (share if axis == 1 else 0)
        point_v = crossing_v + (share if axis == 0 else 0)
        for step in (0, 1):
            pixel = (crossing_v + step * (axis == 0), crossing_u + step * (axis == 1))
            # a pixel has at most one crossing in each of the four directions, so no index repeats here
            sum_u[pixel] += point_u
            sum_v[pixel] += point_v
            count[pixel] += 1
            seen[pixel] &= known
    return sum_u, sum_v, count, seen


def _positions(mask: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """As `np.nonzero` (rows, columns), several times faster on sparse masks."""
    return np.divmod(np.flatnonzero(mask), mask.shape[1])
