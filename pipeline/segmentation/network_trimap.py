"""Where the edge of a body that a network found is looked for, and where grey levels would mislead.

The network is sure of most pixels, one way or the other. In between, `delineate` decides by grey levels; pixels
where these have too little contrast, or contradict the network, are unknown.
"""

from math import ceil

import cv2
import numpy as np

from pipeline.arrays import FloatImage, GreyImage
from pipeline.segmentation.expected_view import extrapolated
from pipeline.segmentation.lit_background import MIN_SIDE_PX, LitBackground
from pipeline.segmentation.prediction import SURE, SURELY_NOT, Prediction
from pipeline.segmentation.subtraction import SegmentationParameters

CORE, POSSIBLE, UNKNOWN = np.uint8(1), np.uint8(2), np.uint8(4)
"""Bits of a pixel, the masks that `trimap_of` takes."""
AGREED = np.float32(0.7)
"""Coverage by grey levels of a pixel that the network is sure of; below, the two contradict each other."""
NOISE_SIGMAS = 4.0
"""Contrast below this many standard deviations of the noise decides nothing."""
HALO_PX = (4, 16)
"""Distances from the edge that was found, within which further body is looked for: nearer, lens and motion blur the
edge itself."""
HALO_CONTRAST = 0.06
"""Difference from the expected view, as a share of it, that indicates further body there."""


def network_trimap(
    prediction: Prediction,
    light: FloatImage,
    core: GreyImage,
    possible: GreyImage,
    parameters: SegmentationParameters,
    noise: float,
) -> GreyImage:
    """Return the bits `CORE`, `POSSIBLE` and `UNKNOWN` of each pixel (h, w); unknown: grey levels mean nothing.

    Parameters
    ----------
    light
        Light of the image relative to that of the expected view.
    core, possible
        Masks: surely body, and surely nothing outside of it.
    parameters
        What is expected to be darker than `dark_share` is an aperture or a screw, before which a dark body is not seen.
    noise
        Standard deviation of a pixel as a share of the wall.
    """
    image, probability = prediction.image, prediction.probability
    expected, level = prediction.expected * light, extrapolated(image, core)
    is_core, contrast, covered = core != 0, expected - level, expected - image
    least = np.maximum(np.float32(parameters.min_contrast) * expected, np.float32(NOISE_SIGMAS * noise))
    is_unknown = (prediction.undecided != 0) | (expected < parameters.dark_share) & (np.abs(covered) < least)
    height, cover = np.abs(contrast), covered * np.where(contrast < 0, np.float32(-1), np.float32(1))
    is_refuted = (probability > SURE) & (cover < AGREED * height)
    is_refuted |= (probability < SURELY_NOT) & (cover > (1 - AGREED) * height)
    is_unknown |= ~is_core & ((height < least) | is_refuted)
    bits = POSSIBLE | CORE * is_core | UNKNOWN * is_unknown
    return bits * (possible != 0)


def find_halo(
    background: LitBackground, image: GreyImage, inside: GreyImage, suspect: GreyImage, noise: float
) -> GreyImage:
    """Return the surroundings of what differs just outside of the body: a rim, a highlight, a sharp shadow.

    Parameters
    ----------
    background
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
    scale = background.region.scale
    # a disc would cost ten times more
    near, around = (_dilated_square(inside, radius_px / scale) for radius_px in HALO_PX)
    beyond = background.differing(
        image, suspect & (around - near), HALO_CONTRAST, NOISE_SIGMAS / MIN_SIDE_PX * noise
    )
    return _dilated_square(beyond, 2 * HALO_PX[0] / scale) if beyond.any() else beyond


def _dilated_square(mask: GreyImage, radius: float) -> GreyImage:
    """Return the mask (h, w) dilated by a square of this half width in pixels, rounded up."""
    return np.asarray(cv2.dilate(mask, np.ones((2 * ceil(radius) + 1,) * 2, np.uint8)), np.uint8)
