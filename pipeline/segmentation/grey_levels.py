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
Cells = NDArray[np.int32]

OPEN = np.uint8(64)
"""Beside INSIDE, UNKNOWN and OUTSIDE: what is to be decided."""
FINE = 2
"""Edge of the cells, in pixels, of which something is known or is to be decided."""
CELLS = 2
BLOCK_PX = CELLS * FINE
"""The body's grey level is the same for the pixels of a block of this edge: the mean of the core in it and its
eight neighbours."""
NONE, ONE = np.uint32(0), np.uint32(1 << 16)
"""In the sum of some grey levels, no pixel and one."""
FAR_PX = 32
"""Slivers too thin for a core, and edges beside the unknown, ask so far around."""
N_SAMPLES = 3
"""Every so many-th part of that reach is asked: (2 N_SAMPLES + 1)^2 pixels."""
LEAST_COVERAGE = 0.025
"""Coverages are cut off here and at one less this before their probit is taken."""


class GreyLevels(NamedTuple):
    """What decides in a region (h, w) of an image between core and possible."""

    image: Grey  # (H, W)
    left: int  # where in that the region begins
    top: int
    expected: Grey | Array  # without a body
    expected_left: int  # where in that the region begins
    expected_top: int
    gain: np.float32  # factor on `expected`
    limits: Grey  # (h / 2, w / 2) INSIDE, UNKNOWN, OUTSIDE, or OPEN
    open_ends: (
        Cells  # (2 N, 2) row and column: where a run of open ones begins, and the one after it, in turn
    )


def limits_from(core: Mask, possible: Mask, unknown: Mask) -> Grey:
    """INSIDE the core, elsewhere UNKNOWN, elsewhere OPEN if possible, else OUTSIDE: of masks (h / 2, w / 2)."""
    return np.where(core, INSIDE, np.where(unknown, UNKNOWN, np.where(possible, OPEN, OUTSIDE)))


