"""Grey levels beside a body's edge: its own, carried outwards from the core, and what they say of each pixel.

The loops visit only the pixels between core and possible, of which `spread` makes a list.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

BLOCK_PX = 4
"""The body's grey level is the same for the pixels of a block of this edge: the mean of the core in it and its
eight neighbours."""
FAR_PX = 32
"""Slivers too thin for a core, and edges beside the unknown, ask so far around."""
N_SAMPLES = 3
"""Every so many-th part of that reach is asked: (2 N_SAMPLES + 1)^2 pixels."""
LEAST_COVERAGE = 0.025
"""Coverages are cut off here and at one less this before their probit is taken."""


class GreyLevels(NamedTuple):
    """What decides between core and possible."""

    image: Grey | Array  # (h, w)
    expected: Grey | Array  # (H, W) without a body
    left: int  # where in that the image begins
    top: int
    gain: np.float32  # factor on `expected`
    known: Grey  # INSIDE the core, or UNKNOWN, else OUTSIDE; (h, w) or half of it
    open_cells: NDArray[np.int32]  # (N, 2) row and column of its pixels that are to be decided
    halvings: int  # 1 if it is of half the size, else 0


@compiled
def spread(core: Mask, possible: Mask, unknown: Mask) -> tuple[Grey, NDArray[np.int32], NDArray[np.uint16]]:
    """What is known (h, w), the cells (N, 2) that are open, and every pixel of the known twice (2 h, w)."""
    height, width = core.shape
    n_pixels = height * width
    known = np.empty((height, width), np.uint8)
    twice = np.empty((2 * height, width), np.uint16)
    # the open ones are few: eight at a time are skipped
    eights = np.zeros(-(-n_pixels // 8), np.uint64)
    is_open = eights.view(np.uint8)
    n_open = 0
    for row in range(height):
        open_here = is_open[row * width :]
        for column in range(width):
            label = INSIDE if core[row, column] else UNKNOWN if unknown[row, column] else OUTSIDE
            known[row, column] = label
            twice[2 * row, column] = twice[2 * row + 1, column] = label * np.uint16(0x0101)
            open_here[column] = possible[row, column] & (label == OUTSIDE)
            n_open += open_here[column]
    cells = np.empty((n_open, 2), np.int32)
    n_cells, row, end = 0, 0, width
    for eight in range(len(eights)):
        if eights[eight] == 0:
            continue
        for pixel in range(8 * eight, 8 * eight + 8):
            if is_open[pixel]:
                while pixel >= end:
                    row, end = row + 1, end + width
                cells[n_cells, 0], cells[n_cells, 1] = row, pixel - end + width
                n_cells += 1
    return known, cells, twice


@compiled
def carried(view: GreyLevels) -> Array:
    """Grey level of the body in each block (h / BLOCK_PX, w / BLOCK_PX); NaN where nothing is to be decided."""
    image, known, halvings = view.image, view.known, view.halvings
    height, width = image.shape
    n_rows, n_columns = height // BLOCK_PX + 1, width // BLOCK_PX + 1
    levels = np.empty((n_rows, n_columns), np.float32)
    for y in range(n_rows):
        for x in range(n_columns):
            levels[y, x] = np.nan
    # of every second pixel of every second row that is of the core, with a border of blocks that have none
    sums, counts = (
        np.zeros((n_rows + 2, n_columns + 2), np.float32),
        np.zeros((n_rows + 2, n_columns + 2), np.uint8),
    )
    is_added = np.zeros((n_rows + 2, n_columns + 2), np.bool_)
    typical = np.float32(np.nan)
    for i in range(len(view.open_cells)):
        row, column = view.open_cells[i, 0], view.open_cells[i, 1]
        # and for the pixels next to it, between which the edge may run
        first_y, last_y = max((row << halvings) - 1, 0) // BLOCK_PX, ((row + 1) << halvings) // BLOCK_PX
        first_x, last_x = max((column << halvings) - 1, 0) // BLOCK_PX, ((column + 1) << halvings) // BLOCK_PX
        for y in range(first_y, min(last_y + 1, n_rows)):
            for x in range(first_x, min(last_x + 1, n_columns)):
                if not np.isnan(levels[y, x]):
                    continue
                total, n = np.float32(0), 0
                for near_y in range(y, y + 3):  # counted from the border
                    for near_x in range(x, x + 3):
                        if not is_added[near_y, near_x]:
                            is_added[near_y, near_x] = True
                            top, left = BLOCK_PX * (near_y - 1), BLOCK_PX * (near_x - 1)
                            for v in range(max(top, 0), min(top + BLOCK_PX, height), 2):
                                for u in range(max(left, 0), min(left + BLOCK_PX, width), 2):
                                    if known[v >> halvings, u >> halvings] == INSIDE:
                                        sums[near_y, near_x] += np.float32(image[v, u])
                                        counts[near_y, near_x] += 1
                        total += sums[near_y, near_x]
                        n += counts[near_y, near_x]
                level = total / np.float32(n)
                if n == 0:
                    level = _mean_far_around(image, known, halvings, y, x)
                if np.isnan(level):  # no core far and wide: what may be body, its edge included
                    if np.isnan(typical):
                        typical = _mean_of_open(view)
                    level = typical
                levels[y, x] = level
    return levels


@compiled
def _mean_far_around(image: Grey | Array, known: Grey, halvings: int, y: int, x: int) -> np.float32:
    """Mean of the core's pixels in a sparse window around a block, NaN of none."""
    height, width = image.shape
    v, u = y * BLOCK_PX + BLOCK_PX // 2, x * BLOCK_PX + BLOCK_PX // 2
    step = FAR_PX // N_SAMPLES
    reach_px = N_SAMPLES * step
    total, n = np.float32(0), np.float32(0)
    for near_v in range(max(v - reach_px, v % step), min(v + reach_px + 1, height), step):
        for near_u in range(max(u - reach_px, u % step), min(u + reach_px + 1, width), step):
            if known[near_v >> halvings, near_u >> halvings] == INSIDE:
                total += np.float32(image[near_v, near_u])
                n += np.float32(1)
    return total / n


