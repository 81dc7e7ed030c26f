"""The noise of a sensor by grey level and of an image as a whole, and smoothing by as much as its noise requires.

An edge is found in noise by integrating along and across it. To smooth the image does both at once, and the width that
it adds to an edge is measured with the rest.
"""

from typing import NamedTuple

import cv2
import numpy as np

from pipeline.arrays import FloatImage, GreyImage, Singles

QUIET_GREY, BROKEN_GREY = 3.0, 40.0
"""Noise that needs no smoothing, and noise that no sensor has that works: it stays what it is."""
SMOOTHING_PX_PER_GREY = 0.14
"""Sigma of the smoothing for each grey level of noise: two levels are left, so that the limits that tell edges from
grain hold."""
MAX_SMOOTHING_PX = 3.0
LEVEL_GREY = 8
"""Width of the levels whose noise is told apart."""
PRIOR_PAIRS = 1000.0
"""Pairs of pixels that a typical sensor counts for: it parts what one grey level leaves open."""


class SensorNoise(NamedTuple):
    """Variance of a pixel's grey level: by reading it, rounding included, and by its photons."""

    read_grey2: float
    photons_grey: float  # for each grey level (Poisson)

    def variance_grey2(self, grey: Singles) -> Singles:
        """Return the variances at grey levels (N,)."""
        return np.asarray(self.read_grey2 + self.photons_grey * grey, np.float32)


TYPICAL_NOISE = SensorNoise(read_grey2=0.25, photons_grey=0.015)
"""A sigma of 0.65 at grey level 12 and of 1.6 at 150, as common sensors have at low gain."""


def sensor_noise(empty: FloatImage) -> SensorNoise:
    """Estimate the noise of a sensor from an image (H, W) of the empty rig, which is smooth nearly everywhere.

    A line through the variances of neighbours' differences at each grey level that it shows, by least squares.
    """
    left, right = (
        np.ascontiguousarray(empty[::64, :-1]).ravel(),
        np.ascontiguousarray(empty[::64, 1:]).ravel(),
    )
    levels = ((left + right) / (2 * LEVEL_GREY)).astype(np.int64)
    n = np.bincount(levels).astype(float)
    seen = n > 1
    mean = np.bincount(levels, np.abs(right - left))[seen] / n[seen]
    grey, variance = (np.flatnonzero(seen) + 0.5) * LEVEL_GREY, np.pi / 4 * mean**2
    typical = np.asarray(TYPICAL_NOISE.variance_grey2(grey), float)
    louder = max(float(np.average(variance / typical, weights=n[seen])), 1e-3)
    weights = np.sqrt(n[seen]) / (louder * typical)
    rows = np.concatenate(
        [
            np.column_stack([weights, weights * grey]),
            np.diag(np.sqrt(PRIOR_PAIRS) / (louder * np.array(TYPICAL_NOISE))),
        ]
    )
    found = np.linalg.lstsq(
        rows, np.concatenate([weights * variance, np.full(2, np.sqrt(PRIOR_PAIRS))]), rcond=None
    )[0]
    read_grey2, photons_grey = np.maximum(found, 0.0).tolist()
    return SensorNoise(read_grey2, photons_grey)


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
