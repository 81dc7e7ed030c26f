"""The region of an image that a network sees, and the way between its pixels and the image's."""

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.background import COARSE

Array = NDArray[np.float32]
Bits = NDArray[np.uint8]
Pixels = TypeVar("Pixels", Array, Bits)
Box = tuple[int, int, int, int]
"""x, y, width, height."""
ALIGNED = 4
"""Parts of a region are multiples of so many pixels: means over blocks are far quicker then."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """A rectangle that may reach beyond the image, whose border goes on there."""

    left: int
    top: int
    scale: int  # image pixels along a pixel of the network
    width: int  # in the network's pixels
    height: int

    def within(self, shape: tuple[int, ...]) -> tuple[slice, slice]:
        """Rows and columns of an image (H, W) that are in the region."""
        bottom, right = self.top + self.scale * self.height, self.left + self.scale * self.width
        return (
            slice(max(self.top, 0), min(bottom, shape[0])),
            slice(max(self.left, 0), min(right, shape[1])),
        )

    def part(self, box: Box, margin: int) -> "tuple[Region, tuple[slice, slice]]":
        """The part around a box, both in the network's pixels, and where in arrays (height, width) it is.

        It is widened to multiples of `ALIGNED`, where the region itself is one.
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

    def reduced(self, image: Pixels) -> Array:
        """Means (height, width) of an image (H, W)."""
        cut = _replicated(image, self.left, self.top, self.scale * self.width, self.scale * self.height)
        small = cv2.resize(cut, (self.width, self.height), interpolation=cv2.INTER_AREA)
        return np.asarray(small, np.float32)

    def sampled(self, coarse: Array) -> Array:
        """The same (height, width) of a smooth image, of which block means (H/4, W/4) are enough."""
        left, top, width, height = (
            size // COARSE
            for size in (self.left, self.top, self.scale * self.width, self.scale * self.height)
        )
        cut = _replicated(coarse, left, top, width, height)
        return np.asarray(cv2.resize(cut, (self.width, self.height), interpolation=cv2.INTER_LINEAR))

    def enlarged(self, values: Array, shape: tuple[int, ...]) -> Array:
        """Values (height, width) interpolated for the pixels `within` an image (H, W)."""
        size = (self.scale * self.width, self.scale * self.height)
        fine = np.asarray(cv2.resize(values, size, interpolation=cv2.INTER_LINEAR), values.dtype)
        rows, columns = self.within(shape)
        return fine[
            rows.start - self.top : rows.stop - self.top, columns.start - self.left : columns.stop - self.left
        ]

    def lit(self, light: Array, wanted: Bits, empty: Array) -> Array:
        """An image (H, W) in this light (height, width), for the pixels `within` it that are wanted (height, width).

        The others are 0: what is asked for beside an edge need not be computed everywhere.
        """
        rows, columns = self.within(empty.shape)
        result = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.float32)
        _light(light, wanted, empty, self.scale, self.top, self.left, rows.start, columns.start, result)
        return result

    def halved(self, mask: Bits, shape: tuple[int, ...]) -> Bits:
        """A mask (height, width) for every second row and column of the pixels `within` an image (H, W)."""
        rows, columns = self.within(shape)
        of_rows = np.arange(rows.start - self.top, rows.stop - self.top, 2) // self.scale
        of_columns = np.arange(columns.start - self.left, columns.stop - self.left, 2) // self.scale
        return mask.take(of_rows, axis=0).take(of_columns, axis=1)


@compiled
def _light(
    light: Array,
    wanted: Bits,
    empty: Array,
    scale: int,
    top: int,
    left: int,
    first_row: int,
    first_column: int,
    result: Array,
) -> None:
    """Light differs too little from one pixel of the network to the next for interpolation to matter."""
    height, width = result.shape
    for y in range(light.shape[0]):
        last_v = min(top + (y + 1) * scale - first_row, height)
        for x in range(light.shape[1]):
            if not wanted[y, x]:
                continue
            last_u = min(left + (x + 1) * scale - first_column, width)
            for v in range(max(top + y * scale - first_row, 0), last_v):
                for u in range(max(left + x * scale - first_column, 0), last_u):
                    result[v, u] = empty[first_row + v, first_column + u] * light[y, x]


def _replicated(image: Pixels, left: int, top: int, width: int, height: int) -> Pixels:
    """A rectangle (height, width) of an image (H, W), whose border goes on where it reaches beyond."""
    cut = image[max(top, 0) : top + height, max(left, 0) : left + width]
    bottom, right = height - len(cut) - max(-top, 0), width - cut.shape[1] - max(-left, 0)
    if len(cut) == height and cut.shape[1] == width:
        return cut
    return np.asarray(
        cv2.copyMakeBorder(cut, max(-top, 0), bottom, max(-left, 0), right, cv2.BORDER_REPLICATE), image.dtype
    )


def square_around(box: Box, margin_px: int, shape: tuple[int, ...], size: int) -> Region:
    """The finest square of `size` that holds a box and its margin, inside of the image (H, W) if it can be.

    It begins with a coarse block, so that the margin is up to half of one narrower.
    """
    x, y, width, height = box
    scale = -(-(max(width, height) + 2 * margin_px) // size)
    side_px = scale * size
    left, top = (
        # in an image too small for it, in the middle
        (min(max(first, 0), room - side_px) if side_px <= room else (room - side_px) // 2) // COARSE * COARSE
        for first, room in (
            (x + width // 2 - side_px // 2 + COARSE // 2, shape[1]),
            (y + height // 2 - side_px // 2 + COARSE // 2, shape[0]),
        )
    )
    return Region(left=left, top=top, scale=scale, width=size, height=size)


def whole(shape: tuple[int, ...], size: int) -> Region:
    """The square that holds an image of this shape (H, W)."""
    return square_around((0, 0, shape[1], shape[0]), 0, shape, size)
