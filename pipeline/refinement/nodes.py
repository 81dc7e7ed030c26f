"""Nodes: points of the surface, evenly spread, each with a normal, a tangent frame and its neighbours."""

from typing import Annotated, NamedTuple, TypeVar

import numpy as np

from pipeline.arrays import (
    Directions,
    Faces,
    Flags,
    Floats,
    Indices,
    Indices32,
    PointsMM,
    Singles,
    Vector,
)
from pipeline.compiled import compiled, compiled_within
from pipeline.refinement.cells import Cells, find_near, sort_into_cells

MAX_NEIGHBOURS = 8
SAME_SIDE = 0.2
"""Least cosine between the normals of two points of one side: less is the other side of a thin place."""
OTHER_SIDE = -0.7
"""Cosine between the normals of two sides of a thin place; between it and `SAME_SIDE` it is those of an edge."""
EDGE_WITHIN = 1.5
"""Reach for a node beyond an edge, in spacings: the patch of the one is then also on the face of the other."""
REACH_SDS = 2.8
"""Reach of an interpolation, in standard deviations of its Gaussian."""
NEIGHBOURS_WITHIN = 2.0
"""Reach for neighbours, in spacings."""
CELL = 2.0
"""Edge of the cells that points are sorted into, in spacings: of smaller ones most are empty."""
Reals = TypeVar("Reals", Floats, Singles)


class Nodes(NamedTuple):
    """K nodes on the surface of the mesh."""

    chosen: Indices  # (K,) of the points that they were chosen from
    points_mm: PointsMM
    normals: Directions  # outward
    neighbours: Indices32  # (K, MAX_NEIGHBOURS) nearest first, -1 beyond the last
    spacing_mm: float
    at_edge: Flags  # (K,) whether another lies beyond a sharp convex edge, too far turned for a neighbour


def vertex_normals(vertices_mm: PointsMM, faces: Faces) -> Directions:
    """Return outward unit normals (V, 3), faces weighted by their area."""
    normals = np.zeros_like(vertices_mm)
    _add_normals(vertices_mm, faces, normals)
    return normals


@compiled
def _add_normals(points_mm: PointsMM, faces: Faces, normals: Directions) -> None:
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ux, uy, uz = (
            points_mm[b, 0] - points_mm[a, 0],
            points_mm[b, 1] - points_mm[a, 1],
            points_mm[b, 2] - points_mm[a, 2],
        )
        wx, wy, wz = (
            points_mm[c, 0] - points_mm[a, 0],
            points_mm[c, 1] - points_mm[a, 1],
            points_mm[c, 2] - points_mm[a, 2],
        )
        x, y, z = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        for corner in (a, b, c):
            normals[corner, 0] += x
            normals[corner, 1] += y
            normals[corner, 2] += z
    for i in range(len(normals)):
        length = np.sqrt(normals[i, 0] ** 2 + normals[i, 1] ** 2 + normals[i, 2] ** 2)
        for k in range(3):
            normals[i, k] /= max(length, 1e-12)


def spread_nodes(
    points_mm: PointsMM, normals: Directions, spacing_mm: float, order: Indices | None = None
) -> Nodes:
    """Choose points (N, 3) no two of which are nearer than the spacing, as many as there is room for.

    They are taken in `order` (N,), or as they come; of two on opposite sides of a thin place both may be nodes.
    """
    cells = sort_into_cells(points_mm, CELL * spacing_mm)
    chosen, places = np.empty((2, len(points_mm)), np.int64)
    places[cells.order] = np.arange(len(points_mm))
    places = places if order is None else places[order]
    chosen = np.sort(chosen[: _choose(normals[cells.order], places, cells, spacing_mm, chosen)])
    nodes_mm = np.ascontiguousarray(points_mm[chosen])
    node_normals = np.ascontiguousarray(normals[chosen])
    neighbours = np.full((len(chosen), MAX_NEIGHBOURS), -1, np.int32)
    at_edge = np.zeros(len(chosen), np.bool_)
    cells = sort_into_cells(nodes_mm, CELL * spacing_mm)
    _link(node_normals[cells.order], cells, spacing_mm, neighbours, at_edge)
    return Nodes(chosen, nodes_mm, node_normals, neighbours, spacing_mm, at_edge)


