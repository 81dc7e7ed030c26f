"""The wall beside a body and the rim of the body, in blocks of 4 px: how much they differ from the empty rig."""

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.background import COARSE
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]

BODY, COVERED, BARE, REST = np.uint8(1), np.uint8(2), np.uint8(4), np.uint8(8)
"""Bits of a block: the body, all that is not outside, and their complements."""
EVERY = np.uint8(BODY | COVERED | BARE | REST)
GROWTH = np.array([(1, EVERY), (1, BODY | COVERED | REST), (1, BODY | REST), (2, BODY), (3, BODY)])
"""Blocks by which bits grow, one step after the other: BARE 1, COVERED 2, REST 3 and BODY 8 in the end.

So the surroundings of a body begin 2 blocks beside it, further out than motion blurs it, and end after 8, within
the margin that a silhouette has. Its rim begins 1 block within, beyond the blur of the edge, and ends after 3,
no further than the body's grey level is carried."""
BORDER = 8
"""Blocks beside a row, so that nothing grows into the next one."""


@compiled
def errors_beside(
    labels: Grey, left: int, top: int, seen: Grey, empty: Grey, wall: Grey, least: np.uint8, gain: np.float32
) -> tuple[Array, Array]:
    """Differences from the empty rig, as a share of it: of the wall around a body (N,), and of the body's rim (M,).

    Parameters
    ----------
    labels
        (h, w) of the silhouette, whose pixel (0, 0) is (left, top) of the image.
    seen
        (H/4, W/4) grey levels of the image, of which there may be less noise.
    empty
        (H/4, W/4) what it would show without the body, but for `gain`.
    wall
        (H/4, W/4) what the empty rig shows; blocks that are darker than `least` are left out.
    """
    first_row, first_column = -(-top // COARSE), -(-left // COARSE)
    height = (top + labels.shape[0]) // COARSE - first_row
    width = (left + labels.shape[1]) // COARSE - first_column
    bits = _grown(
        labels[COARSE * first_row + COARSE // 2 - top :, COARSE * first_column + COARSE // 2 - left :],
        height,
        width,
    )
    around, beside = np.empty(height * width + 1, np.float32), np.empty(height * width + 1, np.float32)
    n_around = n_beside = 0
    errors = np.empty(width, np.float32)
    for row in range(height):
        v, here = first_row + row, bits[row]
        seen_here, empty_here, wall_here = (
            seen[v, first_column:],
            empty[v, first_column:],
            wall[v, first_column:],
        )
        for column in range(width):
            expected = gain * np.float32(empty_here[column])
            errors[column] = abs(np.float32(seen_here[column]) / expected - np.float32(1))
        for column in range(width):  # each is written, but stays only where it belongs
            is_wall = wall_here[column] >= least
            around[n_around] = beside[n_beside] = errors[column]
            n_around += is_wall & (here[column] & (BODY | COVERED) == BODY)
            n_beside += is_wall & (here[column] & (REST | BARE) == REST)
    return around[:n_around], beside[:n_beside]


@compiled
def _grown(labels: Grey, height: int, width: int) -> Grey:
    """The bits (height, width) of blocks whose first pixels are labelled (h, w), grown by squares."""
    line_length = width + 2 * BORDER
    bits = np.zeros((height + 2 * BORDER, line_length), np.uint8)
    for row in range(height):
        line, here = labels[COARSE * row], bits[BORDER + row, BORDER:]
        for column in range(width):
            label = line[COARSE * column]
            here[column] = (BODY if label == INSIDE else REST) | (BARE if label == OUTSIDE else COVERED)
    flat, wider = bits.ravel(), np.zeros(bits.size, np.uint8)
    for step in range(len(GROWTH)):
        blocks, growing = GROWTH[step, 0], np.uint8(GROWTH[step, 1])
        _grow(flat, blocks, growing, wider)
        _grow(wider, blocks * line_length, growing, flat)
    return bits[BORDER:-BORDER, BORDER:-BORDER]


@compiled
def _grow(bits: Grey, step: int, growing: np.uint8, result: Grey) -> None:
    """Write bits (N,), the growing ones also where they are a step before or after."""
    before, here, after, grown = bits, bits[step:], bits[2 * step :], result[step:]
    for i in range(len(after)):
        grown[i] = here[i] | ((before[i] | after[i]) & growing)
