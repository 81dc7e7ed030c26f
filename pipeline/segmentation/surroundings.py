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
GROWTH = ((1, EVERY), (1, BODY | COVERED | REST), (1, BODY | REST), (2, BODY), (3, BODY))
"""Blocks by which bits grow, one step after the other: BARE 1, COVERED 2, REST 3 and BODY 8 in the end.

So the surroundings of a body begin 2 blocks beside it, further out than motion blurs it, and end after 8, within
the margin that a silhouette has. Its rim begins 1 block within, beyond the blur of the edge, and ends after 3,
no further than the body's grey level is carried."""
BORDER = 3
"""Blocks around an array that the widest step reads."""


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
        (H/4, W/4) one pixel of each block of the image.
    empty
        (H/4, W/4) what it would show without the body, but for `gain`.
    wall
        (H/4, W/4) what the empty rig shows; blocks that are darker than `least` are left out.
    """
    first_row, first_column = -(-top // COARSE), -(-left // COARSE)
    height = (top + labels.shape[0]) // COARSE - first_row
    width = (left + labels.shape[1]) // COARSE - first_column
    around, beside = np.empty(height * width, np.float32), np.empty(height * width, np.float32)
    n_around = n_beside = 0
    bits = _grown(
        labels[COARSE * first_row + COARSE // 2 - top :, COARSE * first_column + COARSE // 2 - left :],
        height,
        width,
    )
    last_row, last_column = seen.shape[0] - 1, seen.shape[1] - 1
    for row in range(height):
        v = first_row + row
        a, b, c = seen[max(v - 1, 0)], seen[v], seen[min(v + 1, last_row)]
        for column in range(width):
            here = bits[row, column]
            is_around, is_rim = here & (BODY | COVERED) == BODY, here & (REST | BARE) == REST
            u = first_column + column
            if wall[v, u] < least or not (is_around or is_rim):
                continue
            before, after = max(u - 1, 0), min(u + 1, last_column)
            # the mean of nine has a third of the noise
            total = np.float32(
                a[before] + a[u] + a[after] + b[before] + b[u] + b[after] + c[before] + c[u] + c[after]
            )
            error = abs(total / (np.float32(9) * gain * np.float32(empty[v, u])) - np.float32(1))
            if is_around:
                around[n_around] = error
                n_around += 1
            else:
                beside[n_beside] = error
                n_beside += 1
    return around[:n_around], beside[:n_beside]


@compiled
def _grown(labels: Grey, height: int, width: int) -> Grey:
    """The bits (height, width) of blocks whose first pixels are labelled (h, w), grown by squares."""
    bits = np.zeros((height + 2 * BORDER, width + 2 * BORDER), np.uint8)
    wider = np.zeros_like(bits)
    for row in range(height):
        line, here = labels[COARSE * row], bits[BORDER + row, BORDER:]
        for column in range(width):
            label = line[COARSE * column]
            here[column] = (BODY if label == INSIDE else REST) | (BARE if label == OUTSIDE else COVERED)
    for blocks, growing in GROWTH:
        for row in range(BORDER, BORDER + height):
            before, line, after = (
                bits[row, BORDER - blocks :],
                bits[row, BORDER:],
                bits[row, BORDER + blocks :],
            )
            here = wider[row, BORDER:]
            for column in range(width):
                here[column] = line[column] | ((before[column] | after[column]) & growing)
        for row in range(BORDER, BORDER + height):
            before, line, after = wider[row - blocks], wider[row], wider[row + blocks]
            here = bits[row]
            for column in range(BORDER, BORDER + width):
                here[column] = line[column] | ((before[column] | after[column]) & growing)
    return bits[BORDER:-BORDER, BORDER:-BORDER]
