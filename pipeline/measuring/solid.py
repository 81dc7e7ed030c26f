"""Volume, area, centre of mass and inertia of a closed mesh, and whether it is closed, in one pass over its faces.

A mesh bounds a solid when every directed edge (a, b) of a face meets its opposite (b, a) in another
face: then the signed tetrahedra below add up to the volume, whatever their common apex.
"""

from dataclasses import dataclass
from typing import NamedTuple

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
MISSING = "the mesh has faces whose vertices are missing"
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
    if not 0 <= corners[0, 0] < len(points_mm):
        raise MeshError(MISSING)
    apex_mm = points_mm[corners[0, 0]]  # far from the mesh the tetrahedra would cancel digits
    is_used = np.zeros(len(points_mm), np.bool_)
    sums = _sums(points_mm, corners, apex_mm, np.empty(len(points_mm), np.uint64), is_used)
    if sums.n_used < 0:
        raise MeshError(MISSING)
    if not np.isfinite(sums.area_mm2):
        raise MeshError("the mesh has vertices that are not finite numbers")
    if sums.fingerprint:
        raise MeshError(_defect(corners, len(points_mm)))
    if not abs(sums.volume_mm3) > MIN_FILLING * sums.extent_mm**3:
        raise MeshError("the mesh encloses no volume")
    center_mm = np.array(sums.first_mm4) / sums.volume_mm3
    xx, yy, zz, xy, yz, zx = sums.second_mm5
    second_mm5 = np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    second_mm5 -= sums.volume_mm3 * np.outer(center_mm, center_mm)
    return Solid(
        volume_mm3=abs(sums.volume_mm3),
        surface_area_mm2=sums.area_mm2,
        center_mm=center_mm + apex_mm,
        inertia_mm5=(np.trace(second_mm5) * np.eye(3) - second_mm5) * np.sign(sums.volume_mm3),
        vertices_mm=points_mm if sums.n_used == len(points_mm) else points_mm[is_used],
    )


class _Sums(NamedTuple):
    """What one pass over the faces adds up."""

    n_used: int  # vertices that belong to a face; -1 where some are missing
    fingerprint: np.uint64  # 0 for a closed, oriented mesh
    extent_mm: float  # the longest edge of the box along the axes
    area_mm2: float
    volume_mm3: float  # signed
    first_mm4: First  # moments about the origin given
    second_mm5: Second


@compiled
def _sums(
    vertices_mm: Array, faces: Faces, origin_mm: Array, tags: NDArray[np.uint64], is_used: NDArray[np.bool_]
) -> _Sums:
    """Add up a mesh; room for a random number for each vertex, and for whether it belongs to a face.

    Each face adds (p - q) (q - r) (r - p) of its corners' numbers to the fingerprint. That is a sum over its edges,
    q p^2 - p q^2 for the one from p to q: edges and their opposites cancel, and nothing else does but by chance.

    The tetrahedron of the origin and a face (a, b, c) with volume V has the moments V (a + b + c) / 4 and
    V / 20 (a a' + b b' + c c' + (a + b + c) (a + b + c)').
    """
    n_vertices = len(vertices_mm)
    for vertex in range(n_vertices):
        mixed = np.uint64(vertex + 1) * MIX_1
        mixed = (mixed ^ (mixed >> np.uint64(30))) * MIX_2
        mixed = (mixed ^ (mixed >> np.uint64(27))) * MIX_3
        tags[vertex] = mixed ^ (mixed >> np.uint64(31))
    fingerprint = np.uint64(0)
    area = volume = mx = my = mz = xx = yy = zz = xy = yz = zx = 0.0
    ox, oy, oz = origin_mm[0], origin_mm[1], origin_mm[2]
    for face in range(len(faces)):
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
        if min(a, b, c) < 0 or max(a, b, c) >= n_vertices:
            return _Sums(-1, fingerprint, 0.0, area, volume, (mx, my, mz), (xx, yy, zz, xy, yz, zx))
        is_used[a] = is_used[b] = is_used[c] = True
        fingerprint += (tags[a] - tags[b]) * (tags[b] - tags[c]) * (tags[c] - tags[a])
        ax, ay, az = vertices_mm[a, 0] - ox, vertices_mm[a, 1] - oy, vertices_mm[a, 2] - oz
        bx, by, bz = vertices_mm[b, 0] - ox, vertices_mm[b, 1] - oy, vertices_mm[b, 2] - oz
        cx, cy, cz = vertices_mm[c, 0] - ox, vertices_mm[c, 1] - oy, vertices_mm[c, 2] - oz
        nx = (by - ay) * (cz - az) - (bz - az) * (cy - ay)
        ny = (bz - az) * (cx - ax) - (bx - ax) * (cz - az)
        nz = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        area += np.sqrt(nx * nx + ny * ny + nz * nz)
        part = ax * nx + ay * ny + az * nz
        volume += part
        sx, sy, sz = ax + bx + cx, ay + by + cy, az + bz + cz
        mx, my, mz = mx + part * sx, my + part * sy, mz + part * sz
        xx += part * (ax * ax + bx * bx + cx * cx + sx * sx)
        yy += part * (ay * ay + by * by + cy * cy + sy * sy)
        zz += part * (az * az + bz * bz + cz * cz + sz * sz)
        xy += part * (ax * ay + bx * by + cx * cy + sx * sy)
        yz += part * (ay * az + by * bz + cy * cz + sy * sz)
        zx += part * (az * ax + bz * bx + cz * cx + sz * sx)

    n_used = 0
    low_x = low_y = low_z = np.inf
    high_x = high_y = high_z = -np.inf
    for vertex in range(n_vertices):
        if is_used[vertex]:
            n_used += 1
            x, y, z = vertices_mm[vertex, 0], vertices_mm[vertex, 1], vertices_mm[vertex, 2]
            low_x, low_y, low_z = min(low_x, x), min(low_y, y), min(low_z, z)
            high_x, high_y, high_z = max(high_x, x), max(high_y, y), max(high_z, z)
    extent = max(high_x - low_x, high_y - low_y, high_z - low_z)
    first = mx / 24, my / 24, mz / 24
    second = xx / 120, yy / 120, zz / 120, xy / 120, yz / 120, zx / 120
    return _Sums(n_used, fingerprint, extent, area / 2, volume / 6, first, second)


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
