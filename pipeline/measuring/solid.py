"""Volume, area, centre of mass and inertia of a closed mesh, and the check that it is closed, in one pass.

A mesh bounds a solid if every directed edge (a, b) of a face meets its opposite (b, a) in another
face: then the signed tetrahedra below add up to the volume, whatever their common apex.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.arrays import Faces, Flags, Matrix33, PointsMM, Values, Vector
from pipeline.compiled import compiled, whole
from pipeline.errors import MeshError

MIN_COMPACTNESS = 1e-9
"""Least volume / area^(3/2) of a solid; below it the volume consists of rounding errors."""
MISSING = "the mesh has faces whose vertices are missing"
MIX_1, MIX_2, MIX_3 = (
    np.uint64(0x9E3779B97F4A7C15),
    np.uint64(0xBF58476D1CE4E5B9),
    np.uint64(0x94D049BB133111EB),
)
"""Constants of the SplitMix64 generator (Steele, Lea and Flood 2014)."""
SECOND = np.array([[5, 8, 10], [8, 6, 9], [10, 9, 7]])
"""Index into the sums over the faces of each second moment, xx, xy, ..., zz."""
CLOSED, OPEN, INCOMPLETE = whole(0), whole(1), whole(2)
"""Kinds of meshes; `INCOMPLETE`: a face names a vertex that does not exist."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
    """The solid that a closed mesh encloses."""

    volume_mm3: float
    surface_area_mm2: float
    center_mm: Vector  # centre of mass at uniform density
    inertia_mm5: Matrix33  # about the centre of mass, at density 1
    vertices_mm: PointsMM  # the vertices that belong to a face


def solid_of(vertices_mm: ArrayLike, faces: ArrayLike) -> Solid:
    """Return the solid inside a mesh with vertices (N, 3) and faces (M, 3), whose faces may all look inward.

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
    sums = np.zeros(11)
    kind = _add_up(points_mm, corners, apex_mm, np.empty(len(points_mm), np.uint64), is_used, sums)
    area_mm2, volume_mm3 = float(sums[0]), float(sums[1])
    if kind == INCOMPLETE:
        raise MeshError(MISSING)
    if not np.isfinite(area_mm2):
        raise MeshError("the mesh has vertices that are not finite numbers")
    if kind == OPEN:
        raise MeshError(_defect(corners, len(points_mm)))
    if not abs(volume_mm3) > MIN_COMPACTNESS * area_mm2**1.5:
        raise MeshError("the mesh encloses no volume")
    center_mm = sums[2:5] / volume_mm3
    second_mm5 = sums[SECOND] - volume_mm3 * np.outer(center_mm, center_mm)
    return Solid(
        volume_mm3=abs(volume_mm3),
        surface_area_mm2=area_mm2,
        center_mm=apex_mm + center_mm,
        inertia_mm5=(np.trace(second_mm5) * np.eye(3) - second_mm5) * np.sign(volume_mm3),
        vertices_mm=points_mm if is_used.all() else points_mm[is_used],
    )


@compiled
def _add_up(
    vertices_mm: PointsMM,
    faces: Faces,
    origin_mm: Vector,
    tags: NDArray[np.uint64],
    is_used: Flags,
    sums: Values,
) -> int:
    """Set `sums` to area, signed volume and its moments x, y, z, xx, yy, zz, xy, yz, zx; return the mesh's kind.

    `is_used` tells which vertices belong to a face. To find out whether the mesh is closed, each vertex gets a random
    number in `tags`, and each face adds (p - q) (q - r) (r - p) of its corners' numbers to a fingerprint. That is a sum
    over its edges, q p^2 - p q^2 for the one from p to q: edges and their opposites cancel, nothing else does but by
    chance.

    The tetrahedron of the origin and a face (a, b, c) with volume V has the moments V (a + b + c) / 4 and
    V / 20 (a a' + b b' + c c' + (a + b + c) (a + b + c)').
    """
    for vertex in range(len(vertices_mm)):
        mixed = np.uint64(vertex + 1) * MIX_1
        mixed = (mixed ^ (mixed >> np.uint64(30))) * MIX_2
        mixed = (mixed ^ (mixed >> np.uint64(27))) * MIX_3
        tags[vertex] = mixed ^ (mixed >> np.uint64(31))
    fingerprint = np.uint64(0)
    area = volume = mx = my = mz = xx = yy = zz = xy = yz = zx = 0.0
    ox, oy, oz = origin_mm[0], origin_mm[1], origin_mm[2]
    for face in range(len(faces)):
        for k in range(3):
            if not 0 <= faces[face, k] < len(vertices_mm):
                return INCOMPLETE
            is_used[faces[face, k]] = True
        a, b, c = faces[face, 0], faces[face, 1], faces[face, 2]
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
    sums[0], sums[1] = area / 2, volume / 6
    sums[2], sums[3], sums[4] = mx / 24, my / 24, mz / 24
    sums[5], sums[6], sums[7] = xx / 120, yy / 120, zz / 120
    sums[8], sums[9], sums[10] = xy / 120, yz / 120, zx / 120
    return CLOSED if fingerprint == np.uint64(0) else OPEN


def _defect(faces: Faces, n_vertices: int) -> str:
    """Describe what is wrong with a mesh some of whose edges lack their opposite."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    forward, backward = start * n_vertices + end, end * n_vertices + start
    undirected = np.minimum(forward, backward)
    _, n_uses = np.unique(undirected, return_counts=True)
    n_open = int((n_uses % 2 == 1).sum())
    if n_open:
        return f"the mesh is not closed: {n_open} of {len(n_uses)} edges lack a second face"
    n_wrong = len(forward) - len(np.intersect1d(forward, backward))
    return f"the mesh is not consistently oriented: faces disagree along {n_wrong // 2} edges"
