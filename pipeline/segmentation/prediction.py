"""Prediction of a network for a region of an image: the pixels of the body, and the uncertain ones."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatImage, GreyImage
from pipeline.segmentation.expected_view import ExpectedView
from pipeline.segmentation.network import MAX_RELATIVE, Network
from pipeline.segmentation.network_region import Box, Region
from pipeline.segmentation.silhouette import MARGIN_PX, ViewStatus
from pipeline.segmentation.subtraction import SegmentationParameters

SURE, SURELY_NOT = np.float32(0.9), np.float32(0.1)
"""P(body) from which on a pixel is body, and up to which it is not; between, the network does not know."""
NETWORK_BLUR_PX = 2
"""Blur of the network itself, in its pixels: its edge may be this far from the true one."""
EDGE_BLUR_PX = 4
"""Lens and motion mix body and background up to this distance from the edge, in image pixels."""
MIN_SHARE_WITHOUT_BACKGROUND = 0.0115
"""Smallest body, as a share of the view, that is accepted without a background (7 mm): smaller ones look like a vent
or a screw of the housing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prediction:
    """Prediction for a region; arrays have the region's height and width."""

    region: Region
    image: FloatImage  # as a share of the plain wall
    expected: FloatImage  # the same without a body
    probability: FloatImage
    undecided: GreyImage  # not 0 where the network does not know, over more than its own blur
    body: GreyImage  # 1 for the largest body, with its holes, and for the undecided pixels that touch it
    status: ViewStatus

    @property
    def box_px(self) -> Box:
        """Bounding box of the body in image pixels."""
        region = self.region
        x, y, width, height = (region.scale * at for at in cv2.boundingRect(self.body))
        return x + region.left, y + region.top, width, height

    def lacks_margin(self, shape: tuple[int, ...]) -> bool:
        """True when the region cuts the body's margin where the image (H, W) goes on."""
        region = self.region
        x, y, width, height = cv2.boundingRect(self.body)
        (rows, columns), margin = region.within(shape), _margin(region)
        return (
            (x < margin and columns.start > 0)
            or (y < margin and rows.start > 0)
            or (x + width + margin > region.width and columns.stop < shape[1])
            or (y + height + margin > region.height and rows.stop < shape[0])
        )

    def cropped_to_body(self) -> "Prediction":
        """Return the prediction for the body and a silhouette's margin around it."""
        x, y, width, height = cv2.boundingRect(self.body)
        region, part = self.region.part((x, y, width, height), _margin(self.region))
        return Prediction(
            region=region,
            # compiled loops are compiled again for arrays with gaps
            image=np.ascontiguousarray(self.image[part]),
            expected=np.ascontiguousarray(self.expected[part]),
            probability=np.ascontiguousarray(self.probability[part]),
            undecided=np.ascontiguousarray(self.undecided[part]),
            body=np.ascontiguousarray(self.body[part]),
            status=self.status,
        )


def predict(
    network: Network,
    image: GreyImage,
    expected_view: ExpectedView,
    region: Region,
    parameters: SegmentationParameters,
) -> Prediction:
    """Run a network on a region of an image (H, W) and find the largest body in its answer."""
    view = np.empty((2, region.height, region.width), np.float32)
    region.reduce(image, 1 / expected_view.wall, view[0])
    region.sample(expected_view.coarse, expected_view.gain / expected_view.wall, view[1])
    np.minimum(view, MAX_RELATIVE, out=view)
    is_known = expected_view.levels is not None
    probability = network.probability(view if is_known else np.stack([view[0], np.zeros_like(view[1])]))
    is_body = (probability > 0.5).view(np.uint8)
    undecided = cv2.inRange(probability, float(SURELY_NOT), float(SURE))
    undecided = eroded(undecided, NETWORK_BLUR_PX)
    undecided = dilated(undecided, NETWORK_BLUR_PX) if undecided.any() else undecided
    contours, _ = cv2.findContours(is_body | undecided, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    min_body = parameters.min_body_px / region.scale**2
    bodies = []
    for contour in contours:
        if cv2.contourArea(contour) + len(contour) < min_body:
            continue
        filled = np.zeros_like(is_body)
        cv2.drawContours(filled, [contour], 0, 1, cv2.FILLED)
        bodies.append((cv2.countNonZero(filled & is_body), filled))
    bodies.sort(key=lambda sized: -sized[0])
    areas = [area for area, _ in bodies] + [0, 0]
    status = ViewStatus.OK
    if areas[0] < min_body:
        status = ViewStatus.EMPTY
    elif not is_known and areas[0] < MIN_SHARE_WITHOUT_BACKGROUND * image.size / region.scale**2:
        status = ViewStatus.NO_BACKGROUND
    elif areas[1] > max(min_body, parameters.second_body_share * areas[0]):
        status = ViewStatus.MULTIPLE
    return Prediction(
        region=region,
        image=view[0],
        expected=view[1],
        probability=probability,
        undecided=undecided,
        body=bodies[0][1] if bodies else is_body,
        status=status,
    )


def eroded(mask: NDArray[np.generic], radius_px: int) -> GreyImage:
    """Return the mask (h, w) eroded by a disc of this radius."""
    return np.asarray(cv2.erode(np.asarray(mask, np.uint8), _disc(radius_px)), np.uint8)


def dilated(mask: GreyImage, radius_px: int) -> GreyImage:
    """Return the mask (h, w) dilated by a disc of this radius."""
    return np.asarray(cv2.dilate(mask, _disc(radius_px)), np.uint8)


def _margin(region: Region) -> int:
    """Return the margin of a silhouette in the network's pixels."""
    return -(-(MARGIN_PX + EDGE_BLUR_PX) // region.scale)


def _disc(radius_px: int) -> GreyImage:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1,) * 2), np.uint8)
