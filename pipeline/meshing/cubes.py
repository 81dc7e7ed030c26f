"""Marching cubes (Lorensen and Cline 1987) over the leaves of the hull's octree, that is only where the surface is.

A leaf is a block of 4^3 samples. Each sample stands for the cube between it and the next samples, and for the
three edges of the grid that begin at it. Where such an edge is cut there is one vertex, which the four cubes
around the edge share.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Faces, Flags, Floats, Singles
from pipeline.carving import LEAF
from pipeline.compiled import compiled, compiled_within, whole
from pipeline.geometry.bounds import bounds
from pipeline.meshing.cases import CORNERS, EDGES, cube_cases

Leaves = NDArray[np.int32]
"""(L, 3) indices of each leaf's first sample."""
Cases = NDArray[np.uint8]
"""(L, `SAMPLES`) case of each cube, an index into the tables of `cube_cases`."""

SAMPLES = LEAF**3
"""Number of samples in a leaf, by rows: sample (LEAF i + j) LEAF + k is (i, j, k) from the first one."""
NO_LEAF = -16
"""Stands for the vertices of a sample (see `_place`) where there is no leaf: every row read from it is negative."""
X, Y, Z = whole(0), whole(1), whole(2)
"""Axes."""
FULL_ROW = 2 ** (LEAF + 1) - 1
"""Bits of a row of samples that are all inside, including the next leaf's first."""


def march(field: Singles, level: float, leaves: Leaves) -> tuple[Floats, Faces]:
    """Return vertices (N, 3), in samples, and faces (M, 3) of the surface where a field (nx, ny, nz) crosses `level`.

    No leaf may occur twice; beyond the field all is outside. The surface is closed, its faces are
    counter-clockwise seen from where the field is lower. Vertices and faces are in the order of the leaves.

    Raises
    ------
    ValueError
        The surface continues where there is no leaf.
    """
    table = cube_cases()
    leaves = np.ascontiguousarray(leaves)
    is_cut = np.zeros(len(leaves), np.bool_)
    cases = np.empty((len(leaves), SAMPLES), np.uint8)
    field = _padded(field, leaves)
    rows = np.empty((LEAF + 1, LEAF + 1), np.int64)
    n_vertices, n_faces = _classify(field, level, leaves, table.n_triangles, rows, is_cut, cases)
    vertices, faces = np.empty((n_vertices, 3)), np.empty((n_faces, 3), np.int64)
    if n_faces:
        leaves, cases = leaves.compress(is_cut, axis=0), cases.compress(is_cut, axis=0)
        ids = np.empty((len(leaves) + 1, SAMPLES), np.int32)
        ids[-1] = NO_LEAF
        _place(field, level, leaves, cases, vertices, ids)
        is_closed = _connect(
            cases,
            ids,
            _neighbors(leaves),
            _owners(),
            table.edges,
            table.n_edges,
            table.triangles,
            table.n_triangles,
            np.empty(len(EDGES), np.int32),
            faces,
        )
        if not is_closed:
            raise ValueError("the surface continues where there is no leaf")
    return vertices, faces


def _padded(field: Singles, leaves: Leaves) -> Singles:
    """Return the field, padded with -inf where a leaf's cubes reach beyond it."""
    beyond = np.maximum(leaves.max(axis=0, initial=0) + LEAF + 1 - field.shape, 0)
    if not beyond.any():
        return field
    return np.pad(field, [(0, n) for n in beyond], constant_values=-np.inf)


