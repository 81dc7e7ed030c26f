"""Local thresholding of a body, half-way between its grey level and the background's, and the crossings of its edge.

The body's level is extrapolated outwards from its core. Only the open cells of the trimap are visited, and the
blocks around them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatImage, GreyImage, Mask, PointsUV
from pipeline.compiled import compiled, compiled_within, whole
from pipeline.segmentation.silhouette import INSIDE, OUTSIDE, UNKNOWN

OPEN = np.uint8(64)
"""State of a trimap's cell, beside INSIDE, UNKNOWN and OUTSIDE: grey levels decide."""
CELL_PX = 2
"""Edge of a trimap's cells."""
CELLS_PER_BLOCK = 2
BLOCK_PX = CELLS_PER_BLOCK * CELL_PX
"""Edge of the blocks within which the body's grey level is constant: the mean of the core in the block and its eight
neighbours."""
NOT_COMPUTED = np.float32(-1)
"""Level of a block without an open cell beside it."""
FAR_CELLS, FAR_STEP = 15, whole(5)
"""Half width of the window, and step in it, from which slivers too thin for a core, and edges beside unknown cells,
take the body's level; in cells."""
ZERO, ONE = whole(0), whole(1)
MIN_COVERAGE = 0.025
"""Coverages are clipped to this and to one less this before their probit is taken."""


class RegionLevels(NamedTuple):
    """A region of an image, what it would show without the body, and where grey levels decide."""

    image: GreyImage  # (h, w)
    expected: GreyImage  # (h, w) without a body
    gain: np.float32  # factor on `expected`
    trimap: GreyImage  # (h / 2, w / 2) of cells, rounded up: INSIDE, UNKNOWN, OUTSIDE, or OPEN


def trimap_of(core: Mask, possible: Mask, unknown: Mask) -> GreyImage:
    """Return the trimap of masks (h / 2, w / 2): INSIDE the core, else UNKNOWN, else OPEN if possible, else OUTSIDE."""
    return np.where(core, INSIDE, np.where(unknown, UNKNOWN, np.where(possible, OPEN, OUTSIDE)))


