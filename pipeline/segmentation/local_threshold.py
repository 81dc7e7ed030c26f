"""Grey levels beside a body's edge: its own, carried outwards from the core, and what they say of each pixel.

Only the cells between core and possible are visited, and the levels of the blocks around them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled, compiled_within, whole
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

OPEN = np.uint8(64)
"""Beside INSIDE, UNKNOWN and OUTSIDE: what is to be decided."""
FINE = 2
"""Edge of the cells, in pixels, of which something is known or is to be decided."""
CELLS = 2
BLOCK_PX = CELLS * FINE
"""The body's grey level is the same for the pixels of a block of this edge: the mean of the core in it and its
eight neighbours."""
NOT_ASKED = np.float32(-1)
"""The level of a block that nothing is decided beside."""
FAR, FAR_STEP = 15, whole(5)
"""Slivers too thin for a core, and edges beside the unknown, ask so many cells around, every so many-th of them."""
FIRST, EACH = whole(0), whole(1)
LEAST_COVERAGE = 0.025
"""Coverages are cut off here and at one less this before their probit is taken."""


class GreyLevels(NamedTuple):
    """What decides in a region of an image between core and possible."""

    image: Grey  # (h, w)
    expected: Grey  # (h, w) without a body
    gain: np.float32  # factor on `expected`
    limits: Grey  # (h / 2, w / 2) of cells, rounded up: INSIDE, UNKNOWN, OUTSIDE, or OPEN


def limits_from(core: Mask, possible: Mask, unknown: Mask) -> Grey:
    """INSIDE the core, elsewhere UNKNOWN, elsewhere OPEN if possible, else OUTSIDE: of masks (h / 2, w / 2)."""
    return np.where(core, INSIDE, np.where(unknown, UNKNOWN, np.where(possible, OPEN, OUTSIDE)))


def decided(view: GreyLevels, min_contrast: float) -> tuple[Grey, Array, bool]:
    """Labels (h, w), levels of the body in blocks (h / 4, w / 4), and whether anything is inside.

    Where the body's contrast is less than a share of what is expected, pixels are unknown.
    """
    height, width = view.image.shape
    n_rows, n_columns = view.limits.shape
    twice = np.empty((FINE * n_rows, n_columns), np.uint16)
    levels = np.empty((n_rows // CELLS + 1, n_columns // CELLS + 1), np.float32)
    eights = np.zeros(n_columns // 8 + 1, np.uint64)
    labels, is_open = twice.view(np.uint8), eights.view(np.uint8)
    is_inside = _decide(view, np.float32(min_contrast), levels, twice, labels, eights, is_open)
    return np.ascontiguousarray(labels[:height, :width]), levels, is_inside or bool(INSIDE in view.limits)


@compiled
def _decide(
    view: GreyLevels,
    min_contrast: np.float32,
    levels: Array,
    twice: NDArray[np.uint16],
    labels: Grey,
    eights: NDArray[np.uint64],
    is_open: Grey,
) -> bool:
    """Label cells (h, w); whether any that is open is inside.

    The levels of the blocks of what is open are found, and of those next to them, between which the edge may run.

    Parameters
    ----------
    twice, labels
        (2 h, w) and (2 h, 2 w): the same memory, two labels at a time and one.
    eights, is_open
        Zeros for the cells of a row: the same memory, eight at a time and one. Few are open.
    """
    image, expected, limits = view.image, view.expected, view.limits
    height, width = image.shape
    n_rows, n_columns = limits.shape
    open_columns = np.empty(n_columns + 8, np.int64)
    typical, is_inside = NOT_ASKED, False
    for y in range(len(levels)):
        for x in range(len(levels[0])):
            levels[y, x] = NOT_ASKED
    for row in range(n_rows):
        here, upper, lower = limits[row], twice[FINE * row], twice[FINE * row + 1]
        for column in range(n_columns):  # vectorized, but only one after the other
            upper[column] = here[column] * np.uint16(0x0101)
        for column in range(n_columns):
            lower[column] = upper[column]
        n_open, first_y = 0, max(row - 1, 0) // CELLS
        for column in range(n_columns):
            is_open[column] = here[column] == OPEN
        for eight in range(len(eights)):
            if eights[eight] != 0:
                for column in range(8 * eight, 8 * eight + 8):
                    open_columns[n_open] = column
                    n_open += is_open[column]
        for i in range(n_open):
            column = open_columns[i]
            for y in range(first_y, (row + 1) // CELLS + 1):
                for x in range(max(column - 1, 0) // CELLS, (column + 1) // CELLS + 1):
                    if levels[y, x] == NOT_ASKED:
                        levels[y, x] = _level(image, limits, y, x)
                        if np.isnan(levels[y, x]):  # no core far and wide: what may be body, edge included
                            if typical == NOT_ASKED:
                                typical = _mean(image, limits, OPEN, FIRST, FIRST, height, width, EACH)
                            levels[y, x] = typical
            level = levels[row // CELLS, column // CELLS]
            for place in range(FINE * FINE):  # as many in each cell: a loop that is unrolled
                # those beyond the border are in it once more
                v = min(FINE * row + place // FINE, height - 1)
                u = min(FINE * column + place % FINE, width - 1)
                behind = view.gain * np.float32(expected[v, u])
                contrast = behind - level
                covered = behind - np.float32(image[v, u])
                is_body = (covered - np.float32(0.5) * contrast) * contrast > 0
                is_clear = abs(contrast) >= min_contrast * behind
                label = INSIDE if is_body else OUTSIDE
                labels[v, u] = label if is_clear else UNKNOWN
                is_inside |= is_body & is_clear
    return is_inside


@compiled_within
def _level(image: Grey, limits: Grey, y: int, x: int) -> np.float32:
    """Grey level of the body in a block: of the core near it, or else far; NaN of none."""
    row, column, end = CELLS * y, CELLS * x, 2 * CELLS
    level = _mean(image, limits, INSIDE, row - CELLS, column - CELLS, row + end, column + end, EACH)
    if np.isnan(level):
        row, column, end = row + CELLS // 2, column + CELLS // 2, FAR + 1
        level = _mean(image, limits, INSIDE, row - FAR, column - FAR, row + end, column + end, FAR_STEP)
    return level


@compiled_within
def _mean(
    image: Grey, limits: Grey, limit: np.uint8, top: int, left: int, bottom: int, right: int, step: int
) -> np.float32:
    """Mean grey level of the cells that have a limit, of every so many-th in a window; NaN of none."""
    while top < 0:
        top += step
    while left < 0:
        left += step
    bottom, right = min(bottom, limits.shape[0]), min(right, limits.shape[1])
    total = n = 0
    row = top
    while row < bottom:  # a range of unknown step costs a division
        limits_here, pixels = limits[row], image[FINE * row]
        column = left
        while column < right:
            if limits_here[column] == limit:
                total += pixels[FINE * column]
                n += 1
            column += step
        row += step
    return np.float32(total) / np.float32(n)


@compiled
def cross(
    view: GreyLevels,
    levels: Array,
    body: Grey,
    labels: Grey,
    pixels_uv: NDArray[np.int32],
    points_uv: NDArray[np.float64],
    seen: Grey,
) -> None:
    """Write points (N, 2): the mean crossing of the edge beside each pixel (N, 2), and whether it was seen (N,).

    Under a Gaussian blur of any width the probit of the coverage is linear across the edge.
    """
    height, width = body.shape
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
            if view.limits[y // FINE, x // FINE] != INSIDE:
                behind = view.gain * np.float32(view.expected[y, x])
                covered = behind - np.float32(view.image[y, x])
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


@compiled_within
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
