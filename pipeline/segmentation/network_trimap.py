"""Where beside a body that a network found its edge is looked for, and where grey levels would mislead.

The network is sure of most pixels, one way or the other. Between, `delineate` decides by grey levels; pixels
where these have too little contrast, or contradict the network, are unknown.
"""

from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.segmentation.lit_background import LEAST_SIDE_PX, Behind

Array = NDArray[np.float32]
Bits = NDArray[np.uint8]

CORE, POSSIBLE, UNKNOWN = np.uint8(1), np.uint8(2), np.uint8(4)
"""Bits of a pixel's limits; the arguments of `delineate`."""
SURE, SURELY_NOT = np.float32(0.9), np.float32(0.1)
"""P(body) from which on a pixel is body, and up to which it is not; between, the network does not know."""
AGREED = np.float32(0.7)
"""Coverage by grey levels of a pixel that the network is sure of; below, the two contradict each other."""
NOISE_SIGMAS = 4.0
"""Contrast below so many standard deviations of the noise decides nothing."""
HALO_PX = (4, 16)
"""Beyond the first distance from its edge neither lens nor motion show a body; up to the second it is looked for."""
HALO_CONTRAST = 0.06
"""Difference from the expected, as a share of it, that shows a body there all the same."""


def limits_of(
    image: Array,
    expected: Array,
    level: Array,
    probability: Array,
    core: Bits,
    possible: Bits,
    undecided: Bits,
    dark: float,
    min_contrast: float,
    noise: float,
) -> Bits:
    """Of each pixel (h, w): whether it is core or possible, and whether grey levels mean nothing there.

    Parameters
    ----------
    image, expected, level
        Grey levels: seen, without a body, and of the body.
    probability
        That it is body, as the network says.
    core, possible, undecided
        Masks: surely body, surely nothing outside of it, and where the network does not know.
    dark
        What is expected to be darker is an aperture or a screw, before which a dark body is not seen.
    min_contrast
        Least contrast of the body, as a share of the expected.
    noise
        Standard deviation of a pixel.
    """
    is_core, contrast, covered = core != 0, expected - level, expected - image
    least = np.maximum(np.float32(min_contrast) * expected, np.float32(NOISE_SIGMAS * noise))
    is_unknown = (undecided != 0) | (expected < dark) & (np.abs(covered) < least)
    height, cover = np.abs(contrast), covered * np.where(contrast < 0, np.float32(-1), np.float32(1))
    is_refuted = (probability > SURE) & (cover < AGREED * height)
    is_refuted |= (probability < SURELY_NOT) & (cover > (1 - AGREED) * height)
    is_unknown |= ~is_core & ((height < least) | is_refuted)
    limits = POSSIBLE | CORE * is_core | UNKNOWN * is_unknown
    return limits * (possible != 0)


def halo_of(behind: Behind, image: Bits, inside: Bits, suspect: Bits, noise: float) -> Bits:
    """Around what differs from the expected just outside of the body found: a rim, a highlight, a sharp shadow.

    Parameters
    ----------
    behind
        What is expected, for a region of the image.
    image
        (h, w) the part of the image that is in the region.
    inside, suspect
        (height, width) 1 for the region's pixels that are body, and for those that may not be what is expected.
    noise
        Standard deviation of a pixel of the image.

    Returns
    -------
    array
        (height, width) 1 for the pixels of the region to be looked at.
    """
    scale = behind.region.scale
    # a disc would cost ten times more
    near, around = (_widened(inside, reach_px / scale) for reach_px in HALO_PX)
    beyond = behind.differs(
        image, suspect & (around - near), HALO_CONTRAST, NOISE_SIGMAS / LEAST_SIDE_PX * noise
    )
    return _widened(beyond, 2 * HALO_PX[0] / scale) if beyond.any() else beyond


def _widened(mask: Bits, reach: float) -> Bits:
    """The mask (h, w) wider by so many pixels on each side, rounded up."""
    return np.asarray(cv2.dilate(mask, np.ones((2 * ceil(reach) + 1,) * 2, np.uint8)), np.uint8)
