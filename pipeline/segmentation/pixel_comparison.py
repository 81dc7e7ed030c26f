"""Pixels compared with the empty view: roughly over all of an image, and more closely around a body."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled, compiled_within
from pipeline.segmentation.background import COARSE
from pipeline.segmentation.light import EVEN, LIT, UNLIKE
from pipeline.segmentation.local_threshold import FINE, OPEN
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

DIFFERS, DARK = np.uint8(1), np.uint8(2)
"""Marks of what is not the empty view, and of where no deviation tells anything."""
NOISE_GREY = np.float32(4)
"""A smaller deviation is no body, however dark the wall."""
BORDER = 2
"""So far around a pixel its neighbours are looked at."""


class Thresholds(NamedTuple):
    """What is a deviation from the empty view's grey levels."""

    gain: np.float32  # factor on them: the strength of the flash
    min_contrast: np.float32  # least deviation of a body, as a share of the grey level
    dark: np.uint8  # where they are less, no deviation tells anything


@compiled
def sampled(image: Grey) -> Grey:
    """A pixel (H/4, W/4) from the middle of each block."""
    seen = np.empty((len(image) // COARSE, image.shape[1] // COARSE), np.uint8)
    for row in range(len(seen)):
        for u in range(seen.shape[1]):
            seen[row, u] = image[COARSE * row + COARSE // 2, COARSE * u + COARSE // 2]
    return seen


@compiled
def compare(
    seen: Grey,
    levels: Grey,
    darkest: Grey,
    wall: Array,
    is_plain: Mask,
    thresholds: Thresholds,
    marks: Grey,
    light: Array,
) -> tuple[int, int, int, int, int]:
    """Compare what was `sampled` (H/4, W/4): the box of what differs, and how many blocks of light are uneven.

    The box is empty if nothing differs, else left, top, right and bottom, the first ones beyond it.

    Parameters
    ----------
    levels
        (H/4, W/4) grey level without a body, but for the gain.
    darkest
        (H/4, W/4) the empty view's least level of each block and its neighbours, which the lens mixes.
    wall, is_plain
        (H/16, W/16) grey levels of the empty view, and where the light is read off.
    marks
        (H/4, W/4) for DIFFERS from the empty view, DARK, or neither.
    light
        (H/16, W/16) for the brightness relative to the wall's.
    """
    height, width = seen.shape
    n_lit = min(light.shape[1], width // LIT)
    sums, differ = np.empty(width, np.uint16), np.zeros(width, np.uint8)
    top, bottom, n_uneven = height, 0, 0
    for row in range(height):  # loops one after the other, that each is vectorized
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
    for y in range(min(len(light), height // LIT)):
        row = LIT * y
        for u in range(LIT * n_lit):
            sums[u] = seen[row, u] + seen[row + 1, u] + seen[row + 2, u] + seen[row + 3, u]
        for x in range(n_lit):
            total = sums[LIT * x] + sums[LIT * x + 1] + sums[LIT * x + 2] + sums[LIT * x + 3]
            relative = np.float32(total) / (LIT**2 * max(thresholds.gain * wall[y, x], np.float32(1)))
            error = abs(relative - np.float32(1))
            n_uneven += is_plain[y, x] & (error > EVEN) & (error < UNLIKE)
            light[y, x] = relative
    left, right = width, 0
    for u in range(width):
        if differ[u] & DIFFERS:
            left, right = min(left, u), u + 1
    return left, top, right, bottom, n_uneven


@compiled_within
def _mark(seen: np.uint8, level: np.uint8, darkest: np.uint8, thresholds: Thresholds) -> np.uint8:
    behind = thresholds.gain * np.float32(level)
    differs = abs(np.float32(seen) - behind) > thresholds.min_contrast * behind + NOISE_GREY
    return DARK if darkest < thresholds.dark else np.uint8(differs)


@compiled
def limits_around(image: Grey, expected: Grey, darkest: Grey, thresholds: Thresholds) -> Grey:
    """What is known of a region: INSIDE, UNKNOWN, OUTSIDE or OPEN, for cells (h / 2, w / 2) of it, rounded up.

    One pixel of each is compared. Two cells behind the first trace of the body, lens and motion no longer mix
    the background in.

    Parameters
    ----------
    image, expected, darkest
        (h, w) grey levels: seen, without a body but for the gain, and of the empty rig.
    """
    height, width = -(-image.shape[0] // FINE), -(-image.shape[1] // FINE)
    # with a border of what does not differ
    marks = np.zeros((height + 2 * BORDER, width + 2 * BORDER), np.uint8)
    for row in range(height):  # loops over whole rows are vectorized
        seen, behind, empty, here = (
            image[FINE * row],
            expected[FINE * row],
            darkest[FINE * row],
            marks[BORDER + row],
        )
        for u in range(width):
            here[BORDER + u] = _mark(seen[FINE * u], behind[FINE * u], empty[FINE * u], thresholds)
    fives, threes = np.empty_like(marks), np.empty_like(marks)
    for row in range(len(marks)):
        mark, five, three = marks[row], fives[row], threes[row]
        for u in range(width):
            five[u] = mark[u] & mark[u + 1] & mark[u + 2] & mark[u + 3] & mark[u + 4]
            three[u] = mark[u + 1] | mark[u + 2] | mark[u + 3]
    limits = np.empty((height, width), np.uint8)
    for row in range(height):
        a, b, d, e = marks[row], marks[row + 1], marks[row + 3], marks[row + 4]
        five_b, five_c, five_d = fives[row + 1], fives[row + 2], fives[row + 3]
        three_b, three_c, three_d = threes[row + 1], threes[row + 2], threes[row + 3]
        here = limits[row]
        for u in range(width):
            is_core = a[u + 2] & five_b[u] & five_c[u] & five_d[u] & e[u + 2] & DIFFERS
            is_possible = (b[u + 2] | three_c[u] | d[u + 2]) & DIFFERS
            is_dark = (three_b[u] | three_c[u] | three_d[u]) & DARK
            here[u] = INSIDE if is_core else (UNKNOWN if is_dark else (OPEN if is_possible else OUTSIDE))
    return limits
