"""A fixed, nearly uniform set of directions over half a sphere, and nearly orthogonal frames of such directions.

A body is as wide along u as along -u, so half a sphere is enough: ten faces of an icosahedron, no two
of them opposite, each split into 4^4 triangles.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.arrays import Directions, Indices32
from pipeline.geometry.icosphere import icosahedron, subdivided

SUBDIVISIONS = 4
"""Number of times that each face is split into four."""
COVERING_RAD = 0.048
"""Covering radius: every direction or its opposite is within this angle (2.75 degrees) of one of the set."""
NEARLY_RAD = 0.024
"""Largest deviation from a right angle between two axes of a coarse frame. With twice as much there are twice as
many frames and their widths tell less of those of the frames nearby: searches from them end worse."""

N_COARSEST = 93
"""Number of directions after two of the splits; frames whose axes are nearest to the same of these are neighbours."""
N_NEIGHBORS = 8
"""Number of neighbouring frames of which only the best is a start of a search."""


@dataclass(frozen=True, slots=True, eq=False)
class HalfSphere:
    """Unit directions, coarse to fine, and the triangles between them that cover half a sphere."""

    directions: Directions  # (1329, 3)
    triangles: Indices32  # (2560, 3) indices of directions
    nearby: Indices32  # (1329,) for each direction, the nearest of those before it


@cache
def half_sphere() -> HalfSphere:
    """Return the set of directions, the same object at every call."""
    corners, faces = icosahedron()
    # a plane in general position: of two opposite faces one is on either side
    upper = corners[faces].sum(axis=1) @ [0.2, 0.3, 0.9] > 0
    directions, triangles = subdivided(corners, faces[upper], SUBDIVISIONS)
    used, triangles = np.unique(triangles, return_inverse=True)
    directions = np.array(directions[used])
    nearby = np.tril(directions @ directions.T + 1, -1).argmax(axis=1)
    return HalfSphere(
        _constant(directions),
        _constant(triangles.reshape(-1, 3).astype(np.int32)),
        _constant(nearby.astype(np.int32)),
    )


@cache
def near_frames() -> NDArray[np.intp]:
    """Return frames of nearly orthogonal directions, as indices (3, `N_NEIGHBORS`, C): neighbours in each column."""
    directions = half_sphere().directions
    cosines = np.abs(directions @ directions.T)
    first, second = np.nonzero(np.triu(cosines < np.sin(NEARLY_RAD)))
    nearest = scipy.spatial.cKDTree(np.concatenate([directions, -directions]))
    _, third = nearest.query(np.cross(directions[first], directions[second]))
    frames = np.unique(np.sort([first, second, third % len(directions)], axis=0), axis=1)
    coarse = cosines[:, :N_COARSEST].argmax(axis=1)
    ordered = frames[:, np.lexsort(np.sort(coarse[frames], axis=0))]
    n_neighborhoods = -(-ordered.shape[1] // N_NEIGHBORS)
    padded = ordered[:, np.arange(N_NEIGHBORS * n_neighborhoods) % ordered.shape[1]]
    return _constant(np.ascontiguousarray(padded.reshape(3, n_neighborhoods, N_NEIGHBORS).transpose(0, 2, 1)))


def _constant(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array
