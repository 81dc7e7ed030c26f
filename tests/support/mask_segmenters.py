"""Segmenters whose mask is the silhouette, to compare others with: a network as the paper uses it, and none at all."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from skimage.measure import find_contours

from pipeline.frames import Frame, Image
from pipeline.segmentation import BackgroundModel, Silhouette, ViewStatus
from pipeline.segmentation.delineation import no_body
from pipeline.segmentation.network import Network
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE

THRESHOLD_GREY = 25


@dataclass(frozen=True, slots=True)
class MaskSegmenter:
    """As the paper does it: a network sees the whole image, and its mask is the silhouette."""

    network: Network

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        probability = self.network.probability(frame.image[None].astype(np.float32))
        mask = (probability > 0.5).astype(np.uint8)
        return silhouette_of_mask(frame, mask, probability, found_by=self.network.kind)


def plain_difference(frame: Frame, background: BackgroundModel) -> Silhouette:
    """The largest component of what differs from the empty view over all of the image, to whole pixels."""
    known = background.get(frame.camera)
    if known is None:
        return no_body(frame, ViewStatus.NO_BACKGROUND)
    mask = difference(frame.image, known.mean.astype(np.uint8))
    return silhouette_of_mask(frame, mask, mask, found_by="difference")


def difference(image: Image, empty: Image) -> Image:
    """What differs, 0 or 1."""
    return cv2.threshold(cv2.absdiff(image, empty), THRESHOLD_GREY, 1, cv2.THRESH_BINARY)[1]


def silhouette_of_mask(
    frame: Frame, mask: Image, level: NDArray[np.float32] | Image, found_by: str
) -> Silhouette:
    """The largest component of a mask (H, W), with its outline where the level passes 1/2."""
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(mask)
    if len(boxes) < 2:
        return no_body(frame, ViewStatus.EMPTY)
    largest = 1 + int(np.argmax(boxes[1:, cv2.CC_STAT_AREA]))
    left, top, width, height = (int(size) for size in boxes[largest, :4])
    rows, columns = slice(max(top - 2, 0), top + height + 2), slice(max(left - 2, 0), left + width + 2)
    body = labels[rows, columns] == largest
    nearby = cv2.dilate(body.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    framed = np.pad(np.where(nearby, level[rows, columns], 0).astype(np.float32), 1)
    outline = max(find_contours(framed, 0.5), key=len) - 1
    return Silhouette(
        camera=frame.camera,
        status=ViewStatus.OK,
        image_size_px=(frame.image.shape[1], frame.image.shape[0]),
        offset_uv=(columns.start, rows.start),
        labels=np.where(body, INSIDE, OUTSIDE),
        outline_uv=outline[:-1, ::-1] + (columns.start, rows.start),
        found_by=found_by,
    )
