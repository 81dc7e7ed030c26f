"""The noise of an image, and smoothing by as much as its noise requires.

An edge is found in noise by integrating along and across it. To smooth the image does both at once, and the width that
it adds to an edge is measured with the rest.
"""

import cv2
import numpy as np

from pipeline.arrays import GreyImage

QUIET_GREY, BROKEN_GREY = 3.0, 40.0
"""Noise that needs no smoothing, and noise that no sensor has that works: it stays what it is."""
SMOOTHING_PX_PER_GREY = 0.14
"""Sigma of the smoothing for each grey level of noise: two levels are left, so that the limits that tell edges from
grain hold."""
MAX_SMOOTHING_PX = 3.0


def noise_grey(image: GreyImage) -> float:
    """Estimate the noise's standard deviation from neighbours on every 64th row: most pixels are smooth."""
    rows = np.ascontiguousarray(image[::64])
    return float(cv2.norm(rows[:, 1:], rows[:, :-1], cv2.NORM_L1) / rows[:, 1:].size * np.sqrt(np.pi) / 2)


def smoothed(region: GreyImage, noise: float) -> GreyImage:
    """Return a copy of a region (h, w) of an image of such noise, smoothed where it is too much."""
    if not QUIET_GREY < noise < BROKEN_GREY:
        return region.copy()
    sigma_px = min(SMOOTHING_PX_PER_GREY * noise, MAX_SMOOTHING_PX)
    return np.asarray(cv2.GaussianBlur(region, (0, 0), sigma_px), np.uint8)
