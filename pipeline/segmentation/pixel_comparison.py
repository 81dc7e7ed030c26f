"""Pixels compared with the empty view: coarsely over the whole image, and more closely around a body."""

from typing import NamedTuple

import numpy as np

from pipeline.arrays import FloatImage, GreyImage, Mask
from pipeline.compiled import compiled, compiled_within
from pipeline.segmentation.background import COARSE
from pipeline.segmentation.light import EVEN, LIGHT_BLOCK, MAX_WALL_DEVIATION
from pipeline.segmentation.local_threshold import CELL_PX, OPEN
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

DIFFERS, DARK = np.uint8(1), np.uint8(2)
"""Marks of what is not the empty view, and of where it is too dark to tell."""
NOISE_GREY = np.float32(4)
"""A smaller deviation is no body, however dark the wall."""
BORDER_CELLS = 2
"""Radius, in cells, of the neighbourhood that decides about a cell."""


class Thresholds(NamedTuple):
    """Limits beyond which grey levels deviate from the empty view."""

    gain: np.float32  # factor on them: the strength of the flash
    min_contrast: np.float32  # least deviation of a body, as a share of the grey level
    dark: np.uint8  # levels below this are too dark to tell


@compiled
def sampled(image: GreyImage) -> GreyImage:
    """Return one pixel (H/4, W/4) from the middle of each block of an image (H, W)."""
    seen = np.empty((len(image) // COARSE, image.shape[1] // COARSE), np.uint8)
    for row in range(len(seen)):
        for u in range(seen.shape[1]):
            seen[row, u] = image[COARSE * row + COARSE // 2, COARSE * u + COARSE // 2]
    return seen


@compiled
def compare(
    seen: GreyImage,
    levels: GreyImage,
    darkest: GreyImage,
    wall: FloatImage,
    is_plain: Mask,
    thresholds: Thresholds,
    marks: GreyImage,
    light: FloatImage,
) -> tuple[int, int, int, int, int]:
    """Compare what was `sampled` (H/4, W/4); fill `marks` and `light`.

    Parameters
    ----------
    levels
        (H/4, W/4) grey level without a body, gain not applied.
    darkest
        (H/4, W/4) the empty view's least level of each block and its neighbours, which the lens mixes.
    wall, is_plain
        (H/16, W/16) grey levels of the empty view, and where the light is read off.
    marks
        (H/4, W/4), filled: DIFFERS from the empty view, DARK, or neither.
    light
        (H/16, W/16), filled: brightness relative to the wall's.

    Returns
    -------
    left, top, right, bottom, n_uneven
        Box of what differs, right and bottom exclusive, empty if nothing does; number of blocks of uneven light.
    """
    height, width = seen.shape
    n_lit = min(light.shape[1], width // LIGHT_BLOCK)
    sums, differ = np.empty(width, np.uint16), np.zeros(width, np.uint8)
    top, bottom, n_uneven = height, 0, 0
    for row in range(height):  # separate loops, so that each is vectorized
        for u in range(width):
            marks[row, u] = _mark(seen[row, u], levels[row, u], darkest[row, u], thresholds)
    for row in range(height):
        found = np.uint8(0)
        for u in range(width):
            found |= marks[row, u]
        if found & DIFFERS:
            top, bottom = min(top, row), row + 1
            for u in range(width):
                differ[u] |= marks[row, u]
    for y in range(min(len(light), height // LIGHT_BLOCK)):
        row = LIGHT_BLOCK * y
        for u in range(LIGHT_BLOCK * n_lit):
            sums[u] = seen[row, u] + seen[row + 1, u] + seen[row + 2, u] + seen[row + 3, u]
        for x in range(n_lit):
            total = (
                sums[LIGHT_BLOCK * x]
                + sums[LIGHT_BLOCK * x + 1]
                + sums[LIGHT_BLOCK * x + 2]
                + sums[LIGHT_BLOCK * x + 3]
            )
            relative = np.float32(total) / (LIGHT_BLOCK**2 * max(thresholds.gain * wall[y, x], np.float32(1)))
            error = abs(relative - np.float32(1))
            n_uneven += is_plain[y, x] & (error > EVEN) & (error < MAX_WALL_DEVIATION)
            light[y, x] = relative
    left, right = width, 0
    for u in range(width):
        if differ[u] & DIFFERS:
            left, right = min(left, u), u + 1
    return left, top, right, bottom, n_uneven


@compiled_within
def _mark(seen: np.uint8, level: np.uint8, darkest: np.uint8, thresholds: Thresholds) -> np.uint8:
    background = thresholds.gain * np.float32(level)
    differs = abs(np.float32(seen) - background) > thresholds.min_contrast * background + NOISE_GREY
    return DARK if darkest < thresholds.dark else np.uint8(differs)


@compiled
def background_trimap(
    image: GreyImage, expected: GreyImage, darkest: GreyImage, thresholds: Thresholds
) -> GreyImage:
    """Return the trimap of a region: INSIDE, UNKNOWN, OUTSIDE or OPEN for its cells (h / 2, w / 2), rounded up.

    One pixel of each cell is compared. Two cells within the first trace of the body, lens and motion no longer mix
    the background in: there its core begins.

    Parameters
    ----------
    image, expected, darkest
        (h, w) grey levels: seen, without a body (gain not applied), and of the empty rig.
    """
    height, width = -(-image.shape[0] // CELL_PX), -(-image.shape[1] // CELL_PX)
    # the border does not differ
    marks = np.zeros((height + 2 * BORDER_CELLS, width + 2 * BORDER_CELLS), np.uint8)
    for row in range(height):  # loops over whole rows: they are vectorized
        seen, background, empty, here = (
            image[CELL_PX * row],
            expected[CELL_PX * row],
            darkest[CELL_PX * row],
            marks[BORDER_CELLS + row],
        )
        for u in range(width):
            here[BORDER_CELLS + u] = _mark(
                seen[CELL_PX * u], background[CELL_PX * u], empty[CELL_PX * u], thresholds
            )
    fives, threes = np.empty_like(marks), np.empty_like(marks)
    for row in range(len(marks)):
        mark, five, three = marks[row], fives[row], threes[row]
        for u in range(width):
            five[u] = mark[u] & mark[u + 1] & mark[u + 2] & mark[u + 3] & mark[u + 4]
            three[u] = mark[u + 1] | mark[u + 2] | mark[u + 3]
    trimap = np.empty((height, width), np.uint8)
    for row in range(height):
        a, b, d, e = marks[row], marks[row + 1], marks[row + 3], marks[row + 4]
        five_b, five_c, five_d = fives[row + 1], fives[row + 2], fives[row + 3]
        three_b, three_c, three_d = threes[row + 1], threes[row + 2], threes[row + 3]
        here = trimap[row]
        for u in range(width):
            is_core = a[u + 2] & five_b[u] & five_c[u] & five_d[u] & e[u + 2] & DIFFERS
            is_possible = (b[u + 2] | three_c[u] | d[u + 2]) & DIFFERS
            is_dark = (three_b[u] | three_c[u] | three_d[u]) & DARK
            here[u] = INSIDE if is_core else (UNKNOWN if is_dark else (OPEN if is_possible else OUTSIDE))
    return trimap
