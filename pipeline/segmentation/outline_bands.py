"""Differences from the empty rig in two bands along a body's outline: wall outside, rim inside.

Everything is in blocks of 4 px.
"""

from typing import NamedTuple

import cv2
import numpy as np

from pipeline.arrays import FloatImage, GreyImage
from pipeline.compiled import compiled, compiled_within
from pipeline.segmentation.background import COARSE
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE

BODY, COVERED, BARE, REST = np.uint8(1), np.uint8(2), np.uint8(4), np.uint8(8)
"""Bits of a block: inside, not outside (unknown included), and their complements: outside, not inside."""
ALL_BITS = np.uint8(BODY | COVERED | BARE | REST)
GROWTH_STEPS = np.array(
    [(1, ALL_BITS), (1, BODY | COVERED | REST), (1, BODY | REST), (2, BODY), (3, BODY)], np.uint64
)
"""Steps of dilation, in blocks, and the bits they apply to: BARE 1, COVERED 2, REST 3 and BODY 8 in the end.

So the outer band begins 2 blocks beside the body, further out than motion blurs it, and ends after 8, within
the margin that a silhouette has. The inner band begins 1 block within, beyond the blur of the edge, and ends after 3,
no further than the body's grey level is extrapolated."""
BORDER_BLOCKS = 8
"""Blocks between rows, so that nothing grows into the next one."""
SMOOTHING_BLOCKS = (3, 3)
"""Blocks over whose mean the image is compared: a third of the noise. At the border of the region the image is
mirrored, but no band reaches there."""


class BandImages(NamedTuple):
    """Images that are compared, in blocks (H/4, W/4) of an image (H, W)."""

    seen: GreyImage  # one pixel of each block
    expected: GreyImage  # the same without the body, `gain` not applied
    gain: np.float32
    empty_rig: GreyImage  # the background
    min_wall_grey: np.uint8  # where the background is darker, it is not the plain wall


class BandShares(NamedTuple):
    """Shares of the blocks of plain wall in each band, 0 if there are none."""

    wall: float  # of the outer band: blocks that differ by more than allowed
    rim: float  # of the inner band: blocks without clear contrast


def band_shares(
    labels: GreyImage, corner_uv: tuple[int, int], images: BandImages, max_error: float, clear_contrast: float
) -> BandShares:
    """Return the share of the wall around a body that differs by more than `max_error`, and of its rim that is faint.

    `labels` (h, w) are the silhouette's, whose pixel (0, 0) is `corner_uv` of the image. `max_error` and
    `clear_contrast` are shares of the expected grey level.
    """
    left, top = corner_uv
    row, column = -(-top // COARSE), -(-left // COARSE)
    height, width = (top + labels.shape[0]) // COARSE - row, (left + labels.shape[1]) // COARSE - column
    smooth = cv2.blur(images.seen[row : row + height, column : column + width], SMOOTHING_BLOCKS)
    bits = np.zeros((2, (height + 2 * BORDER_BLOCKS) * (width + 2 * BORDER_BLOCKS)), np.uint8)
    n_wall, n_differing, n_rim, n_faint = _count(
        labels,
        COARSE * row + COARSE // 2 - top,
        COARSE * column + COARSE // 2 - left,
        np.asarray(smooth, np.uint8),
        images,
        row,
        column,
        (np.float32(max_error), np.float32(clear_contrast)),
        bits[0],
        bits[1],
        np.empty(width, np.float32),
    )
    return BandShares(n_differing / max(n_wall, 1), n_faint / max(n_rim, 1))


@compiled
def _count(
    labels: GreyImage,
    v: int,
    u: int,
    smooth: GreyImage,
    images: BandImages,
    first_row: int,
    first_column: int,
    thresholds: tuple[np.float32, np.float32],
    bits: GreyImage,
    other_bits: GreyImage,
    errors: FloatImage,
) -> tuple[int, int, int, int]:
    """Count blocks (h, w): those of the outer band, those of them that differ, those of the inner band, faint ones.

    The blocks begin at `first_row` and `first_column` of the image; the first one's label is at row `v` and column `u`
    of `labels`. `bits` and `other_bits` are zeros for all blocks with a border, and `errors` (w,) is room for a row.
    """
    height, width = smooth.shape
    line_length = width + 2 * BORDER_BLOCKS
    for row in range(height):
        first = (row + BORDER_BLOCKS) * line_length + BORDER_BLOCKS
        here, of_blocks = bits[first : first + width], labels[v + COARSE * row, u:]
        for column in range(width):
            label = of_blocks[COARSE * column]
            here[column] = (BODY if label == INSIDE else REST) | (BARE if label == OUTSIDE else COVERED)
    for step in range(len(GROWTH_STEPS)):
        _grow(bits, GROWTH_STEPS[step, 0], np.uint8(GROWTH_STEPS[step, 1]), other_bits)
        _grow(
            other_bits, GROWTH_STEPS[step, 0] * np.uint64(line_length), np.uint8(GROWTH_STEPS[step, 1]), bits
        )
    max_error, clear_contrast = thresholds
    n_wall = n_differing = n_rim = n_faint = 0
    for row in range(height):
        first = (row + BORDER_BLOCKS) * line_length + BORDER_BLOCKS
        here, seen = bits[first : first + width], smooth[row]
        levels, empty_rig = (
            images.expected[first_row + row, first_column:],
            images.empty_rig[first_row + row, first_column:],
        )
        for column in range(width):  # separate loops, so that each is vectorized
            expected = images.gain * np.float32(levels[column])
            errors[column] = abs(np.float32(seen[column]) / expected - np.float32(1))
        for column in range(width):
            is_plain = empty_rig[column] >= images.min_wall_grey
            is_wall = is_plain & (here[column] & (BODY | COVERED) == BODY)
            is_rim = is_plain & (here[column] & (REST | BARE) == REST)
            n_wall += is_wall
            n_rim += is_rim
            n_differing += is_wall & (errors[column] > max_error)
            n_faint += is_rim & (errors[column] <= clear_contrast)
    return n_wall, n_differing, n_rim, n_faint


@compiled_within
def _grow(bits: GreyImage, step: np.uint64, growing: np.uint8, result: GreyImage) -> None:
    """Write bits (N,) into `result`, the growing ones dilated by a step to either side."""
    # unsigned indices: numba asks of any other whether it is negative
    for i in range(np.uint64(len(bits)) - step - step):
        here = i + step
        result[here] = bits[here] | ((bits[i] | bits[here + step]) & growing)
