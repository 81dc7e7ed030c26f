"""A fixed, nearly uniform set of directions over half a sphere, and the frames that can be made of them.

A body is as wide along u as along -u, so half a sphere is enough: ten faces of an icosahedron, no two
of them opposite, each split into 4^4 triangles.
"""

from functools import cache
from typing import Any

import numpy as np
import scipy.spatial
import trimesh
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

SUBDIVISIONS = 4
COVERING_RAD = 0.048
"""No direction is farther than this (2.75 degrees) from the nearest of the set or from its opposite."""


@cache
def half_sphere() -> tuple[Array, Indices]:
    """Unit directions (1329, 3) and the triangles (2560, 3) between them, which cover half a sphere."""
    icosahedron = trimesh.creation.icosahedron()
    # a plane in general position: of two opposite faces one is on either side
    upper = icosahedron.triangles_center @ [0.2, 0.3, 0.9] > 0
    directions, triangles = icosahedron.vertices, icosahedron.faces[upper]
    for _ in range(SUBDIVISIONS):
        directions, triangles = trimesh.remesh.subdivide(directions, triangles)
        directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    used, triangles = np.unique(triangles, return_inverse=True)
    return _constant(np.asarray(directions[used])), _constant(triangles.reshape(-1, 3))


@cache
def near_frames() -> Indices:
    """Triples (F, 3) of indices of directions which are orthogonal within the spacing of the set.

    Every orthonormal frame has a triple whose first two directions are within `COVERING_RAD` of two
    of its axes.
    """
    directions, _ = half_sphere()
    limit = np.sin(2 * COVERING_RAD)
    first, second = np.nonzero(np.triu(np.abs(directions @ directions.T) < limit))
    nearest = scipy.spatial.cKDTree(np.concatenate([directions, -directions]))
    _, third = nearest.query(np.cross(directions[first], directions[second]))
    return _constant(np.column_stack([first, second, third % len(directions)]))


def _constant(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array
