"""View without the body, estimated from the image itself and from the empty rig.

With a background it is the background in this flash; without one, a smooth surface through the outer parts of
the image. Either is corrected where the body ends: the ratio of the image to the expected view just outside of
the body is extrapolated inwards. So light that differs smoothly costs no accuracy.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from pipeline.arrays import FloatImage, GreyImage
from pipeline.segmentation.background import COARSE, CameraBackground, coarsen
from pipeline.segmentation.light import flash_gain

BORDER_SHARE = 0.12
"""Width of the image's border, as a share of it, that a body in the middle leaves free."""
OUTLIER = 0.1
"""Border blocks that differ from the smooth surface by more than this share are dots or a body: they are left out."""
BLOCK_PX = COARSE
"""Edge of the blocks on which values are extrapolated."""
HALF_WIDTHS = (1, 3, 8, 22)
"""Half widths, in blocks, of the averaging windows; the narrowest that holds enough known pixels decides."""
MIN_KNOWN_SHARE = 0.12
"""Share of a window that must be known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExpectedView:
    """The view without a body, before the light around the body corrects it."""

    coarse: FloatImage  # (H/4, W/4) grey level of each block, `gain` not applied
    wall: float  # grey level of the plain wall in this image
    levels: GreyImage | None  # (H, W) of the empty rig; `None`: nothing is known but `coarse`
    gain: float  # of this flash


def expected_view(coarse: GreyImage, known: CameraBackground | None) -> ExpectedView:
    """Return the expected view behind a body, for an image given by every fourth row and column (H/4, W/4)."""
    if known is None:
        surface = _smooth_surface(coarse)
        return ExpectedView(coarse=surface, wall=max(float(np.median(surface)), 1.0), levels=None, gain=1.0)
    gain = flash_gain(coarse, known.coarse)
    return ExpectedView(
        coarse=known.coarse, wall=max(gain * known.typical, 1.0), levels=known.levels, gain=gain
    )


def extrapolated(values: FloatImage, is_known: GreyImage) -> FloatImage:
    """Return, for every pixel (h, w), the mean of the known values nearby, interpolated; 1 if none is known."""
    height, width = values.shape
    fine = cv2.resize(_extrapolated_blocks(values, is_known), (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine, np.float32)


def _extrapolated_blocks(values: FloatImage, is_known: GreyImage) -> FloatImage:
    """Return the mean of the known values near each block (h / BLOCK_PX, w / BLOCK_PX), rounded up."""
    # np.where takes thirty times as long
    sums, counts = (
        _block_sums(np.asarray(cv2.copyTo(each, is_known), np.float32))
        for each in (values, np.ones_like(values))
    )
    n = counts.sum()
    result = np.full(sums.shape, sums.sum() / n if n > 0 else 1, np.float32)
    for half_width in reversed(HALF_WIDTHS):
        total, near = (_window_sums(each, half_width) for each in (sums, counts))
        is_enough = near > MIN_KNOWN_SHARE * BLOCK_PX**2 * _window_sizes(sums.shape, half_width)
        np.divide(total, near, out=result, where=is_enough)
    return result


def _block_sums(values: FloatImage) -> FloatImage:
    """Return the sums over blocks (h / BLOCK_PX, w / BLOCK_PX), rounded up, of values (h, w)."""
    below, beside = (-size % BLOCK_PX for size in values.shape)
    filled = cv2.copyMakeBorder(values, 0, below, 0, beside, cv2.BORDER_CONSTANT)
    return BLOCK_PX**2 * coarsen(np.asarray(filled, np.float32))


def _window_sums(values: FloatImage, half_width: int) -> FloatImage:
    """Return the sums (h, w) over a square window around each value."""
    side = 2 * half_width + 1
    sums = cv2.boxFilter(values, cv2.CV_32F, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(sums, np.float32)


def _window_sizes(shape: tuple[int, ...], half_width: int) -> FloatImage:
    """Return the number of values (h, w) in a square window around each of them, cut at the borders."""
    rows, columns = (
        np.minimum(np.arange(half_width + 1, size + half_width + 1), size)
        - np.maximum(np.arange(-half_width, size - half_width), 0)
        for size in shape
    )
    return np.outer(rows, columns).astype(np.float32)


def _smooth_surface(coarse: GreyImage) -> FloatImage:
    """Fit a quadratic (h, w) to the border of the image: light falls off smoothly, and a body is in the middle."""
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