@compiled
def _mean_of_open(view: GreyLevels) -> np.float32:
    """Mean of what is to be decided."""
    total = np.float32(0)
    for i in range(len(view.open_cells)):
        row, column = view.open_cells[i, 0], view.open_cells[i, 1]
        total += np.float32(view.image[row << view.halvings, column << view.halvings])
    return total / np.float32(len(view.open_cells))


@compiled
def decide(view: GreyLevels, levels: Array, min_contrast: np.float32, labels: Grey) -> bool:
    """Label what is possible and not yet known (h, w); whether any of it is inside."""
    image, expected, gain, halvings = view.image, view.expected, view.gain, view.halvings
    height, width = image.shape
    is_inside = False
    for i in range(len(view.open_cells)):
        row, column = view.open_cells[i, 0], view.open_cells[i, 1]
        for v in range(row << halvings, min((row + 1) << halvings, height)):
            for u in range(column << halvings, min((column + 1) << halvings, width)):
                behind = gain * np.float32(expected[v + view.top, u + view.left])
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
    points_uv, seen = np.empty((len(pixels_uv), 2)), np.empty(len(pixels_uv), np.uint8)
    for i in range(len(pixels_uv)):
        u, v = pixels_uv[i, 0], pixels_uv[i, 1]
        within, n = 0.0, 0
        sum_u, sum_v = 0.0, 0.0
        seen[i] = 1
        for neighbour in range(-1, 4):
            x, y = u, v  # the pixel itself first
            if neighbour >= 0:
                x += (neighbour == 0) - (neighbour == 1)
                y += (neighbour == 2) - (neighbour == 3)
                if not (0 <= x < width and 0 <= y < height) or body[y, x]:
                    continue
            coverage = 1.0
            if known[y >> halvings, x >> halvings] != INSIDE:
                behind = gain * np.float32(expected[y + view.top, x + view.left])
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
            sum_u += share * (x - u)
            sum_v += share * (y - v)
            n += 1
        if n == 0:  # at the border of the region
            seen[i] = 0
        points_uv[i, 0], points_uv[i, 1] = u + sum_u / max(n, 1), v + sum_v / max(n, 1)
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
