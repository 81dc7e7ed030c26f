"""What is behind the body, as far as one image and the empty rig tell.

With a background it is the background in this flash; without, a smooth surface through the outer parts of
the image. Either is corrected where the body ends: what the image shows just outside of it, relative to
what was expected there, is carried inwards. So light that differs smoothly costs no accuracy.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.segmentation.background import CameraBackground, flash_gain

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

BORDER_SHARE = 0.12
"""Width of the image's border, as a share of it, that a body in the middle leaves free."""
OUTLIER = 0.1
"""Blocks at the border that differ more from the smooth surface are dots or a body; they are left out of it."""
CELL = 4
"""Edge of the blocks on which a level is carried on."""
WINDOWS = (3, 7, 17, 45)
"""Widths in blocks over which it is; the narrowest that holds enough of it decides."""
ENOUGH = 0.12
"""Share of a window that must be known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """The expected view without a body, before the light around the body corrects it."""

    coarse: Array  # (H/4, W/4) grey level of each block
    wall: float  # grey level of the plain wall in this image
    mean: Array | None  # (H, W) the empty rig; None: nothing is known but `coarse`
    gain: float  # of this flash to that of `mean`


def ground_of(coarse: Array, known: CameraBackground | None) -> Ground:
    """What to expect in an image of these block means (H/4, W/4)."""
    if known is None:
        surface = _smooth_surface(coarse)
        return Ground(coarse=surface, wall=float(np.median(surface)), mean=None, gain=1.0)
    gain = flash_gain(coarse, known.coarse)
    return Ground(
        coarse=known.coarse * np.float32(gain), wall=gain * known.typical, mean=known.mean, gain=gain
    )


def carried(*levels: tuple[Array, Mask]) -> list[Array]:
    """Each of these levels (h, w) where it is known: smooth, the mean of the known values nearby; 1 if none is."""
    height, width = levels[0][0].shape
    size = (-(-width // CELL), -(-height // CELL))
    channels = (each for values, is_known in levels for each in (values * is_known, is_known))
    stack = np.dstack(
        [cv2.resize(each.astype(np.float32), size, interpolation=cv2.INTER_AREA) for each in channels]
    )
    means = []
    for window in WINDOWS:
        near = cv2.blur(stack, (window, window))
        means.append((near[..., ::2] / np.maximum(near[..., 1::2], np.float32(1e-6)), near[..., 1::2]))
    total = stack.sum(axis=(0, 1))
    result = np.empty_like(means[0][0])
    result[:] = np.where(total[1::2] > 0, total[::2] / np.maximum(total[1::2], np.float32(1e-6)), 1)
    for mean, share in reversed(means):
        np.copyto(result, mean, where=share > ENOUGH)
    fine = cv2.resize(result, (width, height), interpolation=cv2.INTER_LINEAR)
    return [np.asarray(fine, np.float32)[..., index] for index in range(len(levels))]


def _smooth_surface(coarse: Array) -> Array:
    """Quadratic (h, w) through the border of the image: light falls off smoothly, and a body is in the middle."""
    height, width = coarse.shape
    v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    inner = 1 - 2 * BORDER_SHARE
    at_border = (np.maximum(np.abs(u), np.abs(v)) > inner)[::2, ::2]
    some, values = terms[::2, ::2][at_border], coarse[::2, ::2][at_border]
    agrees = np.abs(values - np.median(values)) < 2 * OUTLIER * np.median(values)
    for _ in range(2):
        fit = np.linalg.lstsq(some[agrees], values[agrees])[0]
        agrees = np.abs(values - some @ fit) < OUTLIER * np.median(values)
    return np.asarray(np.maximum(terms @ fit, 1), np.float32)