def of_nodes(nodes: Nodes, chosen: Flags) -> Nodes:
    """Return some of the nodes, chosen by flags (K,), alone: neighbours of each are those of them that it had."""
    numbers = np.full(len(chosen) + 1, -1, np.int32)
    numbers[:-1][chosen] = np.arange(np.count_nonzero(chosen))
    return nodes._replace(
        chosen=nodes.chosen[chosen],
        points_mm=nodes.points_mm[chosen],
        normals=nodes.normals[chosen],
        neighbours=numbers[nodes.neighbours[chosen]],
        at_edge=nodes.at_edge[chosen],
    )


def widened(flags: Flags, nodes: Nodes) -> Flags:
    """Return the flags (K,) of all nodes that are flagged, or a neighbour of which is."""
    return np.asarray(flags | (flags[nodes.neighbours] & (nodes.neighbours >= 0)).any(axis=1))


def smoothed(nodes: Nodes, values: Reals, n_rounds: int) -> Reals:
    """Return values (K, ...), each the mean of a node's own and its neighbours', smoothed so many times."""
    if values.ndim == 1:
        return _smoothed(values, nodes.neighbours, n_rounds)
    means = np.ascontiguousarray(values).reshape(len(values), -1)
    for _ in range(n_rounds):
        means = _mean_around(means, nodes.neighbours)
    return means.reshape(values.shape)


@compiled
def _smoothed(values: Reals, neighbours: Indices32, n_rounds: int) -> Reals:
    """Return values (K,) smoothed in all rounds; a last one, always 0, is added where a node has no neighbour."""
    n_nodes = len(values)
    links, counts = np.empty(neighbours.shape, np.uint32), np.ones(n_nodes)
    for i in range(n_nodes):
        for k in range(MAX_NEIGHBOURS):
            j = neighbours[i, k]
            links[i, k] = j if j >= 0 else n_nodes
            counts[i] += j >= 0
    means, before = np.zeros(n_nodes + 1, values.dtype), np.zeros(n_nodes + 1, values.dtype)
    means[:n_nodes] = values
    for _ in range(n_rounds):
        means, before = before, means
        for i in range(n_nodes):
            total = before[i]
            for k in range(MAX_NEIGHBOURS):
                total += before[links[i, k]]
            means[i] = total / counts[i]
    return means[:n_nodes]


@compiled
def _mean_around(values: Annotated[Reals, "(K, C)"], neighbours: Indices32) -> Annotated[Reals, "(K, C)"]:
    means = values.copy()
    for i in range(len(values)):
        n = 1
        for k in range(MAX_NEIGHBOURS):
            j = neighbours[i, k]
            if j >= 0:
                n += 1
                for column in range(values.shape[1]):
                    means[i, column] += values[j, column]
        for column in range(values.shape[1]):
            means[i, column] /= n
    return means


@compiled
def _choose(normals: Directions, places: Indices, cells: Cells, spacing_mm: float, chosen: Indices) -> int:
    """Fill in the chosen points, taken by their places in the cells; normals are in the cells' order."""
    n_chosen, is_free = 0, np.ones(len(places), np.bool_)
    near, distances2 = np.empty(len(places) + 1, np.int64), np.empty(len(places) + 1)
    for place in places:
        if not is_free[place]:
            continue
        chosen[n_chosen] = cells.order[place]
        n_chosen += 1
        for at in range(find_near(cells, cells.sorted_mm[place], spacing_mm, near, distances2)):
            if cosine(normals[place], normals[near[at]]) > SAME_SIDE:
                is_free[near[at]] = False
        is_free[place] = False
    return n_chosen


