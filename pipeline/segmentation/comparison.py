"""Pixels compared with the empty view: roughly over all of an image, and more closely around a body."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.background import COARSE

Grey = NDArray[np.uint8]
Mask = NDArray[np.bool_]

DIFFERS, DARK = np.uint8(1), np.uint8(2)
"""Marks of what is not the empty view, and of where no deviation tells anything."""
NOISE_GREY = np.float32(4)
"""A smaller deviation is no body, however dark the wall."""
FINE = 2
"""Around a body every so many-th pixel of every so many-th row is compared."""


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
    image: Grey, levels: Grey, background: Grey, left: int, top: int, thresholds: Thresholds
) -> tuple[Mask, Mask, Mask]:
    """Core, possible and unknown pixels (h / 2, w / 2) for `delineate`, of every second pixel of an image (h, w).

    The empty view's levels, and those before the light changed (H, W), may be of more than the image, which
    begins at `left` and `top` then.

    Two pixels behind the first trace of the body, lens and motion no longer mix the background in.
    """
    height, width = -(-image.shape[0] // FINE), -(-image.shape[1] // FINE)
    # with a border of what does not differ; loops over whole rows are vectorized
    marks = np.zeros((height + 4, width + 4), np.uint8)
    for row in range(height):
        seen, marks_here = image[FINE * row], marks[row + 2, 2:]
        levels_here, background_here = levels[top + FINE * row, left:], background[top + FINE * row, left:]
        for u in range(width):
            marks_here[u] = _mark(
                seen[FINE * u], levels_here[FINE * u], background_here[FINE * u], thresholds
            )
    core, possible = np.empty((height, width), np.bool_), np.empty((height, width), np.bool_)
    unknown = np.empty((height, width), np.bool_)
    for row in range(height):
        a, b, c, d, e = marks[row], marks[row + 1], marks[row + 2], marks[row + 3], marks[row + 4]
        for u in range(width):
            above = b[u] & b[u + 1] & b[u + 2] & b[u + 3] & b[u + 4]
            here = c[u] & c[u + 1] & c[u + 2] & c[u + 3] & c[u + 4]
            below = d[u] & d[u + 1] & d[u + 2] & d[u + 3] & d[u + 4]
            core[row, u] = a[u + 2] & above & here & below & e[u + 2] & DIFFERS
            possible[row, u] = (b[u + 2] | c[u + 1] | c[u + 2] | c[u + 3] | d[u + 2]) & DIFFERS
            is_dark = (
                b[u + 1]
                | b[u + 2]
                | b[u + 3]
                | c[u + 1]
                | c[u + 2]
                | c[u + 3]
                | d[u + 1]
                | d[u + 2]
                | d[u + 3]
            )
            unknown[row, u] = is_dark & DARK
    return core, possible, unknown
