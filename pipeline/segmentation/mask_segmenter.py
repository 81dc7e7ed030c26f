"""Masks as silhouettes: that of a network that sees the whole image, as in the paper, or one that was imported.

The paper uses U2-Net with its official weights. The mask is that of the published code: the first output, stretched
between its extremes, above one half; of its contours the largest counts. The network computes on 320 x 320, so an
image of 1280 x 1024 has an edge every 4 px. Nothing is measured at the edge itself: its width is not known, and no
result of such silhouettes is ever `good`.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import skimage  # imports its submodules on use
from numpy.typing import NDArray

from pipeline.arrays import FloatImage, GreyImage, PointsUV
from pipeline.errors import ModelError
from pipeline.frames import Frame
from pipeline.segmentation.background import BackgroundModel
from pipeline.segmentation.delineation import no_body
from pipeline.segmentation.network import Network
from pipeline.segmentation.silhouette import (
    INSIDE,
    MARGIN_PX,
    OUTSIDE,
    FoundBy,
    KnownDistances,
    Silhouette,
    ViewStatus,
)

THRESHOLD = 0.5


@dataclass(frozen=True, slots=True)
class MaskSegmenter:
    """The `Segmenter` whose silhouette is the mask of a network; it needs no background."""

    network: Network

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """Return the largest contour of the mask; a network that fails finds an empty view, and says why."""
        try:
            probability = self.network.probability(frame.image[None].astype(np.float32))
        except ModelError as err:
            empty = no_body(frame, ViewStatus.EMPTY, FoundBy.U2NET)
            return replace(empty, fallback=str(err), network_trouble=str(err))
        return silhouette_of_mask(frame, probability > THRESHOLD, FoundBy.U2NET)


def imported_mask(frame: Frame, background: BackgroundModel) -> Silhouette:
    """Return the silhouette of a frame that is a mask, 255 where the body is; a `Segmenter`."""
    return silhouette_of_mask(frame, frame.image > 127, FoundBy.MASK)


def mask_of(pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> GreyImage | None:
    """Return the mask (H, W), 255 where the body is, that an image of two grey levels is; None if there are more.

    The level of most of the image's border is the background. An image of one level is a mask without a body.
    """
    low, high = pixels.min(), pixels.max()
    is_high = pixels == high
    if not (is_high | (pixels == low)).all():
        return None
    if low == high:
        return np.zeros(pixels.shape, np.uint8)
    border = np.concatenate([is_high[0], is_high[-1], is_high[:, 0], is_high[:, -1]])
    return np.where(is_high != (np.mean(border) > 0.5), np.uint8(255), np.uint8(0))


def silhouette_of_mask(frame: Frame, mask: NDArray[np.bool_], found_by: FoundBy) -> Silhouette:
    """Return the silhouette of the largest contour of a mask (H, W), to whole pixels."""
    found, _ = cv2.findContours(mask.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    if not found:
        return no_body(frame, ViewStatus.EMPTY, found_by)
    contour = np.asarray(max(found, key=cv2.contourArea))
    height_px, width_px = mask.shape
    left, top, width, height = cv2.boundingRect(contour)
    if left == 0 or top == 0 or left + width == width_px or top + height == height_px:
        return no_body(frame, ViewStatus.CLIPPED, found_by)
    corner_uv = max(left - MARGIN_PX, 0), max(top - MARGIN_PX, 0)
    end_u, end_v = min(left + width + MARGIN_PX, width_px), min(top + height + MARGIN_PX, height_px)
    labels = np.full((end_v - corner_uv[1], end_u - corner_uv[0]), OUTSIDE)
    cv2.drawContours(labels, [contour], 0, int(INSIDE), cv2.FILLED, offset=(-corner_uv[0], -corner_uv[1]))
    return Silhouette(
        camera=frame.camera,
        status=ViewStatus.OK,
        image_size_px=(width_px, height_px),
        offset_uv=corner_uv,
        labels=labels,
        outline_uv=_outline_uv(labels) + corner_uv,
        distances=KnownDistances(_distances_px(labels)),
        found_by=found_by,
    )


def _outline_uv(labels: GreyImage) -> PointsUV:
    """Return points (N, 2) half-way between the pixels inside and those outside, relative to the first pixel."""
    outlines = skimage.measure.find_contours((labels == INSIDE).astype(np.float32), 0.5)
    return np.asarray(max(outlines, key=len)[:-1, ::-1])


def _distances_px(labels: GreyImage) -> FloatImage:
    """Return the signed distance (h, w) of each pixel's centre to the edge between pixels, positive within."""
    inside, outside = (
        cv2.distanceTransform((labels == label).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        for label in (INSIDE, OUTSIDE)
    )
    half = np.float32(0.5)
    return np.asarray(np.where(labels == INSIDE, inside - half, half - outside), np.float32)
