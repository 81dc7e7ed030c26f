"""Connected components of a mesh, of which the largest is the body."""

import numpy as np

from pipeline.arrays import Faces, Indices32, PointsMM
from pipeline.compiled import compiled, compiled_within


def largest_surface(vertices: PointsMM, faces: Faces) -> tuple[PointsMM, Faces]:
    """Return the vertices and faces of the connected surface with most faces."""
    surface_of = np.arange(len(vertices), dtype=np.int32)
    _unite(surface_of, faces)
    if not surface_of.any():
        return vertices, faces
    surface_of_face = surface_of[faces[:, 0]]
    largest = np.bincount(surface_of_face).argmax()
    kept = surface_of == largest
    return vertices[kept], (np.cumsum(kept) - 1)[faces[surface_of_face == largest]]


@compiled
def _unite(parent: Indices32, faces: Faces) -> None:
    """Set `parent` (N,), at first each vertex itself, to the first vertex of its connected surface (union-find)."""
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
        parent[vertex] = parent[parent[vertex]]  # the parent comes earlier and points to its root already


@compiled_within
def _root(parent: Indices32, vertex: int) -> int:
    while parent[vertex] != vertex:
        parent[vertex] = parent[parent[vertex]]  # path halving
        vertex = parent[vertex]
    return vertex