def _neighbors(leaves: Leaves) -> NDArray[np.uint32]:
    """Return the indices (L, 8) of the leaves around the upper corner of each leaf, itself first; L for none."""
    first_leaf, last_leaf = bounds(leaves)
    blocks = (leaves - first_leaf) // LEAF
    shape = tuple((last_leaf - first_leaf) // LEAF + 2)
    first = np.ravel_multi_index(tuple(blocks.T), shape)
    rows = np.full(np.prod(shape), len(leaves), np.uint32)
    rows[first] = np.arange(len(leaves), dtype=np.uint32)
    return rows[first[:, None] + np.ravel_multi_index(tuple(np.transpose(CORNERS)), shape)]


@cache
def _owners() -> NDArray[np.uint8]:
    """Return for each edge of each cube of a leaf (64, 12, 3): the leaf and sample at which it begins, and its axis.

    Leaves are told as neighbours: 4 dx + 2 dy + dz lies (dx, dy, dz) leaves further along the axes.
    """
    owners = np.empty((SAMPLES, len(EDGES), 3), np.uint8)
    for cube, first in enumerate(np.ndindex((LEAF,) * 3)):
        for edge, (begin, end) in enumerate(EDGES):
            leaf, sample = np.divmod(np.add(first, CORNERS[begin]), LEAF)
            axis = np.argmax(np.subtract(CORNERS[end], CORNERS[begin]))
            owners[cube, edge] = leaf @ (4, 2, 1), np.ravel_multi_index(sample, (LEAF,) * 3), axis
    return owners


@compiled
def _classify(
    field: Singles,
    level: float,
    leaves: Leaves,
    n_triangles: NDArray[np.uint8],
    rows: NDArray[np.int64],
    is_cut: Flags,
    cases: Cases,
) -> tuple[int, int]:
    """Set which leaves the surface cuts and the cases of their cubes; return the numbers of vertices and faces.

    `rows` (LEAF + 1, LEAF + 1) is a work array.
    """
    n_vertices = n_faces = 0
    for leaf in range(len(leaves)):
        x, y, z = leaves[leaf, 0], leaves[leaf, 1], leaves[leaf, 2]
        some, every = 0, FULL_ROW
        for i in range(LEAF + 1):
            for j in range(LEAF + 1):
                row = 0
                for k in range(LEAF + 1):
                    row |= int(field[x + i, y + j, z + k] > level) << k
                rows[i, j] = row  # bit k: sample i, j, k of the leaf is inside
                some |= row
                every &= row
        if some == 0 or every == FULL_ROW:
            continue
        is_cut[leaf] = True
        for i in range(LEAF):
            for j in range(LEAF):
                for k in range(LEAF):
                    case = (
                        (rows[i, j] >> k & 3)
                        | (rows[i, j + 1] >> k & 3) << 2
                        | (rows[i + 1, j] >> k & 3) << 4
                        | (rows[i + 1, j + 1] >> k & 3) << 6
                    )
                    cases[leaf, (LEAF * i + j) * LEAF + k] = case
                    n_vertices += _is_cut(case, X) + _is_cut(case, Y) + _is_cut(case, Z)
                    n_faces += n_triangles[case]
    return n_vertices, n_faces


@compiled_within
def _is_cut(case: int, axis: int) -> int:
    """Return 1 if the edge along an axis from a cube's first corner is cut, else 0."""
    return (case ^ case >> (4 >> axis)) & 1


@compiled
def _place(
    field: Singles, level: float, leaves: Leaves, cases: Cases, vertices: Floats, ids: NDArray[np.int32]
) -> None:
    """Set the vertices (N, 3), in samples, and where to find those of each sample.

    The vertices on the edges that begin at a sample follow one another in the order of the axes. Its `ids` (L, 64) is
    4 n + cut: n is the index of the first of them, the bits of `cut` tell whether there is one along x and along y.
    Samples without vertices are left as they are.
    """
    n = 0
    for leaf in range(len(leaves)):
        for sample in range(SAMPLES):
            case = cases[leaf, sample]
            if case == 0 or case == 255:
                continue
            x = leaves[leaf, 0] + sample // LEAF**2
            y = leaves[leaf, 1] + sample // LEAF % LEAF
            z = leaves[leaf, 2] + sample % LEAF
            here = float(field[x, y, z])
            ids[leaf, sample] = 4 * n + _is_cut(case, X) + 2 * _is_cut(case, Y)
            for axis in range(3):
                if _is_cut(case, axis):
                    there = float(field[x + (axis == 0), y + (axis == 1), z + (axis == 2)])
                    vertices[n, 0], vertices[n, 1], vertices[n, 2] = x, y, z
                    vertices[n, axis] += (level - here) / (there - here)
                    n += 1


@compiled
def _connect(
    cases: Cases,
    ids: NDArray[np.int32],
    neighbors: NDArray[np.uint32],
    owners: NDArray[np.uint8],
    edges: NDArray[np.uint8],
    n_edges: NDArray[np.uint8],
    triangles: NDArray[np.uint8],
    n_triangles: NDArray[np.uint8],
    vertex_on: NDArray[np.int32],
    faces: Faces,
) -> bool:
    """Set the faces (M, 3); return whether all their vertices exist.

    `vertex_on` (12,) is a work array for the vertices on a cube's edges.
    """
    n = lowest = 0
    for leaf in range(len(cases)):
        for cube in range(SAMPLES):
            case = cases[leaf, cube]
            for k in range(n_edges[case]):
                edge = edges[case, k]
                own = ids[neighbors[leaf, owners[cube, edge, 0]], owners[cube, edge, 1]]
                axis = owners[cube, edge, 2]
                vertex = (own >> 2) + (axis > 0) * (own & 1) + (axis > 1) * (own >> 1 & 1)
                lowest = min(lowest, vertex)
                vertex_on[edge] = vertex
            for triangle in range(n_triangles[case]):
                for corner in range(3):
                    faces[n, corner] = vertex_on[triangles[case, triangle, corner]]
                n += 1
    return lowest >= 0
