"""A segmenter to compare others with: what differs from the empty view is the silhouette."""

import cv2

from pipeline.frames import Frame, Image
from pipeline.segmentation import BackgroundModel, Silhouette, ViewStatus
from pipeline.segmentation.delineation import no_body
from pipeline.segmentation.mask_segmenter import silhouette_of_mask

THRESHOLD_GREY = 25


def plain_difference(frame: Frame, background: BackgroundModel) -> Silhouette:
    """The largest component of what differs from the empty view over all of the image, to whole pixels."""
    known = background.get(frame.camera)
    if known is None:
        return no_body(frame, ViewStatus.NO_BACKGROUND)
    mask = difference(frame.image, known.mean.astype(frame.image.dtype))
    return silhouette_of_mask(frame, mask > 0)


def difference(image: Image, empty: Image) -> Image:
    """What differs, 0 or 1."""
    return cv2.threshold(cv2.absdiff(image, empty), THRESHOLD_GREY, 1, cv2.THRESH_BINARY)[1]
