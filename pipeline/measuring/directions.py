"""A fixed, nearly uniform set of directions over half a sphere, and the frames that can be made of them.

A body is as wide along u as along -u, so half a sphere is enough: ten faces of an icosahedron, no two
of them opposite, each split into 4^4 triangles.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.geometry.icosphere import icosahedron, subdivided

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

SUBDIVISIONS = 4
COVERING_RAD = 0.048
"""No direction is farther than this (2.75 degrees) from the nearest of the set or from its opposite."""
NEARLY_RAD = 0.024
"""Directions that are so nearly orthogonal can be the axes of a coarse frame. With twice as much there are twice as
many frames and their widths tell less of those of the frames nearby: searches from them end worse."""

N_COARSEST = 93
"""Directions after two of the splits; frames are neighbours whose axes are nearest to the same of these."""
HOOD = 8
"""Neighbours among which the best is looked for."""


@dataclass(frozen=True, slots=True, eq=False)
class HalfSphere:
    """Unit directions, coarse to fine."""

    directions: Array  # (1329, 3)
    triangles: Indices  # (2560, 3) between directions; they cover half a sphere
    nearby: Indices  # (1329,) the nearest of the directions before each


@cache
def half_sphere() -> HalfSphere:
    """The set of directions."""
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
    """Frames of three directions (3, `HOOD`, C), nearly orthogonal, by their indices; those of a column are near."""
    directions = half_sphere().directions
    cosines = np.abs(directions @ directions.T)
    first, second = np.nonzero(np.triu(cosines < np.sin(NEARLY_RAD)))
    nearest = scipy.spatial.cKDTree(np.concatenate([directions, -directions]))
    _, third = nearest.query(np.cross(directions[first], directions[second]))
    frames = np.unique(np.sort([first, second, third % len(directions)], axis=0), axis=1)
    coarse = cosines[:, :N_COARSEST].argmax(axis=1)
    ordered = frames[:, np.lexsort(np.sort(coarse[frames], axis=0))]
    n_hoods = -(-ordered.shape[1] // HOOD)
    padded = ordered[:, np.arange(HOOD * n_hoods) % ordered.shape[1]]
    return _constant(np.ascontiguousarray(padded.reshape(3, n_hoods, HOOD).transpose(0, 2, 1)))


def _constant(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array
