"""The largest of the surfaces that are not connected to one another."""

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled, compiled_within

Array = NDArray[np.float64]
Faces = NDArray[np.int64]


def largest_surface(vertices: Array, faces: Faces) -> tuple[Array, Faces]:
    """Vertices (N, 3) and faces (M, 3) of the connected surface with most faces: islands are left out."""
    part_of = np.arange(len(vertices), dtype=np.int32)
    _unite(part_of, faces)
    if not part_of.any():
        return vertices, faces
    part_of_face = part_of[faces[:, 0]]
    largest = np.bincount(part_of_face).argmax()
    kept = part_of == largest
    return vertices[kept], (np.cumsum(kept) - 1)[faces[part_of_face == largest]]


@compiled
def _unite(parent: NDArray[np.int32], faces: Faces) -> None:
    """Set for each vertex (N,), at first its own parent, the first vertex of its part (union-find)."""
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        if parent[a] == parent[b] == parent[c]:
            continue
        first = _root(parent, a)
        for corner in (b, c):
            other = _root(parent, corner)
            first, last = min(first, other), max(first, other)
            parent[last] = first
    for vertex in range(len(parent)):
        parent[vertex] = parent[parent[vertex]]  # the parent comes before and has its root already


@compiled_within
def _root(parent: NDArray[np.int32], vertex: int) -> int:
    while parent[vertex] != vertex:
        parent[vertex] = parent[parent[vertex]]  # the way is half as long next time
        vertex = parent[vertex]
    return vertex