@compiled
def spread(limits: Grey) -> tuple[Cells, NDArray[np.uint16]]:
    """The open runs of limits (h, w), and every other label twice in two rows (2 h, w)."""
    height, width = limits.shape
    twice = np.empty((2 * height, width), np.uint16)
    ends, n_ends = np.empty((height * (width + 1) + 1, 2), np.int32), 0
    # ends are few: eight cells at a time are skipped
    is_open, eights = np.zeros(width + 2, np.uint8), np.zeros(width // 8 + 1, np.uint64)
    is_end = eights.view(np.uint8)
    for row in range(height):
        here, upper, lower, within = limits[row], twice[2 * row], twice[2 * row + 1], is_open[1:]
        for column in range(width):
            within[column] = here[column] == OPEN
            label = OUTSIDE if here[column] == OPEN else here[column]
            upper[column] = lower[column] = label * np.uint16(0x0101)
        for column in range(width + 1):
            is_end[column] = is_open[column] ^ within[column]
        for eight in range(len(eights)):
            if eights[eight] == 0:
                continue
            for column in range(8 * eight, 8 * eight + 8):
                ends[n_ends, 0], ends[n_ends, 1] = row, column
                n_ends += is_end[column]
    return ends[:n_ends], twice


@compiled
def carried(view: GreyLevels) -> Array:
    """Grey level of the body in each block (h / BLOCK_PX, w / BLOCK_PX), NaN where nothing is to be decided."""
    levels = _means(view)
    typical = np.float32(np.nan)
    for i in range(0, len(view.open_ends), 2):
        row, first, last = view.open_ends[i, 0], view.open_ends[i, 1], view.open_ends[i + 1, 1]
        # the blocks of its pixels and of those next to it, between which the edge may run
        for y in range(max(row - 1, 0) // CELLS, (row + 1) // CELLS + 1):
            for x in range(max(first - 1, 0) // CELLS, last // CELLS + 1):
                if np.isnan(levels[y, x]):
                    levels[y, x] = _mean_far_around(view, y, x)
                if np.isnan(levels[y, x]):  # no core far and wide: what may be body, its edge included
                    if np.isnan(typical):
                        typical = _mean_of_open(view)
                    levels[y, x] = typical
    return levels


@compiled
def _means(view: GreyLevels) -> Array:
    """Mean grey level of the core in each block and its neighbours, NaN of none: of one pixel of each cell."""
    height, width = view.limits.shape
    n_rows, n_columns = height // CELLS + 1, width // CELLS + 1
    # number and sum in one, with a border of blocks that have none
    sums, sums_here = np.zeros((n_rows + 2, n_columns + 2), np.uint32), np.empty(CELLS * n_columns, np.uint32)
    for y in range(n_rows):
        sums_here[:] = 0
        for row in range(CELLS * y, min(CELLS * (y + 1), height)):
            pixels, limits = view.image[view.top + FINE * row, view.left :], view.limits[row]
            for u in range(width):
                sums_here[u] += ONE + pixels[FINE * u] if limits[u] == INSIDE else NONE
        block_sums = sums[y + 1, 1:]
        for x in range(n_columns):
            block_sums[x] = sums_here[CELLS * x] + sums_here[CELLS * x + 1]
    means, threes = np.empty((n_rows, n_columns), np.float32), np.empty(n_columns + 2, np.uint32)
    for y in range(n_rows):
        for x in range(n_columns + 2):
            threes[x] = sums[y, x] + sums[y + 1, x] + sums[y + 2, x]
        for x in range(n_columns):
            nine = np.uint32(threes[x] + threes[x + 1] + threes[x + 2])
            means[y, x] = np.float32(np.int32(nine % ONE)) / np.float32(np.int32(nine // ONE))
    return means


@compiled
def _mean_far_around(view: GreyLevels, y: int, x: int) -> np.float32:
    """Mean of the core's pixels in a sparse window around a block, NaN of none."""
    height, width = view.limits.shape
    v, u = y * BLOCK_PX + BLOCK_PX // 2, x * BLOCK_PX + BLOCK_PX // 2
    step = FAR_PX // N_SAMPLES
    reach_px = N_SAMPLES * step
    total, n = np.float32(0), np.float32(0)
    for near_v in range(max(v - reach_px, v % step), min(v + reach_px + 1, FINE * height), step):
        for near_u in range(max(u - reach_px, u % step), min(u + reach_px + 1, FINE * width), step):
            if view.limits[near_v // FINE, near_u // FINE] == INSIDE:
                total += np.float32(view.image[near_v + view.top, near_u + view.left])
                n += np.float32(1)
    return total / n


@compiled
def _mean_of_open(view: GreyLevels) -> np.float32:
    """Mean of what is to be decided."""
    total, n = np.float32(0), 0
    for i in range(0, len(view.open_ends), 2):
        row = FINE * view.open_ends[i, 0]
        for column in range(FINE * view.open_ends[i, 1], FINE * view.open_ends[i + 1, 1], FINE):
            total += np.float32(view.image[row + view.top, column + view.left])
            n += 1
    return total / np.float32(n)


@compiled
def decide(view: GreyLevels, levels: Array, min_contrast: np.float32, labels: Grey) -> bool:
    """Label what is open (h, w); whether any of it is inside."""
    height, width = labels.shape
    is_inside = False
    for i in range(0, len(view.open_ends), 2):
        row, first = view.open_ends[i, 0], FINE * view.open_ends[i, 1]
        last, levels_here = min(FINE * view.open_ends[i + 1, 1], width), levels[row // CELLS]
        for v in range(FINE * row, min(FINE * (row + 1), height)):
            behinds = view.expected[v + view.expected_top, first + view.expected_left :]
            pixels, here = view.image[v + view.top, first + view.left :], labels[v, first:last]
            for k in range(len(here)):
                behind = view.gain * np.float32(behinds[k])
                contrast = behind - levels_here[(first + k) // BLOCK_PX]
                covered = behind - np.float32(pixels[k])
                is_body = (covered - np.float32(0.5) * contrast) * contrast > 0
                is_unclear = abs(contrast) < min_contrast * behind
                here[k] = UNKNOWN if is_unclear else (INSIDE if is_body else OUTSIDE)
                is_inside |= is_body and not is_unclear
    return is_inside


@compiled
def crossings(
    view: GreyLevels, levels: Array, body: Grey, labels: Grey, pixels_uv: NDArray[np.int32]
) -> tuple[NDArray[np.float64], Grey]:
    """Points (N, 2): the mean crossing of the edge beside each pixel (N, 2), and whether it was seen (N,).

    Under a Gaussian blur of any width the probit of the coverage is linear across the edge.
    """
    image, expected, gain, limits = view.image, view.expected, view.gain, view.limits
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
            if limits[y // FINE, x // FINE] != INSIDE:
                behind = gain * np.float32(expected[y + view.expected_top, x + view.expected_left])
                covered = behind - np.float32(image[y + view.top, x + view.left])
                coverage = float(covered / (behind - levels[y // BLOCK_PX, x // BLOCK_PX]))
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
