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


def bodies_of(vertices: PointsMM, faces: Faces) -> list[Faces]:
    """Return the faces of each body, that of the greatest area first; they need not be closed.

    A cavity belongs to the first body: a surface within its bounds whose faces look the other way.
    """
    surface_of = np.arange(len(vertices), dtype=np.int32)
    _unite(surface_of, faces)
    _, surface_of_face = np.unique(surface_of[faces[:, 0]], return_inverse=True)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.bincount(surface_of_face, np.linalg.norm(normals, axis=1))
    volumes = np.bincount(surface_of_face, ((corners[:, 0] - corners[0, 0]) * normals).sum(axis=1))
    low, high = np.full((len(areas), 3), np.inf), np.full((len(areas), 3), -np.inf)
    np.minimum.at(low, surface_of_face, corners.min(axis=1))
    np.maximum.at(high, surface_of_face, corners.max(axis=1))
    first = areas.argmax()
    is_within = ((low >= low[first]) & (high <= high[first])).all(axis=1)
    is_cavity = is_within & (volumes * volumes[first] < 0)
    body_of_face = np.where(is_cavity, first, np.arange(len(areas)))[surface_of_face]
    by_body = np.argsort(body_of_face, kind="stable")
    bodies, starts = np.unique(body_of_face[by_body], return_index=True)
    parts = np.split(faces[by_body], starts[1:])
    return [parts[i] for i in np.argsort(-areas[bodies], kind="stable")]


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
