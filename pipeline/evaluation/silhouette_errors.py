"""Errors of a silhouette against a rendered view's true coverage of each pixel.

The true edge is where the coverage is 1/2. Grey levels show it only where body and background differ;
elsewhere a segmenter should label pixels unknown. So edges are judged where they are visible, and
labels that claim certainty everywhere.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from scipy.special import ndtri
from skimage.measure import find_contours

from pipeline.arrays import Flags, FloatImage, Indices, Mask, PointsUV, Values
from pipeline.segmentation.silhouette import INSIDE, MAX_STEP_PX, OUTSIDE, UNKNOWN, Silhouette, ViewStatus
from pipeline.segmentation.subtraction import SegmentationParameters

VISIBLE_GREY = 25.0
"""Least contrast of a visible edge: an eighth of the wall's grey level, ten times a clean image's noise."""
MIN_COVERAGE = 0.02
"""Coverages are clipped to this and to one less this: beyond, they say nothing of where an edge lies."""
NEIGHBOURS = np.ones((3, 3), np.uint8)
"""Structuring element of one pixel around."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrueEdge:
    """The outer edge of the largest body in a view, as a closed line."""

    body: Mask  # (H, W) its pixels
    coverage: FloatImage  # (H, W) by that body alone
    points_uv: PointsUV  # in order, less than 1.5 px apart
    is_visible: Flags  # of each point

    def distances_px(self, points_uv: PointsUV) -> tuple[Values, Indices]:
        """Return signed distances (N,) of points (N, 2) to the line, positive outside, and its nearest points (N,)."""
        near = cKDTree(self.points_uv).query(points_uv)[1]
        ends = self.points_uv[(near[:, None] + [-1, 1]) % len(self.points_uv)]
        beside = np.stack(
            [_segment_distances(points_uv, self.points_uv[near], ends[:, side]) for side in (0, 1)]
        )
        side = np.where(_at(self.coverage, points_uv) < 0.5, 1.0, -1.0)
        return side * beside.min(axis=0), near


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SilhouetteErrors:
    """Errors of one silhouette."""

    iou: float  # of inside and true body; unknown pixels are left out of both
    unknown_share: float  # of the body's pixels
    wrong_share: float  # pixels more than one from the edge with a wrong label, as a share of the body
    seen_share: float  # of the visible edge: what has an outline beside it
    offsets_px: Values
    """Signed distances of the outline's points to the true edge, positive outside, only where that is visible."""

    @property
    def bias_px(self) -> float:
        """Mean distance of the outline, positive if it is too large; NaN without one."""
        return float(self.offsets_px.mean()) if len(self.offsets_px) else float("nan")

    @property
    def rms_px(self) -> float:
        """Root mean square of the distances; NaN without an outline."""
        return float(np.sqrt(np.mean(self.offsets_px**2))) if len(self.offsets_px) else float("nan")


def true_edge(coverage: FloatImage, contrast: FloatImage | None = None) -> TrueEdge:
    """Return the edge of the largest body in a view.

    Parameters
    ----------
    coverage
        (H, W) share of each pixel that bodies cover.
    contrast
        (H, W) |body - background| in grey levels, without noise; without it the whole edge is visible.

    Raises
    ------
    ValueError
        Nothing is covered.
    """
    labels, boxes = _bodies(coverage)
    if len(boxes) == 0:
        raise ValueError("the view shows no body: coverage is nowhere above 1/2")
    largest = int(np.argmax(boxes[:, cv2.CC_STAT_AREA]))
    body: Mask = labels == largest + 1
    left, top, width, height = boxes[largest, :4]
    # with a border of zeros, which closes what the image cuts off
    around = (slice(top, top + height + 4), slice(left, left + width + 4))
    alone = np.where(cv2.dilate(body.astype(np.uint8), NEIGHBOURS), coverage, np.float32(0))
    # linear across a blurred edge, which coverage itself is not
    probit = ndtri(np.clip(np.pad(alone, 2)[around], MIN_COVERAGE, 1 - MIN_COVERAGE))
    outer = max(find_contours(probit, 0.0, fully_connected="high"), key=_extent_px)
    points_uv = outer[:-1, ::-1] + (left - 2, top - 2)
    is_visible = np.ones(len(points_uv), bool)
    if contrast is not None:
        is_visible = _at(contrast, points_uv) >= VISIBLE_GREY
    return TrueEdge(body=body, coverage=alone, points_uv=points_uv, is_visible=is_visible)


