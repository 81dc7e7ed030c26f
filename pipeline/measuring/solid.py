"""Volume, area and centre of mass of a closed mesh, in one pass over its faces.

A mesh bounds a solid when every directed edge (a, b) of a face meets its opposite (b, a) in another
face: then the signed tetrahedra below add up to the volume, whatever their common apex.
"""

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from pipeline.errors import MeshError

Array = NDArray[np.float64]

MIN_FILLING = 1e-9
"""Volume over the cube of the extent below which a surface encloses nothing but rounding errors."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
    """What a closed surface encloses."""

    volume_mm3: float
    surface_area_mm2: float
    center_mm: Array  # (3,) centre of mass at uniform density
    vertices_mm: Array  # (N, 3) the vertices that belong to a face


def solid_of(mesh: trimesh.Trimesh) -> Solid:
    """The solid inside a mesh in mm; a mesh whose faces all look inward is taken as turned inside out.

    Raises
    ------
    MeshError
        The mesh has no faces, is not finite, not closed, not consistently oriented, or holds no volume.
    """
    vertices_mm = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    if len(faces) == 0:
        raise MeshError("the mesh has no faces")
    if faces.min() < 0 or faces.max() >= len(vertices_mm):
        raise MeshError("the mesh has faces whose vertices are missing")
    used = np.zeros(len(vertices_mm), dtype=bool)
    used[faces] = True
    used_mm = vertices_mm[used]
    if not np.isfinite(used_mm).all():
        raise MeshError("the mesh has vertices that are not finite numbers")
    _require_closed(faces, len(vertices_mm))

    # about the middle: far from the origin the tetrahedra would cancel digits
    middle_mm = (used_mm.min(axis=0) + used_mm.max(axis=0)) / 2
    extent_mm = float(np.ptp(used_mm, axis=0).max())
    a, b, c = ((vertices_mm - middle_mm)[faces[:, k]] for k in range(3))
    normals = _cross(b - a, c - a)  # twice the area, outward
    six_volumes = np.einsum("ij,ij->i", a, normals)
    six_volume = float(six_volumes.sum())
    if not abs(six_volume) > 6 * MIN_FILLING * extent_mm**3:
        raise MeshError("the mesh encloses no volume")
    center_mm = six_volumes @ (a + b + c) / (4 * six_volume)
    return Solid(
        volume_mm3=abs(six_volume) / 6,
        surface_area_mm2=float(np.sqrt(np.einsum("ij,ij->i", normals, normals)).sum()) / 2,
        center_mm=center_mm + middle_mm,
        vertices_mm=used_mm,
    )


def _require_closed(faces: NDArray[np.int64], n_vertices: int) -> None:
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    forward, backward = np.sort(start * n_vertices + end), np.sort(end * n_vertices + start)
    if np.array_equal(forward, backward):
        return
    undirected = np.minimum(start, end) * n_vertices + np.maximum(start, end)
    _, n_uses = np.unique(undirected, return_counts=True)
    n_open = int((n_uses % 2 == 1).sum())
    if n_open:
        raise MeshError(f"the mesh is not closed: {n_open} of {len(n_uses)} edges lack a second face")
    n_wrong = len(forward) - len(np.intersect1d(forward, backward))
    raise MeshError(f"the mesh is not consistently oriented: faces disagree along {n_wrong // 2} edges")


def _cross(a: Array, b: Array) -> Array:
    """Row-wise cross product (N, 3); several times as fast as numpy's general one."""
    return np.column_stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ]
    )
