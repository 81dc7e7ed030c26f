"""What is behind the body, as far as one image and the empty rig tell.

With a background it is the background in this flash; without, a smooth surface through the outer parts of
the image. Either is corrected where the body ends: what the image shows just outside of it, relative to
what was expected there, is carried inwards. So light that differs smoothly costs no accuracy.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.segmentation.background import COARSE, CameraBackground, coarsen
from pipeline.segmentation.light import flash_gain

Array = NDArray[np.float32]
Bits = NDArray[np.uint8]

BORDER_SHARE = 0.12
"""Width of the image's border, as a share of it, that a body in the middle leaves free."""
OUTLIER = 0.1
"""Blocks at the border that differ more from the smooth surface are dots or a body; they are left out of it."""
CELL = COARSE
"""Edge of the blocks on which a level is carried on."""
REACHES = (1, 3, 8, 22)
"""Half widths, in blocks, of the windows over which it is; the narrowest that holds enough of it decides."""
ENOUGH = 0.12
"""Share of a window that must be known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ground:
    """The expected view without a body, before the light around the body corrects it."""

    coarse: Array  # (H/4, W/4) grey level of each block, but for `gain`
    wall: float  # grey level of the plain wall in this image
    levels: Bits | None  # (H, W) of the empty rig; None: nothing is known but `coarse`
    gain: float  # of this flash


def ground_of(coarse: Bits, known: CameraBackground | None) -> Ground:
    """What to expect in an image of which every fourth row and column (H/4, W/4) is given."""
    if known is None:
        surface = _smooth_surface(coarse)
        return Ground(coarse=surface, wall=max(float(np.median(surface)), 1.0), levels=None, gain=1.0)
    gain = flash_gain(coarse, known.coarse)
    return Ground(coarse=known.coarse, wall=max(gain * known.typical, 1.0), levels=known.levels, gain=gain)


def carried(values: Array, is_known: Bits) -> Array:
    """The values (h, w) where they are known: smooth, the mean of the known ones nearby; 1 if there are none."""
    height, width = values.shape
    fine = cv2.resize(_carried(values, is_known), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine, np.float32)


def _carried(values: Array, is_known: Bits) -> Array:
    """The same for blocks (h / CELL, w / CELL), rounded up."""
    # np.where takes thirty times as long
    sums, counts = (
        _block_sums(np.asarray(cv2.copyTo(each, is_known), np.float32))
        for each in (values, np.ones_like(values))
    )
    n = counts.sum()
    result = np.full(sums.shape, sums.sum() / n if n > 0 else 1, np.float32)
    for reach in reversed(REACHES):
        total, near = (_window_sums(each, reach) for each in (sums, counts))
        is_enough = near > ENOUGH * CELL**2 * _window_sizes(sums.shape, reach)
        np.divide(total, near, out=result, where=is_enough)
    return result


def _block_sums(values: Array) -> Array:
    """Sums (h / CELL, w / CELL), rounded up, over blocks of values (h, w)."""
    below, beside = (-size % CELL for size in values.shape)
    filled = cv2.copyMakeBorder(values, 0, below, 0, beside, cv2.BORDER_CONSTANT)
    return CELL**2 * coarsen(np.asarray(filled, np.float32))


def _window_sums(values: Array, reach: int) -> Array:
    """Sums (h, w) over values as far as `reach` to either side."""
    side = 2 * reach + 1
    sums = cv2.boxFilter(values, cv2.CV_32F, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(sums, np.float32)


def _window_sizes(shape: tuple[int, ...], reach: int) -> Array:
    """How many of the values (h, w) there are as far as `reach` to either side."""
    rows, columns = (
        np.minimum(np.arange(reach + 1, size + reach + 1), size)
        - np.maximum(np.arange(-reach, size - reach), 0)
        for size in shape
    )
    return np.outer(rows, columns).astype(np.float32)


def _smooth_surface(coarse: Bits) -> Array:
    """Quadratic (h, w) through the border of the image: light falls off smoothly, and a body is in the middle."""
    height, width = coarse.shape
    v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    inner = 1 - 2 * BORDER_SHARE
    at_border = (np.maximum(np.abs(u), np.abs(v)) > inner)[::2, ::2]
    some, values = terms[::2, ::2][at_border], coarse[::2, ::2][at_border].astype(np.float32)
    agrees = np.abs(values - np.median(values)) < 2 * OUTLIER * np.median(values)
    for _ in range(2):
        fit = np.linalg.lstsq(some[agrees], values[agrees])[0]
        agrees = np.abs(values - some @ fit) < OUTLIER * np.median(values)
    return np.asarray(np.maximum(terms @ fit, 1), np.float32)
