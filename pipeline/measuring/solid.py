"""Volume, area, centre of mass and inertia of a closed mesh, in one pass over its faces.

A mesh bounds a solid when every directed edge (a, b) of a face meets its opposite (b, a) in another
face: then the signed tetrahedra below add up to the volume, whatever their common apex.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.compiled import compiled
from pipeline.errors import MeshError

Array = NDArray[np.float64]
Faces = NDArray[np.int64]
First = tuple[float, float, float]
"""Integrals of x, y, z."""
Second = tuple[float, float, float, float, float, float]
"""Integrals of xx, yy, zz, xy, yz, zx."""

MIN_FILLING = 1e-9
"""Volume over the cube of the extent below which a surface encloses nothing but rounding errors."""
MIX_1, MIX_2, MIX_3 = (
    np.uint64(0x9E3779B97F4A7C15),
    np.uint64(0xBF58476D1CE4E5B9),
    np.uint64(0x94D049BB133111EB),
)
"""Of SplitMix64 (Steele, Lea and Flood 2014)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
    """What a closed surface encloses."""

    volume_mm3: float
    surface_area_mm2: float
    center_mm: Array  # (3,) centre of mass at uniform density
    inertia_mm5: Array  # (3, 3) about the centre of mass, at density 1
    vertices_mm: Array  # (N, 3) the vertices that belong to a face


def solid_of(vertices_mm: ArrayLike, faces: ArrayLike) -> Solid:
    """The solid inside a mesh in mm; a mesh whose faces all look inward is taken as turned inside out.

    `vertices_mm` (N, 3), `faces` (M, 3).

    Raises
    ------
    MeshError
        The mesh has no faces, is not finite, not closed, not consistently oriented, or holds no volume.
    """
    points_mm = np.ascontiguousarray(vertices_mm, np.float64)
    corners = np.ascontiguousarray(faces, np.int64)
    if len(corners) == 0:
        raise MeshError("the mesh has no faces")
    if corners.min() < 0 or corners.max() >= len(points_mm):
        raise MeshError("the mesh has faces whose vertices are missing")
    is_used = np.zeros(len(points_mm), np.bool_)
    fingerprint = _fingerprint(corners, is_used)
    used_mm = points_mm if is_used.all() else points_mm[is_used]
    low_mm, high_mm = np.array([(column.min(), column.max()) for column in used_mm.T]).T
    if not np.isfinite(high_mm - low_mm).all():
        raise MeshError("the mesh has vertices that are not finite numbers")
    if fingerprint:
        raise MeshError(_defect(corners, len(points_mm)))

    # about the middle: far from the origin the tetrahedra would cancel digits
    middle_mm = (low_mm + high_mm) / 2
    area_mm2, volume_mm3, first_mm4, (xx, yy, zz, xy, yz, zx) = _moments(points_mm, corners, middle_mm)
    if not abs(volume_mm3) > MIN_FILLING * float((high_mm - low_mm).max()) ** 3:
        raise MeshError("the mesh encloses no volume")
    center_mm = np.array(first_mm4) / volume_mm3
    second_mm5 = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    second_mm5 -= volume_mm3 * np.outer(center_mm, center_mm)
    inertia_mm5 = (np.trace(second_mm5) * np.eye(3) - second_mm5) * np.sign(volume_mm3)
    return Solid(
        volume_mm3=abs(volume_mm3),
        surface_area_mm2=area_mm2,
        center_mm=center_mm + middle_mm,
        inertia_mm5=inertia_mm5,
        vertices_mm=used_mm,
    )


