"""The wall beside a body and the rim of the body, in blocks of 4 px: how much they differ from the empty rig."""

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled, compiled_within
from pipeline.segmentation.background import COARSE
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]

BODY, COVERED, BARE, REST = np.uint8(1), np.uint8(2), np.uint8(4), np.uint8(8)
"""Bits of a block: the body, all that is not outside, and their complements."""
EVERY = np.uint8(BODY | COVERED | BARE | REST)
GROWTH = np.array([(1, EVERY), (1, BODY | COVERED | REST), (1, BODY | REST), (2, BODY), (3, BODY)], np.uint64)
"""Blocks by which bits grow, one step after the other: BARE 1, COVERED 2, REST 3 and BODY 8 in the end.

So the surroundings of a body begin 2 blocks beside it, further out than motion blurs it, and end after 8, within
the margin that a silhouette has. Its rim begins 1 block within, beyond the blur of the edge, and ends after 3,
no further than the body's grey level is carried."""
BORDER = 8
"""Blocks beside a row, so that nothing grows into the next one."""
LESS_NOISE = (3, 3)
"""Blocks over whose mean the image is compared: a third of the noise. At the border of the region it is its own mirror
image, but nothing beside the body is there."""


def errors_beside(
    labels: Grey, left: int, top: int, seen: Grey, empty: Grey, wall: Grey, least: int, gain: float
) -> tuple[Array, Array]:
    """Differences from the empty rig, as a share of it: of the wall around a body (N,), and of the body's rim (M,).

    Parameters
    ----------
    labels
        (h, w) of the silhouette, whose pixel (0, 0) is (left, top) of the image.
    seen
        (H/4, W/4) a pixel of each block of the image.
    empty
        (H/4, W/4) what it would show without the body, but for `gain`.
    wall
        (H/4, W/4) what the empty rig shows; blocks that are darker than `least` are left out.
    """
    row, column = -(-top // COARSE), -(-left // COARSE)
    height, width = (top + labels.shape[0]) // COARSE - row, (left + labels.shape[1]) // COARSE - column
    smooth = cv2.blur(seen[row : row + height, column : column + width], LESS_NOISE)
    bits = np.zeros((2, (height + 2 * BORDER) * (width + 2 * BORDER)), np.uint8)
    around, rim, errors = (np.empty(n, np.float32) for n in (height * width + 1, height * width + 1, width))
    n_around, n_rim = _write_errors(
        labels,
        COARSE * row + COARSE // 2 - top,
        COARSE * column + COARSE // 2 - left,
        np.asarray(smooth, np.uint8),
        empty,
        wall,
        row,
        column,
        np.uint8(least),
        np.float32(gain),
        bits[0],
        bits[1],
        around,
        rim,
        errors,
    )
    return around[:n_around], rim[:n_rim]


@compiled
def _write_errors(
    labels: Grey,
    v: int,
    u: int,
    seen: Grey,
    empty: Grey,
    wall: Grey,
    first_row: int,
    first_column: int,
    least: np.uint8,
    gain: np.float32,
    bits: Grey,
    wider: Grey,
    around: Array,
    rim: Array,
    errors: Array,
) -> tuple[int, int]:
    """The same, written one after the other, for blocks (h, w) that begin at `first_row` and `first_column`.

    The first block's label is at row `v` and column `u`; `bits` and `wider` are zeros, as many as blocks with a border,
    and `errors` (w,) is room for a row.
    """
    height, width = seen.shape
    line_length = width + 2 * BORDER
    for row in range(height):
        first = (row + BORDER) * line_length + BORDER
        here, of_blocks = bits[first : first + width], labels[v + COARSE * row, u:]
        for column in range(width):
            label = of_blocks[COARSE * column]
            here[column] = (BODY if label == INSIDE else REST) | (BARE if label == OUTSIDE else COVERED)
    for step in range(len(GROWTH)):
        _grow(bits, GROWTH[step, 0], np.uint8(GROWTH[step, 1]), wider)
        _grow(wider, GROWTH[step, 0] * np.uint64(line_length), np.uint8(GROWTH[step, 1]), bits)
    n_around = n_rim = 0
    for row in range(height):
        first = (row + BORDER) * line_length + BORDER
        here, seen_here = bits[first : first + width], seen[row]
        empty_here, wall_here = empty[first_row + row, first_column:], wall[first_row + row, first_column:]
        for column in range(width):
            expected = gain * np.float32(empty_here[column])
            errors[column] = abs(np.float32(seen_here[column]) / expected - np.float32(1))
        for column in range(width):  # each is written, but stays only where it belongs
            is_wall = wall_here[column] >= least
            around[n_around] = rim[n_rim] = errors[column]
            n_around += is_wall & (here[column] & (BODY | COVERED) == BODY)
            n_rim += is_wall & (here[column] & (REST | BARE) == REST)
    return n_around, n_rim


@compiled_within
def _grow(bits: Grey, step: np.uint64, growing: np.uint8, result: Grey) -> None:
    """Write bits (N,), the growing ones also where they are a step before or after."""
    # unsigned indices: numba asks of any other whether it is negative
    for i in range(np.uint64(len(bits)) - step - step):
        here = i + step
        result[here] = bits[here] | ((bits[i] | bits[here + step]) & growing)
