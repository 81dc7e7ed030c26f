"""The wall beside a body and the rim of the body, in blocks of 4 px: how much they differ from the empty rig."""

from typing import NamedTuple

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


class Views(NamedTuple):
    """Of the image (H, W), in blocks (H/4, W/4)."""

    seen: Grey  # a pixel of each
    empty: Grey  # what it would show without the body, but for
    gain: np.float32
    clean: Grey  # what the empty rig shows
    least: np.uint8  # where that is darker, it is not the plain wall


class Shares(NamedTuple):
    """Of blocks that differ from the empty rig by more than a share of it; 0 of none."""

    wall: float  # of the wall around a body
    rim: float  # of the rim of the body: there those that do not differ by more


def shares_beside(
    labels: Grey, corner_uv: tuple[int, int], views: Views, max_error: float, clear_contrast: float
) -> Shares:
    """How much of the wall around a body differs, by more than `max_error`, and how much of its rim is not clear.

    `labels` (h, w) are the silhouette's, whose pixel (0, 0) is `corner_uv` of the image.
    """
    left, top = corner_uv
    row, column = -(-top // COARSE), -(-left // COARSE)
    height, width = (top + labels.shape[0]) // COARSE - row, (left + labels.shape[1]) // COARSE - column
    smooth = cv2.blur(views.seen[row : row + height, column : column + width], LESS_NOISE)
    bits = np.zeros((2, (height + 2 * BORDER) * (width + 2 * BORDER)), np.uint8)
    n_wall, n_differing, n_rim, n_faint = _count(
        labels,
        COARSE * row + COARSE // 2 - top,
        COARSE * column + COARSE // 2 - left,
        np.asarray(smooth, np.uint8),
        views,
        row,
        column,
        (np.float32(max_error), np.float32(clear_contrast)),
        bits[0],
        bits[1],
        np.empty(width, np.float32),
    )
    return Shares(n_differing / max(n_wall, 1), n_faint / max(n_rim, 1))


@compiled
def _count(
    labels: Grey,
    v: int,
    u: int,
    smooth: Grey,
    views: Views,
    first_row: int,
    first_column: int,
    limits: tuple[np.float32, np.float32],
    bits: Grey,
    wider: Grey,
    errors: Array,
) -> tuple[int, int, int, int]:
    """Blocks of wall around, those that differ, blocks of the rim, those that do not, of blocks (h, w).

    They begin at `first_row` and `first_column`; the first one's label is at row `v` and column `u`. `bits` and `wider`
    are zeros, as many as blocks with a border, and `errors` (w,) is room for a row.
    """
    height, width = smooth.shape
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
    max_error, clear_contrast = limits
    n_wall = n_differing = n_rim = n_faint = 0
    for row in range(height):
        first = (row + BORDER) * line_length + BORDER
        here, seen = bits[first : first + width], smooth[row]
        empty, clean = (
            views.empty[first_row + row, first_column:],
            views.clean[first_row + row, first_column:],
        )
        for column in range(width):  # one after the other, that each is vectorized
            expected = views.gain * np.float32(empty[column])
            errors[column] = abs(np.float32(seen[column]) / expected - np.float32(1))
        for column in range(width):
            is_plain = clean[column] >= views.least
            is_wall = is_plain & (here[column] & (BODY | COVERED) == BODY)
            is_rim = is_plain & (here[column] & (REST | BARE) == REST)
            n_wall += is_wall
            n_rim += is_rim
            n_differing += is_wall & (errors[column] > max_error)
            n_faint += is_rim & (errors[column] <= clear_contrast)
    return n_wall, n_differing, n_rim, n_faint


@compiled_within
def _grow(bits: Grey, step: np.uint64, growing: np.uint8, result: Grey) -> None:
    """Write bits (N,), the growing ones also where they are a step before or after."""
    # unsigned indices: numba asks of any other whether it is negative
    for i in range(np.uint64(len(bits)) - step - step):
        here = i + step
        result[here] = bits[here] | ((bits[i] | bits[here + step]) & growing)