@compiled
def _link(
    normals: Directions, cells: Cells, spacing_mm: float, neighbours: Indices32, at_edge: Flags
) -> None:
    """Fill in the nearest nodes of each, and which of them have one beyond an edge; normals are in the cells' order."""
    points_mm, n_nodes = cells.sorted_mm, len(normals)
    near, distances2 = np.empty(n_nodes + 1, np.int64), np.empty(n_nodes + 1)
    nearest2 = np.empty(MAX_NEIGHBOURS)
    for place in range(n_nodes):
        i, n = cells.order[place], 0
        for at in range(find_near(cells, points_mm[place], NEIGHBOURS_WITHIN * spacing_mm, near, distances2)):
            other, d2 = near[at], distances2[at]
            if other == place:
                continue
            if cosine(normals[place], normals[other]) <= SAME_SIDE:
                if d2 <= (EDGE_WITHIN * spacing_mm) ** 2 and _has_edge_between(
                    points_mm, normals, place, other
                ):
                    at_edge[i] = True
                continue
            if n == MAX_NEIGHBOURS and d2 >= nearest2[n - 1]:
                continue
            rank = min(n, MAX_NEIGHBOURS - 1)
            while rank > 0 and nearest2[rank - 1] > d2:
                nearest2[rank] = nearest2[rank - 1]
                neighbours[i, rank] = neighbours[i, rank - 1]
                rank -= 1
            nearest2[rank] = d2
            neighbours[i, rank] = cells.order[other]
            n = min(n + 1, MAX_NEIGHBOURS)


@compiled_within
def _has_edge_between(points_mm: PointsMM, normals: Directions, i: int, j: int) -> bool:
    """True when two nodes are on faces that meet in a convex edge: each below the plane of the other."""
    offset_mm = points_mm[j] - points_mm[i]
    is_convex = offset_mm @ normals[i] < 0 < offset_mm @ normals[j]
    return is_convex and cosine(normals[i], normals[j]) > OTHER_SIDE


@compiled_within
def cosine(one: Vector, other: Vector) -> float:
    """Return the cosine of the angle between two unit vectors."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def interpolated(
    points_mm: PointsMM,
    normals: Directions,
    nodes: Nodes,
    values: Annotated[Floats, "(K, C)"],
    weights: Annotated[Floats, "(K,)"],
    sd_mm: float,
) -> Annotated[Floats, "(N, C)"]:
    """Return values at points of the surface (N, 3): means of those of the nodes around, by weight and a Gaussian."""
    cells = sort_into_cells(nodes.points_mm, REACH_SDS * sd_mm)
    rows = np.column_stack([nodes.normals, weights, values])[cells.order]
    found = np.zeros((len(points_mm), values.shape[1]))
    _interpolate(points_mm, normals, rows, cells, sd_mm, found)
    return found


@compiled
def _interpolate(
    points_mm: PointsMM,
    normals: Directions,
    rows: Annotated[Floats, "(K, 4 + C)"],
    cells: Cells,
    sd_mm: float,
    found: Floats,
) -> None:
    """Fill in the means of what nodes, in the cells' order, have behind their normal and their weight."""
    reach_mm = REACH_SDS * sd_mm
    near, distances2 = np.empty(len(rows) + 1, np.int64), np.empty(len(rows) + 1)
    for i in range(len(points_mm)):
        total, x, y, z = 0.0, normals[i, 0], normals[i, 1], normals[i, 2]
        for at in range(find_near(cells, points_mm[i], reach_mm, near, distances2)):
            j = near[at]
            # falls to zero at the reach, as (1 - d2 / reach2)^3: a Gaussian without its cost
            fall = 1 - distances2[at] / (reach_mm * reach_mm)
            cosine = x * rows[j, 0] + y * rows[j, 1] + z * rows[j, 2]
            weight = rows[j, 3] * max(cosine, 0.0) * fall * fall * fall
            total += weight
            for column in range(found.shape[1]):
                found[i, column] += weight * rows[j, 4 + column]
        if total > 0:
            for column in range(found.shape[1]):
                found[i, column] /= total
