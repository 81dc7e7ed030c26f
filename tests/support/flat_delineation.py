"""`pipeline.segmentation.delineation` as a page of array expressions over the whole region: slow, and easy to check."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, label
from scipy.special import ndtri

from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

TIE = 0.03
"""Coverages this near to one half may fall to either side: the levels are means over other samples."""


def flat_delineation(
    image: Array, expected: Array, core: Mask, possible: Mask, unknown: Mask, min_contrast: float = 0.12
) -> tuple[NDArray[np.uint8], NDArray[np.float64], Mask]:
    """Labels (h, w), mean crossings (h, w, 2) of the edge beside each pixel of the body, and near ties (h, w).

    All holes are filled; crossings beside the unknown are NaN.
    """
    level = _carried(image, core, 13)
    level = np.where(np.isnan(level), _carried(image, core, 65), level)
    contrast = expected - level
    to_decide = possible & ~core & ~unknown
    undecided = unknown & ~core | to_decide & (np.abs(contrast) < min_contrast * expected)
    coverage = np.where(core, 1, (expected - image) / np.where(contrast == 0, 1, contrast))
    inside = core | to_decide & ~undecided & (coverage > 0.5)

    parts, n_parts = label(inside | undecided, np.ones((3, 3)))
    sizes = [np.count_nonzero(inside & (parts == part)) for part in range(1, n_parts + 1)]
    body = binary_fill_holes(parts == 1 + int(np.argmax(sizes)))
    labels = np.where(undecided, UNKNOWN, np.where(body, INSIDE, OUTSIDE))

    probit = np.where(undecided, np.nan, ndtri(np.clip(coverage, 0.025, 0.975)))
    total, n = np.zeros((*body.shape, 2)), np.zeros(body.shape)
    pixels_uv = np.stack(np.meshgrid(*(np.arange(size) for size in body.shape[::-1])), axis=-1)
    for u, v in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        beyond, is_body = (np.roll(of, (-v, -u), axis=(0, 1)) for of in (probit, body))
        straddles = (probit >= 0) & (beyond <= 0) & (probit > beyond)
        share = np.where(straddles, probit / np.where(straddles, probit - beyond, 1), 0.5)
        share[np.isnan(probit) | np.isnan(beyond)] = np.nan
        is_crossed = body & ~is_body
        total[is_crossed] += (pixels_uv + share[..., None] * np.array([u, v]))[is_crossed]
        n += is_crossed
    points = total / np.where(n > 0, n, np.nan)[..., None]
    return labels, points, to_decide & (np.abs(coverage - 0.5) < TIE)


def _carried(image: Array, core: Mask, window_px: int) -> Array:
    """Mean of the core's grey levels in the window around each pixel, NaN where the window holds no core."""
    weight = cv2.blur(core.astype(np.float32), (window_px, window_px))
    level = cv2.blur(image * core, (window_px, window_px))
    return np.where(weight > 1e-4, level / np.maximum(weight, 1e-4), np.nan)