def true_status(coverage: FloatImage, parameters: SegmentationParameters) -> ViewStatus:
    """Return the status that a segmenter should give a view whose pixels (H, W) are covered like this."""
    _, boxes = _bodies(coverage)
    if len(boxes) == 0 or boxes[:, cv2.CC_STAT_AREA].max() < parameters.min_body_px:
        return ViewStatus.EMPTY
    order = np.argsort(boxes[:, cv2.CC_STAT_AREA])[::-1]
    left, top, width, height, area = boxes[order[0]]
    smaller_px = boxes[order[1:], cv2.CC_STAT_AREA]
    if np.any(smaller_px > max(parameters.min_body_px, parameters.second_body_share * area)):
        return ViewStatus.MULTIPLE
    rows, columns = coverage.shape
    is_cut = left == 0 or top == 0 or left + width == columns or top + height == rows
    return ViewStatus.CLIPPED if is_cut else ViewStatus.OK


def silhouette_errors(silhouette: Silhouette, truth: TrueEdge) -> SilhouetteErrors:
    """Return the errors of a usable silhouette.

    Raises
    ------
    ValueError
        The silhouette is not usable, or of another image size.
    """
    if not silhouette.is_usable:
        raise ValueError(f"camera {silhouette.camera}: a view that is {silhouette.status} has no silhouette")
    labels, body = silhouette.label_image(), truth.body
    if labels.shape != body.shape:
        raise ValueError(
            f"camera {silhouette.camera}: the silhouette is of an image {labels.shape}, the truth of {body.shape}"
        )
    inside, known = labels == INSIDE, labels != UNKNOWN
    with_rim, without_rim = (
        change(body.astype(np.uint8), NEIGHBOURS).astype(bool) for change in (cv2.dilate, cv2.erode)
    )
    wrong = (inside & ~with_rim) | ((labels == OUTSIDE) & without_rim)
    area = int(np.count_nonzero(body))
    distances_px, near = truth.distances_px(silhouette.outline_uv)
    outline = cKDTree(silhouette.outline_uv) if len(silhouette.outline_uv) else None
    visible_uv = truth.points_uv[truth.is_visible]
    is_seen = (
        np.zeros(len(visible_uv), bool) if outline is None else outline.query(visible_uv)[0] < MAX_STEP_PX
    )
    return SilhouetteErrors(
        iou=int(np.count_nonzero(inside & body)) / max(int(np.count_nonzero((inside | body) & known)), 1),
        unknown_share=int(np.count_nonzero(~known & body)) / area,
        wrong_share=int(np.count_nonzero(wrong)) / area,
        seen_share=float(is_seen.mean()) if len(visible_uv) else float("nan"),
        offsets_px=distances_px[truth.is_visible[near]],
    )


def _bodies(coverage: FloatImage) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return labels (H, W) from 1 on, and left, top, width, height and area (N, 5) of each body."""
    _, labels, boxes, _ = cv2.connectedComponentsWithStats((coverage > 0.5).astype(np.uint8))
    return np.asarray(labels, np.int32), np.asarray(boxes[1:], np.int32)


def _at(image: FloatImage, points_uv: PointsUV) -> Values:
    """Return values (N,) of an image (H, W) at points (N, 2), linear between pixels."""
    return map_coordinates(image, points_uv.T[::-1], order=1, mode="nearest")


def _segment_distances(points_uv: PointsUV, start_uv: PointsUV, end_uv: PointsUV) -> Values:
    """Return the distance (N,) of each point (N, 2) to its line segment."""
    along = end_uv - start_uv
    length2 = np.maximum(np.einsum("ij,ij->i", along, along), 1e-12)
    share = np.clip(np.einsum("ij,ij->i", points_uv - start_uv, along) / length2, 0, 1)
    return np.linalg.norm(points_uv - start_uv - share[:, None] * along, axis=1)


def _extent_px(points: PointsUV) -> float:
    return float(np.ptp(points, axis=0).sum())
