"""From the hull's field to a closed triangle mesh (marching cubes, the paper's eq. (11))."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from skimage.measure import marching_cubes

from pipeline.carving import VisualHull


@dataclass(frozen=True, slots=True, eq=False)
class ParticleMesh:
    """Closed surface in the world frame; faces counter-clockwise seen from outside."""

    vertices_mm: NDArray[np.float64]  # (N, 3)
    faces: NDArray[np.int64]  # (M, 3)


def mesh_hull(hull: VisualHull) -> ParticleMesh | None:
    """Surface of the hull's largest part, or `None` when the hull is empty.

    Where the hull meets the border of the grid the surface closes there; `hull.touches_border` tells.
    """
    if not (hull.field > hull.level).any():
        return None
    vertices, faces, _, _ = marching_cubes(hull.field, hull.level, allow_degenerate=False)
    vertices, faces = _largest_part(vertices.astype(np.float64), faces.astype(np.int64))
    vertices_mm = hull.origin_mm + hull.pitch_mm * vertices
    corners = vertices_mm[faces] - vertices_mm.mean(axis=0)
    if np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0:
        faces = faces[:, ::-1]
    return ParticleMesh(vertices_mm, np.ascontiguousarray(faces))


def _largest_part(
    vertices: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and faces of the connected surface with most faces: islands are left out."""
    first, second = faces[:, :2].ravel(), faces[:, 1:].ravel()
    edges = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(len(vertices),) * 2)
    n_parts, part_of = connected_components(edges, directed=False)
    if n_parts == 1:
        return vertices, faces
    part_of_face = part_of[faces[:, 0]]
    largest = np.bincount(part_of_face).argmax()
    kept = part_of == largest
    return vertices[kept], (np.cumsum(kept) - 1)[faces[part_of_face == largest]]
