"""Grey levels beside a body's edge: its own, carried outwards from the core, and what they say of each pixel.

The loops visit only the pixels between core and possible.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import INSIDE, UNKNOWN

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]

REACH_PX = 6
"""The body's grey level is the mean of the core up to so far away along rows and columns."""
FAR_PX = 32
"""The same for slivers too thin for a core, and edges beside the unknown, that ask further around."""
N_SAMPLES = 3
"""Every so many-th part of that reach is asked: (2 N_SAMPLES + 1)^2 pixels."""
BLOCK_PX = 4
"""The level is the same for the pixels of a block of this edge."""
LEAST_COVERAGE = 0.025
"""Coverages are cut off here and at one less this before their probit is taken."""


class GreyLevels(NamedTuple):
    """What decides between core and possible."""

    image: Grey | Array  # (h, w)
    expected: Array  # (h, w)
    gain: np.float32  # factor on `expected`
    known: Grey  # INSIDE the core, or UNKNOWN, else OUTSIDE; (h, w) or half of it
    open_cells: NDArray[np.int64]  # (N,) flat indices of its pixels that are to be decided
    halvings: int  # 1 if it is of half the size, else 0


@compiled
def carried(view: GreyLevels) -> Array:
    """Grey level of the body, the same for the pixels of a block (h / BLOCK_PX, w / BLOCK_PX).

    NaN where nothing is to be decided.
    """
    image, known, halvings = view.image, view.known, view.halvings
    height, width = image.shape
    levels = np.full((height // BLOCK_PX + 1, width // BLOCK_PX + 1), np.nan, np.float32)
    typical = np.float32(np.nan)
    for cell in view.open_cells:
        row, column = cell // known.shape[1], cell % known.shape[1]
        # and for the pixels next to it, between which the edge may run
        first_y, last_y = max((row << halvings) - 1, 0) // BLOCK_PX, ((row + 1) << halvings) // BLOCK_PX
        first_x, last_x = max((column << halvings) - 1, 0) // BLOCK_PX, ((column + 1) << halvings) // BLOCK_PX
        for y in range(first_y, min(last_y + 1, levels.shape[0])):
            for x in range(first_x, min(last_x + 1, levels.shape[1])):
                if not np.isnan(levels[y, x]):
                    continue
                v, u = y * BLOCK_PX + BLOCK_PX // 2, x * BLOCK_PX + BLOCK_PX // 2
                level = _mean_around(image, known, halvings, v, u, REACH_PX)
                if np.isnan(level):
                    level = _mean_around(image, known, halvings, v, u, FAR_PX)
                if np.isnan(level):  # no core far and wide: what may be body, its edge included
                    if np.isnan(typical):
                        typical = np.float32(0)
                        for other in view.open_cells:
                            other_row, other_column = other // known.shape[1], other % known.shape[1]
                            typical += np.float32(image[other_row << halvings, other_column << halvings])
                        typical /= len(view.open_cells)
                    level = typical
                levels[y, x] = level
    return levels


@compiled
def _mean_around(
    image: Grey | Array, known: Grey, halvings: int, v: int, u: int, reach_px: int
) -> np.float32:
    """Mean of the core's pixels in a sparse window, NaN of none."""
    height, width = image.shape
    step = max(reach_px // N_SAMPLES, 1)
    reach_px = N_SAMPLES * step
    total, n = np.float32(0), np.float32(0)
    for y in range(max(v - reach_px, v % step), min(v + reach_px + 1, height), step):
        for x in range(max(u - reach_px, u % step), min(u + reach_px + 1, width), step):
            if known[y >> halvings, x >> halvings] == INSIDE:
                total += np.float32(image[y, x])
                n += np.float32(1)
    return total / n


@compiled
def decide(view: GreyLevels, levels: Array, min_contrast: np.float32, labels: Grey) -> bool:
    """Label what is possible and not yet known (h, w); whether any of it is inside."""
    image, expected, gain, halvings = view.image, view.expected, view.gain, view.halvings
    (height, width), n_columns = image.shape, view.known.shape[1]
    is_inside = False
    for cell in view.open_cells:
        row, column = cell // n_columns, cell % n_columns
        for v in range(row << halvings, min((row + 1) << halvings, height)):
            for u in range(column << halvings, min((column + 1) << halvings, width)):
                behind = gain * expected[v, u]
                contrast = behind - levels[v // BLOCK_PX, u // BLOCK_PX]
                if abs(contrast) < min_contrast * behind:
                    labels[v, u] = UNKNOWN
                elif (behind - image[v, u]) / contrast > 0.5:
                    labels[v, u] = INSIDE
                    is_inside = True
    return is_inside


@compiled
def crossings(
    view: GreyLevels, levels: Array, body: Grey, labels: Grey, pixels_uv: NDArray[np.int32]
) -> tuple[NDArray[np.float64], Grey]:
    """Points (N, 2): the mean crossing of the edge beside each pixel (N, 2), and whether it was seen (N,).

    Under a Gaussian blur of any width the probit of the coverage is linear across the edge.
    """
    image, expected, gain = view.image, view.expected, view.gain
    known, halvings = view.known, view.halvings
    height, width = body.shape
    points_uv, seen = np.empty((len(pixels_uv), 2)), np.ones(len(pixels_uv), np.uint8)
    for i in range(len(pixels_uv)):
        u, v = pixels_uv[i, 0], pixels_uv[i, 1]
        within, n = 0.0, 0
        points_uv[i] = 0
        for neighbour in range(-1, 4):
            x, y = u, v  # the pixel itself first
            if neighbour >= 0:
                x += (neighbour == 0) - (neighbour == 1)
                y += (neighbour == 2) - (neighbour == 3)
                if not (0 <= x < width and 0 <= y < height) or body[y, x]:
                    continue
            coverage = 1.0
            if known[y >> halvings, x >> halvings] != INSIDE:
                behind = gain * expected[y, x]
                coverage = float((behind - image[y, x]) / (behind - levels[y // BLOCK_PX, x // BLOCK_PX]))
            probit = _probit(min(max(coverage, LEAST_COVERAGE), 1 - LEAST_COVERAGE))
            if labels[y, x] == UNKNOWN:
                seen[i] = 0
            if neighbour < 0:
                within = probit
                continue
            share = 0.5
            if seen[i] and within >= 0 >= probit and within > probit:
                share = within / (within - probit)
            points_uv[i, 0] += u + share * (x - u)
            points_uv[i, 1] += v + share * (y - v)
            n += 1
        if n > 0:
            points_uv[i] /= n
        else:  # at the border of the region
            points_uv[i, 0], points_uv[i, 1], seen[i] = u, v, 0
    return points_uv, seen


@compiled
def _probit(coverage: float) -> float:
    """Quantile of the normal distribution for 0.025..0.975, the middle of P. J. Acklam's approximation (1e-8)."""
    q = coverage - 0.5
    r = q * q
    above = (
        (((-39.69683028665376 * r + 220.9460984245205) * r - 275.9285104469687) * r + 138.3577518672690) * r
        - 30.66479806614716
    ) * r + 2.506628277459239
    below = (
        (((-54.47609879822406 * r + 161.5858368580409) * r - 155.6989798598866) * r + 66.80131188771972) * r
        - 13.28068155288572
    ) * r + 1.0
    return q * above / below
