"""Pixels compared with the empty view: roughly over all of an image, and more closely around a body."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.background import COARSE
from pipeline.segmentation.grey_levels import FINE, OPEN
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

Grey = NDArray[np.uint8]

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
    samples = np.empty((image.shape[0] // COARSE, image.shape[1] // COARSE), np.uint8)
    for row in range(samples.shape[0]):
        line = image[COARSE * row + COARSE // 2, COARSE // 2 :]
        for column in range(samples.shape[1]):
            samples[row, column] = line[COARSE * column]
    return samples


@compiled
def marked(seen: Grey, levels: Grey, darkest: Grey, thresholds: Thresholds) -> Grey:
    """What is seen (h, w): DIFFERS from the empty view, DARK, or neither.

    `darkest` is the empty view's least level of each pixel and its neighbours, which the lens mixes.
    """
    marks = np.empty(seen.shape, np.uint8)
    for row in range(seen.shape[0]):
        for column in range(seen.shape[1]):
            marks[row, column] = _mark(
                seen[row, column], levels[row, column], darkest[row, column], thresholds
            )
    return marks


@compiled
def _mark(seen: np.uint8, level: np.uint8, darkest: np.uint8, thresholds: Thresholds) -> np.uint8:
    behind = thresholds.gain * np.float32(level)
    differs = abs(np.float32(seen) - behind) > thresholds.min_contrast * behind + NOISE_GREY
    return DARK if darkest < thresholds.dark else np.uint8(differs)


@compiled
def limits_around(
    image: Grey,
    clean: Grey,
    corner: tuple[int, int],
    levels: Grey,
    levels_corner: tuple[int, int],
    shape: tuple[int, int],
    thresholds: Thresholds,
) -> Grey:
    """What is known of a region (h, w) of an image: INSIDE, UNKNOWN, OUTSIDE or OPEN, for blocks (h / 2, w / 2) of it.

    One pixel of each is compared. Two blocks behind the first trace of the body, lens and motion no longer mix
    the background in.

    Parameters
    ----------
    image, clean
        (H, W) grey levels: seen, and of the empty rig.
    corner
        Column and row of both at which the region begins.
    levels
        What the image would show without a body, but for the gain.
    levels_corner
        Column and row of that at which the region begins.
    """
    marks = _marks(image, clean, corner, levels, levels_corner, shape, thresholds)
    height, width = marks.shape[0] - 2 * BORDER, marks.shape[1] - 2 * BORDER
    fives, threes = np.empty((len(marks), width), np.uint8), np.empty((len(marks), width), np.uint8)
    for row in range(len(marks)):
        mark, five, three = marks[row], fives[row], threes[row]
        for u in range(width):
            five[u] = mark[u] & mark[u + 1] & mark[u + 2] & mark[u + 3] & mark[u + 4]
            three[u] = mark[u + 1] | mark[u + 2] | mark[u + 3]
    limits = np.empty((height, width), np.uint8)
    for row in range(height):
        a, b, d, e = marks[row, 2:], marks[row + 1, 2:], marks[row + 3, 2:], marks[row + 4, 2:]
        five_b, five_c, five_d = fives[row + 1], fives[row + 2], fives[row + 3]
        three_b, three_c, three_d = threes[row + 1], threes[row + 2], threes[row + 3]
        here = limits[row]
        for u in range(width):
            is_core = a[u] & five_b[u] & five_c[u] & five_d[u] & e[u] & DIFFERS
            is_possible = (b[u] | three_c[u] | d[u]) & DIFFERS
            is_dark = (three_b[u] | three_c[u] | three_d[u]) & DARK
            here[u] = INSIDE if is_core else (UNKNOWN if is_dark else (OPEN if is_possible else OUTSIDE))
    return limits


@compiled
def _marks(
    image: Grey,
    clean: Grey,
    corner: tuple[int, int],
    levels: Grey,
    levels_corner: tuple[int, int],
    shape: tuple[int, int],
    thresholds: Thresholds,
) -> Grey:
    """Marks of every second pixel of every second row of a region, with a border of what does not differ."""
    height, width = -(-shape[0] // FINE), -(-shape[1] // FINE)
    marks = np.zeros((height + 2 * BORDER, width + 2 * BORDER), np.uint8)
    (left, top), (levels_left, levels_top) = corner, levels_corner
    for row in range(height):  # loops over whole rows are vectorized
        seen, empty = image[top + FINE * row, left:], clean[top + FINE * row, left:]
        behind, here = levels[levels_top + FINE * row, levels_left:], marks[BORDER + row, BORDER:]
        for u in range(width):
            here[u] = _mark(seen[FINE * u], behind[FINE * u], empty[FINE * u], thresholds)
    return marks
