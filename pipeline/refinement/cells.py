"""Points sorted into cubic cells, so that those near a place are found without looking at all."""

from typing import NamedTuple

import numpy as np

from pipeline.arrays import Indices, PointsMM, Values, Vector
from pipeline.compiled import compiled, compiled_within
from pipeline.geometry.bounds import bounds


class Cells(NamedTuple):
    """Points by cell: those of cell c are `order[starts[c] : starts[c + 1]]`, and so are `sorted_mm`.

    The place of a point is its index in this order.
    """

    low_mm: Vector
    edge_mm: float
    counts: Indices  # (3,) cells along each axis
    starts: Indices
    order: Indices
    sorted_mm: PointsMM  # copies in this order: what is looked at together lies together


def sort_into_cells(points_mm: PointsMM, edge_mm: float) -> Cells:
    """Sort points (N, 3) into cells with this edge."""
    low_mm, high_mm = bounds(points_mm)
    counts = np.floor((high_mm - low_mm) / edge_mm).astype(np.int64) + 1
    starts = np.zeros(counts.prod() + 1, np.int64)
    order, sorted_mm = np.empty(len(points_mm), np.int64), np.empty((len(points_mm), 3))
    _sort(points_mm, low_mm, edge_mm, counts, starts, order, sorted_mm)
    return Cells(low_mm, edge_mm, counts, starts, order, sorted_mm)


@compiled
def _sort(
    points_mm: PointsMM,
    low_mm: Vector,
    edge_mm: float,
    counts: Indices,
    starts: Indices,
    order: Indices,
    sorted_mm: PointsMM,
) -> None:
    """Count the points of each cell, then put each point into its place: a third of the time of `np.argsort`."""
    owners = np.empty(len(points_mm), np.int64)
    for i in range(len(points_mm)):
        cell = 0
        for axis in range(3):
            cell = cell * counts[axis] + int((points_mm[i, axis] - low_mm[axis]) / edge_mm)
        owners[i] = cell
        starts[cell + 1] += 1
    for cell in range(len(starts) - 1):
        starts[cell + 1] += starts[cell]
    places = starts.copy()
    for i in range(len(points_mm)):
        place = places[owners[i]]
        places[owners[i]] += 1
        order[place] = i
        for axis in range(3):
            sorted_mm[place, axis] = points_mm[i, axis]


@compiled_within
def find_near(cells: Cells, center_mm: Vector, reach_mm: float, found: Indices, distances2: Values) -> int:
    """Fill in the places of points within a reach and their squared distances (mm2); return how many these are.

    `found` and `distances2` (N + 1,) are room for all points of the cells and one more: each point is filled in, and
    counts only if it is near, which is quicker than to ask first.
    """
    n, sorted_mm, reach2 = 0, cells.sorted_mm, reach_mm * reach_mm
    x, y, z = center_mm[0], center_mm[1], center_mm[2]
    x0, x1 = _cell_range(cells, x, 0, reach_mm)
    y0, y1 = _cell_range(cells, y, 1, reach_mm)
    z0, z1 = _cell_range(cells, z, 2, reach_mm)
    for cx in range(x0, x1 + 1):
        for cy in range(y0, y1 + 1):
            row = (cx * cells.counts[1] + cy) * cells.counts[2]
            for at in range(cells.starts[row + z0], cells.starts[row + z1 + 1]):
                d2 = (sorted_mm[at, 0] - x) ** 2 + (sorted_mm[at, 1] - y) ** 2 + (sorted_mm[at, 2] - z) ** 2
                found[n], distances2[n] = at, d2
                n += d2 < reach2
    return n


def nearest_within(points_mm: PointsMM, others_mm: PointsMM, reach_mm: float) -> Values:
    """Return the distance (N,) of each point (N, 3) to the nearest of the others (M, 3); infinite beyond the reach."""
    distances_mm = np.full(len(points_mm), np.inf)
    if len(others_mm):
        _find_nearest(points_mm, sort_into_cells(others_mm, 2 * reach_mm), reach_mm, distances_mm)
    return distances_mm


@compiled
def _find_nearest(points_mm: PointsMM, cells: Cells, reach_mm: float, distances_mm: Values) -> None:
    sorted_mm = cells.sorted_mm
    for i in range(len(points_mm)):
        x, y, z = points_mm[i, 0], points_mm[i, 1], points_mm[i, 2]
        x0, x1 = _cell_range(cells, x, 0, reach_mm)
        y0, y1 = _cell_range(cells, y, 1, reach_mm)
        z0, z1 = _cell_range(cells, z, 2, reach_mm)
        nearest2 = reach_mm * reach_mm
        for cx in range(x0, x1 + 1):
            for cy in range(y0, y1 + 1):
                row = (cx * cells.counts[1] + cy) * cells.counts[2]
                for at in range(cells.starts[row + z0], cells.starts[row + z1 + 1]):
                    d2 = (
                        (sorted_mm[at, 0] - x) ** 2
                        + (sorted_mm[at, 1] - y) ** 2
                        + (sorted_mm[at, 2] - z) ** 2
                    )
                    if d2 < nearest2:
                        nearest2, distances_mm[i] = d2, np.sqrt(d2)


@compiled_within
def _cell_range(cells: Cells, x_mm: float, axis: int, reach_mm: float) -> tuple[int, int]:
    """Return the first and the last cell along an axis that a reach around a coordinate meets."""
    first = int(np.floor((x_mm - reach_mm - cells.low_mm[axis]) / cells.edge_mm))
    last = int(np.floor((x_mm + reach_mm - cells.low_mm[axis]) / cells.edge_mm))
    return max(first, 0), min(last, cells.counts[axis] - 1)
