"""What is behind the body, as far as one image and the empty rig tell.

With a background it is the background in this flash; without, a smooth surface through the outer parts of
the image. Either is corrected where the body ends: what the image shows just outside of it, relative to
what was expected there, is carried inwards. So light that differs smoothly costs no accuracy.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.background import CameraBackground
from pipeline.segmentation.light import flash_gain

Array = NDArray[np.float32]
Bits = NDArray[np.uint8]

BORDER_SHARE = 0.12
"""Width of the image's border, as a share of it, that a body in the middle leaves free."""
OUTLIER = 0.1
"""Blocks at the border that differ more from the smooth surface are dots or a body; they are left out of it."""
CELL = 4
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


@compiled
def _carried(values: Array, is_known: Bits) -> Array:
    """The same for blocks (h / CELL, w / CELL), rounded up."""
    height, width = values.shape
    n_rows, n_columns = -(-height // CELL), -(-width // CELL)
    # of all blocks above and to the left
    sums, counts = np.zeros((n_rows + 1, n_columns + 1)), np.zeros((n_rows + 1, n_columns + 1))
    for v in range(height):
        for u in range(width):
            if is_known[v, u]:
                sums[v // CELL + 1, u // CELL + 1] += values[v, u]
                counts[v // CELL + 1, u // CELL + 1] += 1
    for row in range(1, n_rows + 1):
        for column in range(1, n_columns + 1):
            for table in (sums, counts):
                table[row, column] += (
                    table[row - 1, column] + table[row, column - 1] - table[row - 1, column - 1]
                )
    result = np.empty((n_rows, n_columns), np.float32)
    for row in range(n_rows):
        for column in range(n_columns):
            total, n = sums[-1, -1], counts[-1, -1]
            for reach in REACHES:
                top, bottom = max(row - reach, 0), min(row + reach + 1, n_rows)
                left, right = max(column - reach, 0), min(column + reach + 1, n_columns)
                near = counts[bottom, right] - counts[top, right] - counts[bottom, left] + counts[top, left]
                if near > ENOUGH * CELL * CELL * (bottom - top) * (right - left):
                    total, n = (
                        sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left],
                        near,
                    )
                    break
            result[row, column] = total / n if n > 0 else 1
    return result


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
