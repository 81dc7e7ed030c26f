"""Nearly uniform triangles on the unit sphere: those of an icosahedron, each split into four repeatedly."""

from itertools import product

import numpy as np
import scipy.spatial

from pipeline.arrays import Directions, Faces, Floats


def icosphere(subdivisions: int) -> tuple[Directions, Faces]:
    """Return unit vectors (N, 3) and triangles (20 4^s, 3), counter-clockwise seen from outside."""
    return subdivided(*icosahedron(), subdivisions)


def icosahedron() -> tuple[Directions, Faces]:
    """Return unit vectors (12, 3) and triangles (20, 3), counter-clockwise seen from outside."""
    golden = (1 + np.sqrt(5)) / 2
    rectangle = [(0.0, one, long) for one, long in product((-1.0, 1.0), (-golden, golden))]
    vertices = np.array([np.roll(corner, turn) for turn in range(3) for corner in rectangle])
    triangles = scipy.spatial.ConvexHull(vertices).simplices.astype(np.int64)
    is_inward = np.linalg.det(vertices[triangles]) < 0
    triangles[is_inward] = triangles[is_inward][:, ::-1]
    return _unit(vertices), triangles


def subdivided(vertices: Directions, triangles: Faces, times: int) -> tuple[Directions, Faces]:
    """Split each triangle on the unit sphere into 4^times; new vertices come after those given."""
    for _ in range(times):
        sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        edges, edge_of = np.unique(sides, axis=0, return_inverse=True)
        corners = np.column_stack([triangles, len(vertices) + edge_of.reshape(-1, 3)])
        vertices = np.concatenate([vertices, _unit(vertices[edges].sum(axis=1))])
        triangles = corners[:, [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]].reshape(-1, 3)
    return vertices, triangles


def _unit(vectors: Floats) -> Directions:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
