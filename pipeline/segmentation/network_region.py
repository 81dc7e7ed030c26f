"""The region of an image that a network sees, and the mapping between its pixels and the image's."""

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatImage, GreyImage
from pipeline.segmentation.background import COARSE

Value = TypeVar("Value", np.uint8, np.float32)
Box = tuple[int, int, int, int]
"""Left, top, width, height."""
CONTEXT = 8
"""Further pixels of the network on each side of a region: near its border a network sees less."""
ALIGNED = 4
"""Parts of a region are multiples of this many pixels: means over blocks are far quicker then."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A rectangle that may reach beyond the image, whose border pixels are repeated there."""

    left: int  # in image pixels
    top: int
    scale: int  # image pixels along a pixel of the network
    width: int  # in the network's pixels
    height: int

    def within(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """Return the rows and columns of an image (H, W) that are in the region."""
        bottom, right = self.top + self.scale * self.height, self.left + self.scale * self.width
        return (
            slice(max(self.top, 0), min(bottom, shape[0])),
            slice(max(self.left, 0), min(right, shape[1])),
        )

    def part(self, box: Box, margin: int) -> "tuple[Region, tuple[slice, slice]]":
        """Return the part around a box, and its rows and columns in arrays (height, width) of the region.

        Box and margin are in the network's pixels. The part is widened to multiples of `ALIGNED`, where the region
        itself is one.
        """
        x, y, width, height = box
        rows, columns = (
            slice(
                max(first - margin, 0) // ALIGNED * ALIGNED,
                min(-(-(first + length + margin) // ALIGNED) * ALIGNED, whole_length),
            )
            for first, length, whole_length in ((y, height, self.height), (x, width, self.width))
        )
        region = Region(
            left=self.left + self.scale * columns.start,
            top=self.top + self.scale * rows.start,
            scale=self.scale,
            width=columns.stop - columns.start,
            height=rows.stop - rows.start,
        )
        return region, (rows, columns)

    def reduce(self, image: GreyImage, factor: float, means: FloatImage) -> None:
        """Write the means (height, width) of an image (H, W) over the region's pixels, times a factor.

        Outside of the image its border is repeated.
        """
        cut = _replicated(image, self.left, self.top, self.scale * self.width, self.scale * self.height)
        size = (self.width, self.height)
        cv2.resize(cut.astype(np.float32), size, dst=means, interpolation=cv2.INTER_AREA)
        means *= np.float32(factor)

    def sample(self, coarse: FloatImage, factor: float, means: FloatImage) -> None:
        """Write the same as `reduce` for a smooth image, of which block means (H/4, W/4) are enough."""
        left, top, width, height = (
            size // COARSE
            for size in (self.left, self.top, self.scale * self.width, self.scale * self.height)
        )
        cut = _replicated(coarse, left, top, width, height)
        cv2.resize(cut, (self.width, self.height), dst=means, interpolation=cv2.INTER_LINEAR)
        means *= np.float32(factor)

    def enlarged(
        self, values: FloatImage, shape: tuple[int, ...], interpolation: int = cv2.INTER_LINEAR
    ) -> FloatImage:
        """Return values (height, width) interpolated for the pixels `within` an image (H, W)."""
        size = (self.scale * self.width, self.scale * self.height)
        fine = np.asarray(cv2.resize(values, size, interpolation=interpolation), values.dtype)
        rows, columns = self.within(shape)
        return fine[
            rows.start - self.top : rows.stop - self.top, columns.start - self.left : columns.stop - self.left
        ]

    def halved(self, mask: GreyImage, shape: tuple[int, ...]) -> GreyImage:
        """Return a mask (height, width) resampled to blocks of 2 x 2 of the pixels `within` an image (H, W)."""
        rows, columns = (
            slice((at.start - first) // 2, (at.stop - first + 1) // 2)
            for at, first in zip(self.within(shape), (self.top, self.left), strict=True)
        )
        size = (self.scale * self.width // 2, self.scale * self.height // 2)
        return np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8)[rows, columns]

    def at_centres(self, fine: GreyImage, shape: tuple[int, ...]) -> GreyImage:
        """Return, of pixels (h, w) `within` an image (H, W), those at the centres of the region's, else 0."""
        return self.sampled(fine, shape, self.scale // 2)

    def sampled(self, fine: NDArray[Value], shape: tuple[int, ...], offset: int) -> NDArray[Value]:
        """Return, for each of the region's pixels (height, width), the image pixel at an offset within it, else 0.

        `fine` (h, w) are the first pixels `within` an image (H, W).
        """
        result = np.zeros((self.height, self.width), fine.dtype)
        place, chosen = [], []
        for at, first, length in zip(self.within(shape), (self.top, self.left), fine.shape, strict=True):
            index = max(-(-(at.start - first - offset) // self.scale), 0)
            begin = first + offset + self.scale * index - at.start
            place.append(slice(index, index + len(range(begin, length, self.scale))))
            chosen.append(slice(begin, None, self.scale))
        result[tuple(place)] = fine[tuple(chosen)]
        return result


def _replicated(image: NDArray[Value], left: int, top: int, width: int, height: int) -> NDArray[Value]:
    """Return a rectangle (height, width) of an image (H, W), whose border is repeated where it reaches beyond."""
    cut = image[max(top, 0) : top + height, max(left, 0) : left + width]
    bottom, right = height - len(cut) - max(-top, 0), width - cut.shape[1] - max(-left, 0)
    if len(cut) == height and cut.shape[1] == width:
        return cut
    return np.asarray(
        cv2.copyMakeBorder(cut, max(-top, 0), bottom, max(-left, 0), right, cv2.BORDER_REPLICATE), image.dtype
    )


def region_around(box: Box, margin_px: int, shape: tuple[int, ...], largest: int, step: int) -> Region:
    """Return the finest region that holds a box and its margin, inside of the image (H, W) where possible.

    Width and height are multiples of `step`, at most `largest`. The region begins with a coarse block, so that the
    margin is up to half a block narrower.
    """
    x, y, width, height = box
    scale = -(-(max(width, height) + 2 * margin_px) // largest)
    columns, rows = (
        min(-(-((length + 2 * margin_px) // scale + 2 * CONTEXT) // step) * step, largest)
        for length in (width, height)
    )
    left, top = (
        # centred in an image too small for it
        (min(max(first, 0), size - side_px) if side_px <= size else (size - side_px) // 2) // COARSE * COARSE
        for first, side_px, size in (
            (x + width // 2 - scale * columns // 2 + COARSE // 2, scale * columns, shape[1]),
            (y + height // 2 - scale * rows // 2 + COARSE // 2, scale * rows, shape[0]),
        )
    )
    return Region(left=left, top=top, scale=scale, width=columns, height=rows)


def whole_image_region(shape: tuple[int, ...], largest: int, step: int) -> Region:
    """Return the region that holds an image of this shape (H, W)."""
    return region_around((0, 0, shape[1], shape[0]), 0, shape, largest, step)