def threshold(region: RegionLevels, min_contrast: float) -> tuple[GreyImage, FloatImage, bool]:
    """Return labels (h, w), levels of the body in blocks (h / 4, w / 4), and whether anything is inside.

    Where the body's contrast is less than `min_contrast`, a share of what is expected, pixels are unknown.
    """
    height, width = region.image.shape
    n_rows, n_columns = region.trimap.shape
    twice = np.empty((CELL_PX * n_rows, n_columns), np.uint16)
    levels = np.empty((n_rows // CELLS_PER_BLOCK + 1, n_columns // CELLS_PER_BLOCK + 1), np.float32)
    eights = np.zeros(n_columns // 8 + 1, np.uint64)
    labels, is_open = twice.view(np.uint8), eights.view(np.uint8)
    is_inside = _label_cells(region, np.float32(min_contrast), levels, twice, labels, eights, is_open)
    return np.ascontiguousarray(labels[:height, :width]), levels, is_inside or bool(INSIDE in region.trimap)


@compiled
def _label_cells(
    region: RegionLevels,
    min_contrast: np.float32,
    levels: FloatImage,
    twice: NDArray[np.uint16],
    labels: GreyImage,
    eights: NDArray[np.uint64],
    is_open: GreyImage,
) -> bool:
    """Label the pixels of all cells (h, w); return whether any in an open one is inside.

    Levels are computed for the blocks of open cells, and for those next to them, between which the edge may run.

    Parameters
    ----------
    twice, labels
        (2 h, w) and (2 h, 2 w): the same memory, two labels at a time and one.
    eights, is_open
        Zeros for the cells of a row: the same memory, eight at a time and one. Few are open.
    """
    image, expected, trimap = region.image, region.expected, region.trimap
    height, width = image.shape
    n_rows, n_columns = trimap.shape
    open_columns = np.empty(n_columns + 8, np.int64)
    typical, is_inside = NOT_COMPUTED, False
    for y in range(len(levels)):
        for x in range(len(levels[0])):
            levels[y, x] = NOT_COMPUTED
    for row in range(n_rows):
        here, upper, lower = trimap[row], twice[CELL_PX * row], twice[CELL_PX * row + 1]
        for column in range(n_columns):  # two loops: each is vectorized
            upper[column] = here[column] * np.uint16(0x0101)
        for column in range(n_columns):
            lower[column] = upper[column]
        n_open, first_y = 0, max(row - 1, 0) // CELLS_PER_BLOCK
        for column in range(n_columns):
            is_open[column] = here[column] == OPEN
        for eight in range(len(eights)):
            if eights[eight] != 0:
                for column in range(8 * eight, 8 * eight + 8):
                    open_columns[n_open] = column
                    n_open += is_open[column]
        for i in range(n_open):
            column = open_columns[i]
            for y in range(first_y, (row + 1) // CELLS_PER_BLOCK + 1):
                for x in range(max(column - 1, 0) // CELLS_PER_BLOCK, (column + 1) // CELLS_PER_BLOCK + 1):
                    if levels[y, x] == NOT_COMPUTED:
                        levels[y, x] = _level(image, trimap, y, x)
                        if np.isnan(
                            levels[y, x]
                        ):  # no core nearby: the mean of all that is open, edge included
                            if typical == NOT_COMPUTED:
                                typical = _mean(image, trimap, OPEN, ZERO, ZERO, height, width, ONE)
                            levels[y, x] = typical
            level = levels[row // CELLS_PER_BLOCK, column // CELLS_PER_BLOCK]
            for place in range(CELL_PX * CELL_PX):  # as many in each cell: a loop that is unrolled
                # pixels beyond the border repeat it
                v = min(CELL_PX * row + place // CELL_PX, height - 1)
                u = min(CELL_PX * column + place % CELL_PX, width - 1)
                background = region.gain * np.float32(expected[v, u])
                contrast = background - level
                covered = background - np.float32(image[v, u])
                is_body = (covered - np.float32(0.5) * contrast) * contrast > 0
                is_clear = abs(contrast) >= min_contrast * background
                label = INSIDE if is_body else OUTSIDE
                labels[v, u] = label if is_clear else UNKNOWN
                is_inside |= is_body & is_clear
    return is_inside


@compiled_within
def _level(image: GreyImage, trimap: GreyImage, y: int, x: int) -> np.float32:
    """Return the grey level of the body in a block, from the core near it or else further away; NaN without a core."""
    row, column, end = CELLS_PER_BLOCK * y, CELLS_PER_BLOCK * x, 2 * CELLS_PER_BLOCK
    level = _mean(
        image, trimap, INSIDE, row - CELLS_PER_BLOCK, column - CELLS_PER_BLOCK, row + end, column + end, ONE
    )
    if np.isnan(level):
        row, column, end = row + CELLS_PER_BLOCK // 2, column + CELLS_PER_BLOCK // 2, FAR_CELLS + 1
        level = _mean(
            image, trimap, INSIDE, row - FAR_CELLS, column - FAR_CELLS, row + end, column + end, FAR_STEP
        )
    return level


@compiled_within
def _mean(
    image: GreyImage,
    trimap: GreyImage,
    state: np.uint8,
    top: int,
    left: int,
    bottom: int,
    right: int,
    step: int,
) -> np.float32:
    """Return the mean grey level of the cells in a state, of every `step`-th in a window; NaN if there is none."""
    while top < 0:
        top += step
    while left < 0:
        left += step
    bottom, right = min(bottom, trimap.shape[0]), min(right, trimap.shape[1])
    total = n = 0
    row = top
    while row < bottom:  # a range of unknown step costs a division
        states, pixels = trimap[row], image[CELL_PX * row]
        column = left
        while column < right:
            if states[column] == state:
                total += pixels[CELL_PX * column]
                n += 1
            column += step
        row += step
    return np.float32(total) / np.float32(n)


@compiled
def find_crossings(
    region: RegionLevels,
    levels: FloatImage,
    body: GreyImage,
    labels: GreyImage,
    pixels_uv: NDArray[np.int32],
    points_uv: PointsUV,
    seen: GreyImage,
) -> None:
    """Write the mean crossing of the edge beside each of `pixels_uv` (N, 2) into `points_uv`, and whether it is `seen`.

    The crossing is interpolated between neighbouring pixels in the probit of their coverage, which is linear across
    the edge under a Gaussian blur of any width.
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
            if region.trimap[y // CELL_PX, x // CELL_PX] != INSIDE:
                background = region.gain * np.float32(region.expected[y, x])
                covered = background - np.float32(region.image[y, x])
                coverage = float(covered / (background - levels[y // BLOCK_PX, x // BLOCK_PX]))
            probit = _probit(min(max(coverage, MIN_COVERAGE), 1 - MIN_COVERAGE))
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
        if n == 0:  # no neighbour outside the body: at the border of the region
            seen[i] = 0
        points_uv[i, 0], points_uv[i, 1] = u + sum_u / max(n, 1), v + sum_v / max(n, 1)


@compiled_within
def _probit(coverage: float) -> float:
    """Return the normal quantile of 0.025..0.975, by the central part of P. J. Acklam's approximation (1e-8)."""
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
