"""The background of a body in the light of its image, pixel by pixel: computed only where it is needed."""

from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.arrays import FloatImage, GreyImage
from pipeline.segmentation.light import EVEN, EVEN_SHARE
from pipeline.segmentation.network_region import Region

MIN_SIDE_PX = 3
"""Smallest edge of the squares over whose mean an image is compared: averaging suppresses noise."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitBackground:
    """The empty view of a region, and the light on it, which differs little between neighbouring region pixels."""

    region: Region
    shape: tuple[int, ...]  # (H, W) of the image
    light: FloatImage  # (height, width) of the region: factors on `levels`
    levels: GreyImage  # (h, w) empty view of the part of the image that is in the region

    def uniform_gain(self, needed: GreyImage) -> float | None:
        """Return the light where it is needed (height, width) if one factor describes it, else `None`."""
        light = self.light[needed != 0]
        mean = float(light.mean()) if len(light) else 1.0
        n_uneven = np.count_nonzero(np.abs(light - np.float32(mean)) > EVEN * np.float32(mean))
        return mean if n_uneven <= EVEN_SHARE * len(light) else None

    def lit_levels(self, needed: GreyImage) -> GreyImage:
        """Return the grey levels (h, w) in this light where they are needed (height, width), 0 elsewhere."""
        light = np.where(needed != 0, self.light, np.float32(0))
        fine = self.region.enlarged(light, self.shape, cv2.INTER_NEAREST)
        return np.asarray(cv2.multiply(self.levels, fine, dtype=cv2.CV_8U), np.uint8)

    def differing(self, image: GreyImage, needed: GreyImage, min_share: float, min_grey: float) -> GreyImage:
        """Return 1 for those of the needed region pixels (height, width) where an image (h, w) differs.

        The means over such a pixel, or over `MIN_SIDE_PX` if that is more, must differ both by `min_share` of the
        background and by `min_grey` levels.
        """
        scale = self.region.scale
        side = max(scale, MIN_SIDE_PX)
        seen, without = (
            self.region.sampled(_square_sums(levels, side), self.shape, (scale - side) // 2)
            for levels in (image, self.levels)
        )
        background = without * self.light
        least = np.maximum(np.float32(min_share) * background, np.float32(min_grey * side * side))
        return ((np.abs(background - seen) > least) & (needed != 0)).view(np.uint8)


def _square_sums(image: GreyImage, side: int) -> FloatImage:
    """Return the sums over the squares that begin at each pixel of an image (h, w) and lie within it."""
    height, width = (size - side + 1 for size in image.shape)
    sums = cv2.boxFilter(image, cv2.CV_32F, (side, side), anchor=(0, 0), normalize=False)
    return np.asarray(sums, np.float32)[: max(height, 0), : max(width, 0)]
