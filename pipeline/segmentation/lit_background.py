"""What is behind a body, in the light of its image, pixel by pixel: computed only where it is asked for."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.segmentation.light import EVEN, EVEN_SHARE
from pipeline.segmentation.network_region import Region

Array = NDArray[np.float32]
Bits = NDArray[np.uint8]

LEAST_SIDE_PX = 3
"""Of the squares over whose mean an image is compared, against noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Behind:
    """The empty view of a region in a light that differs little from one of the region's pixels to the next."""

    region: Region
    shape: tuple[int, ...]  # (H, W) of the image
    light: Array  # (height, width) of the region: factors on
    empty: Bits  # (h, w) grey levels of the part of the image that is in the region

    def even_light(self, wanted: Bits) -> float | None:
        """The light where it is wanted (height, width), if it is a factor there and no more."""
        light = self.light[wanted != 0]
        mean = float(light.mean()) if len(light) else 1.0
        n_uneven = np.count_nonzero(np.abs(light - np.float32(mean)) > EVEN * np.float32(mean))
        return mean if n_uneven <= EVEN_SHARE * len(light) else None

    def lit(self, wanted: Bits) -> Bits:
        """Grey levels (h, w) where they are wanted (height, width); 0 elsewhere."""
        light = np.where(wanted != 0, self.light, np.float32(0))
        fine = self.region.enlarged(light, self.shape, cv2.INTER_NEAREST)
        return np.asarray(cv2.multiply(self.empty, fine, dtype=cv2.CV_8U), np.uint8)

    def differs(self, image: Bits, wanted: Bits, least_share: float, least_grey: float) -> Bits:
        """1 where an image (h, w) is something else, of the pixels (height, width) of the region that are wanted.

        Means over such a pixel, or over `LEAST_SIDE_PX` if that is more, differ by a share and by so many levels.
        """
        scale = self.region.scale
        side = max(scale, LEAST_SIDE_PX)
        seen, without = (
            self.region.sampled(_sums(each, side), self.shape, (scale - side) // 2)
            for each in (image, self.empty)
        )
        behind = without * self.light
        least = np.maximum(np.float32(least_share) * behind, np.float32(least_grey * side * side))
        return ((np.abs(behind - seen) > least) & (wanted != 0)).view(np.uint8)


def _sums(image: Bits, side: int) -> Array:
    """Sums over the squares that begin at each pixel of an image (h, w) and are within it."""
    height, width = (size - side + 1 for size in image.shape)
    sums = cv2.boxFilter(image, cv2.CV_32F, (side, side), anchor=(0, 0), normalize=False)
    return np.asarray(sums, np.float32)[: max(height, 0), : max(width, 0)]
