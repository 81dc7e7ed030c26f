"""What is behind a body, in the light of its image, pixel by pixel: computed only where it is asked for."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.light import EVEN, EVEN_SHARE
from pipeline.segmentation.region import Region

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
    empty: Bits  # (H, W) grey levels, or (h, w) of the part of the image that is in the region

    @property
    def corner(self) -> tuple[int, int]:
        """Row and column of `empty` at which the part of the image begins that is in the region."""
        rows, columns = self.region.within(self.shape)
        return (rows.start, columns.start) if self.empty.shape == self.shape else (0, 0)

    def even_light(self, wanted: Bits) -> float | None:
        """The light where it is wanted (height, width), if it is a factor there and no more."""
        light = self.light[wanted != 0]
        mean = float(light.mean()) if len(light) else 1.0
        n_uneven = np.count_nonzero(np.abs(light - np.float32(mean)) > EVEN * np.float32(mean))
        return mean if n_uneven <= EVEN_SHARE * len(light) else None

    def lit(self, wanted: Bits) -> Bits:
        """Grey levels (h, w) where they are wanted (height, width); 0 elsewhere."""
        rows, columns = self.region.within(self.shape)
        result = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.uint8)
        _lit(self.light, wanted, self.empty, *self._place(), result)
        return result

    def differs(self, image: Bits, wanted: Bits, least_share: float, least_grey: float) -> Bits:
        """1 where an image (h, w) is something else, of the pixels (height, width) of the region that are wanted.

        Means over such a pixel, or over `LEAST_SIDE_PX` if that is more, differ by a share and by so many levels.
        """
        found = np.zeros_like(wanted)
        least = np.float32(least_share), np.float32(least_grey)
        _differ(self.light, wanted, self.empty, *self._place(), image, least, found)
        return found

    def _place(self) -> tuple[tuple[int, int], tuple[int, int], int]:
        """`corner`, row and column of the region's first pixel in the part, and the region's scale."""
        rows, columns = self.region.within(self.shape)
        return (
            self.corner,
            (self.region.top - rows.start, self.region.left - columns.start),
            self.region.scale,
        )


@compiled
def _lit(
    light: Array,
    wanted: Bits,
    empty: Bits,
    corner: tuple[int, int],
    first: tuple[int, int],
    scale: int,
    result: Bits,
) -> None:
    height, width = result.shape
    factors = np.empty(scale * light.shape[1], np.float32)
    for y in range(light.shape[0]):
        top, bottom = max(first[0] + scale * y, 0), min(first[0] + scale * (y + 1), height)
        x = 0
        while x < light.shape[1]:
            if not wanted[y, x]:
                x += 1
                continue
            begin = x
            while x < light.shape[1] and wanted[y, x]:
                factors[scale * x : scale * (x + 1)] = light[y, x]
                x += 1
            left, right = max(first[1] + scale * begin, 0), min(first[1] + scale * x, width)
            lights = factors[left - first[1] : right - first[1]]
            for v in range(top, bottom):
                row, behind = (
                    result[v, left:right],
                    empty[corner[0] + v, corner[1] + left : corner[1] + right],
                )
                for i in range(len(row)):
                    row[i] = np.uint8(
                        min(np.float32(behind[i]) * lights[i] + np.float32(0.5), np.float32(255))
                    )


@compiled
def _differ(
    light: Array,
    wanted: Bits,
    empty: Bits,
    corner: tuple[int, int],
    first: tuple[int, int],
    scale: int,
    image: Bits,
    least: tuple[np.float32, np.float32],
    found: Bits,
) -> None:
    height, width = image.shape
    side = max(scale, LEAST_SIDE_PX)
    for y in range(light.shape[0]):
        top = first[0] + scale * y + (scale - side) // 2
        for x in range(light.shape[1]):
            left = first[1] + scale * x + (scale - side) // 2
            if not wanted[y, x] or min(top, left) < 0 or top + side > height or left + side > width:
                continue
            seen, without = 0, 0
            for v in range(top, top + side):
                for u in range(left, left + side):
                    seen += image[v, u]
                    without += empty[corner[0] + v, corner[1] + u]
            behind = np.float32(without) * light[y, x]
            found[y, x] = abs(behind - np.float32(seen)) > max(least[0] * behind, least[1] * side * side)
