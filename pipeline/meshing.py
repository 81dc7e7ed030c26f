"""From the hull's field to a closed triangle mesh (marching cubes, the paper's eq. (11))."""

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray
from skimage.measure import marching_cubes

from pipeline.carving import VisualHull


@dataclass(frozen=True, slots=True, eq=False)
class ParticleMesh:
    """Closed surface in the world frame; faces counter-clockwise seen from outside."""

    vertices_mm: NDArray[np.float64]  # (N, 3)
    faces: NDArray[np.int64]  # (M, 3)


def mesh_hull(hull: VisualHull) -> ParticleMesh | None:
    """Surface of the hull's largest part, or `None` when the hull is empty.

    The surface is closed also where the hull meets the border of the grid; `hull.touches_border`
    tells.
    """
    if hull.field.size == 0:
        return None
    inside = hull.field > hull.level
    parts, n_parts = scipy.ndimage.label(inside)
    if n_parts == 0:
        return None
    field = hull.field.astype(np.float32)
    if n_parts > 1:
        sizes = np.bincount(parts.ravel())
        sizes[0] = 0
        field[inside & (parts != np.argmax(sizes))] = hull.level - hull.pitch_mm
    # a sample exactly on the level would make triangles without area
    field[field == hull.level] += 1e-6
    padded = np.pad(field, 1, constant_values=hull.level - hull.pitch_mm)
    vertices, faces, _, _ = marching_cubes(padded, hull.level, allow_degenerate=False)
    vertices_mm = hull.origin_mm + hull.pitch_mm * (vertices.astype(np.float64) - 1)
    faces = faces.astype(np.int64)
    corners = vertices_mm[faces] - vertices_mm.mean(axis=0)
    if np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) < 0:
        faces = faces[:, ::-1]
    return ParticleMesh(vertices_mm, np.ascontiguousarray(faces))
