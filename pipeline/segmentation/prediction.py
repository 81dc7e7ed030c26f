"""What a network says of a region of an image: which of its pixels are the one body, and which it cannot tell."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.segmentation.expected_view import Ground
from pipeline.segmentation.network import MAX_RELATIVE, Network
from pipeline.segmentation.network_region import Array, Bits, Box, Region
from pipeline.segmentation.network_trimap import SURE, SURELY_NOT
from pipeline.segmentation.silhouette import MARGIN_PX, ViewStatus
from pipeline.segmentation.subtraction import SegmentationParameters

BLUR = 2
"""The network's own blur, in its pixels: so far its edge may be from the true one."""
EDGE_PX = 4
"""Beyond this depth in image pixels, inwards and outwards, the lens and the motion no longer mix."""
SURE_ALONE_SHARE = 0.0115
"""Of the view: without a background a smaller body (7 mm) is not told from a vent or a screw of the housing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """What the network says of a region; arrays have its size."""

    region: Region
    image: Array  # as a share of the plain wall
    expected: Array  # the same without a body
    probability: Array
    undecided: Bits  # not 0 where the network does not know, over more than its own blur
    body: Bits  # 1 for the largest body, with its holes, and for the undecided pixels that touch it
    status: ViewStatus

    @property
    def box_px(self) -> Box:
        """Of the body, in image pixels."""
        region = self.region
        x, y, width, height = (region.scale * at for at in cv2.boundingRect(self.body))
        return x + region.left, y + region.top, width, height

    def is_cut(self, shape: tuple[int, ...]) -> bool:
        """Whether the image (H, W) has more of the body's margin than the region does."""
        region = self.region
        x, y, width, height = cv2.boundingRect(self.body)
        (rows, columns), margin = region.within(shape), _margin(region)
        return (
            (x < margin and columns.start > 0)
            or (y < margin and rows.start > 0)
            or (x + width + margin > region.width and columns.stop < shape[1])
            or (y + height + margin > region.height and rows.stop < shape[0])
        )

    def near_the_body(self) -> "Answer":
        """The answer for the body and a silhouette's margin around it."""
        x, y, width, height = cv2.boundingRect(self.body)
        region, part = self.region.part((x, y, width, height), _margin(self.region))
        return Answer(
            region=region,
            # compiled loops are compiled again for arrays with gaps
            image=np.ascontiguousarray(self.image[part]),
            expected=np.ascontiguousarray(self.expected[part]),
            probability=np.ascontiguousarray(self.probability[part]),
            undecided=np.ascontiguousarray(self.undecided[part]),
            body=np.ascontiguousarray(self.body[part]),
            status=self.status,
        )


def ask(
    network: Network, image: Bits, ground: Ground, region: Region, parameters: SegmentationParameters
) -> Answer:
    """What a network finds in a region of an image (H, W)."""
    view = np.empty((2, region.height, region.width), np.float32)
    region.reduce(image, 1 / ground.wall, view[0])
    region.sample(ground.coarse, ground.gain / ground.wall, view[1])
    np.minimum(view, MAX_RELATIVE, out=view)
    is_known = ground.levels is not None
    probability = network.probability(view if is_known else np.stack([view[0], np.zeros_like(view[1])]))
    is_body = (probability > 0.5).view(np.uint8)
    undecided = cv2.inRange(probability, float(SURELY_NOT), float(SURE))
    undecided = eroded(undecided, BLUR)
    undecided = dilated(undecided, BLUR) if undecided.any() else undecided
    contours, _ = cv2.findContours(is_body | undecided, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    least = parameters.min_body_px / region.scale**2
    parts = []
    for contour in contours:
        if cv2.contourArea(contour) + len(contour) < least:
            continue
        part = np.zeros_like(is_body)
        cv2.drawContours(part, [contour], 0, 1, cv2.FILLED)
        parts.append((cv2.countNonZero(part & is_body), part))
    parts.sort(key=lambda sized: -sized[0])
    areas = [area for area, _ in parts] + [0, 0]
    status = ViewStatus.OK
    if areas[0] < least:
        status = ViewStatus.EMPTY
    elif not is_known and areas[0] < SURE_ALONE_SHARE * image.size / region.scale**2:
        status = ViewStatus.NO_BACKGROUND
    elif areas[1] > max(least, parameters.second_body_share * areas[0]):
        status = ViewStatus.MULTIPLE
    return Answer(
        region=region,
        image=view[0],
        expected=view[1],
        probability=probability,
        undecided=undecided,
        body=parts[0][1] if parts else is_body,
        status=status,
    )


def eroded(mask: NDArray[np.generic], radius_px: int) -> Bits:
    """The mask (h, w) without a rim of this width."""
    return np.asarray(cv2.erode(np.asarray(mask, np.uint8), _disc(radius_px)), np.uint8)


def dilated(mask: Bits, radius_px: int) -> Bits:
    """The mask (h, w) with a rim of this width more."""
    return np.asarray(cv2.dilate(mask, _disc(radius_px)), np.uint8)


def _margin(region: Region) -> int:
    """A silhouette's margin, in the network's pixels."""
    return -(-(MARGIN_PX + EDGE_PX) // region.scale)


def _disc(radius_px: int) -> Bits:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1,) * 2), np.uint8)