@compiled
def _fingerprint(faces: Faces, is_used: NDArray[np.bool_]) -> np.uint64:
    """A sum over the edges that is 0 for a closed, oriented mesh; marks the vertices that belong to a face.

    Each edge adds a random number of 64 bits of its own, with the sign of its direction: edges and their
    opposites cancel. Of other meshes one in 2^64 would pass.
    """
    n_vertices = len(is_used)
    fingerprint = np.uint64(0)
    for face in range(len(faces)):
        for k in range(3):
            start, end = faces[face, k], faces[face, (k + 1) % 3]
            is_used[start] = True
            mixed = np.uint64(min(start, end) * n_vertices + max(start, end)) * MIX_1
            mixed = (mixed ^ (mixed >> np.uint64(30))) * MIX_2
            mixed = (mixed ^ (mixed >> np.uint64(27))) * MIX_3
            mixed ^= mixed >> np.uint64(31)
            if start < end:
                fingerprint += mixed
            elif end < start:
                fingerprint -= mixed
    return fingerprint


@compiled
def _moments(vertices_mm: Array, faces: Faces, origin_mm: Array) -> tuple[float, float, First, Second]:
    """Area, volume, and its first and second moments about the origin given.

    Of the tetrahedron of the origin and a face (a, b, c) with volume V they are V (a + b + c) / 4 and
    V / 20 (a a' + b b' + c c' + (a + b + c) (a + b + c)').
    """
    area, volume = 0.0, 0.0
    ox, oy, oz = origin_mm[0], origin_mm[1], origin_mm[2]
    mx, my, mz, xx, yy, zz, xy, yz, zx = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = vertices_mm[a, 0] - ox, vertices_mm[a, 1] - oy, vertices_mm[a, 2] - oz
        bx, by, bz = vertices_mm[b, 0] - ox, vertices_mm[b, 1] - oy, vertices_mm[b, 2] - oz
        cx, cy, cz = vertices_mm[c, 0] - ox, vertices_mm[c, 1] - oy, vertices_mm[c, 2] - oz
        nx = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
        ny = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
        nz = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        area += np.sqrt(nx * nx + ny * ny + nz * nz) / 2
        part = (ax * nx + ay * ny + az * nz) / 6
        volume += part
        sx, sy, sz = ax + bx + cx, ay + by + cy, az + bz + cz
        mx, my, mz = mx + part * sx, my + part * sy, mz + part * sz
        xx += part * (ax * ax + bx * bx + cx * cx + sx * sx)
        yy += part * (ay * ay + by * by + cy * cy + sy * sy)
        zz += part * (az * az + bz * bz + cz * cz + sz * sz)
        xy += part * (ax * ay + bx * by + cx * cy + sx * sy)
        yz += part * (ay * az + by * bz + cy * cz + sy * sz)
        zx += part * (az * ax + bz * bx + cz * cx + sz * sx)
    return area, volume, (mx / 4, my / 4, mz / 4), (xx / 20, yy / 20, zz / 20, xy / 20, yz / 20, zx / 20)


@compiled
def surface_area_mm2(vertices_mm: Array, faces: Faces) -> float:
    """Area of any triangle mesh with vertices (N, 3) and faces (M, 3)."""
    area = 0.0
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        ax, ay, az = vertices_mm[a, 0], vertices_mm[a, 1], vertices_mm[a, 2]
        ux, uy, uz = vertices_mm[b, 0] - ax, vertices_mm[b, 1] - ay, vertices_mm[b, 2] - az
        vx, vy, vz = vertices_mm[c, 0] - ax, vertices_mm[c, 1] - ay, vertices_mm[c, 2] - az
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        area += np.sqrt(x * x + y * y + z * z) / 2
    return area


def _defect(faces: Faces, n_vertices: int) -> str:
    """What is wrong with a mesh some of whose edges lack their opposite."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    forward, backward = start * n_vertices + end, end * n_vertices + start
    undirected = np.minimum(forward, backward)
    _, n_uses = np.unique(undirected, return_counts=True)
    n_open = int((n_uses % 2 == 1).sum())
    if n_open:
        return f"the mesh is not closed: {n_open} of {len(n_uses)} edges lack a second face"
    n_wrong = len(forward) - len(np.intersect1d(forward, backward))
    return f"the mesh is not consistently oriented: faces disagree along {n_wrong // 2} edges"
