"""The convex hull of a body and its widths between parallel planes.

The width along a unit direction u is w(u) = max p.u - min p.u over the hull's vertices p: every size that
calipers, bars or holes can measure is one of the hull, and follows from w. The vertex that touches a plane is
found by climbing along the hull's edges: on a convex body no summit is a false one.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.compiled import compiled
from pipeline.geometry.quickhull import hull_facets
from pipeline.measuring.directions import half_sphere

Array = NDArray[np.float64]
Indices = NDArray[np.int32]


class Edges(NamedTuple):
    """The vertices of a convex hull and what they are connected with."""

    vertices_mm: Array  # (N, 3)
    first: Indices  # (N + 1,) where the neighbours of each vertex begin
    neighbors: Indices  # (2 E,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConvexBody:
    """A convex hull, with its widths along the M directions of `half_sphere()`."""

    volume_mm3: float
    facets: Indices  # (F, 3) vertices, counter-clockwise seen from outside
    normals: Array  # (F, 3) outward unit vectors
    edges: Edges
    touching: Indices  # (M, 2) the vertices at the upper and at the lower plane
    width_mm: Array  # (M,)

    @property
    def vertices_mm(self) -> Array:  # (N, 3)
        return self.edges.vertices_mm


def convex_body(points_mm: Array, center_mm: ArrayLike = (0, 0, 0)) -> ConvexBody:
    """The convex hull of points (N, 3) that do not lie in one plane, relative to a centre (3,)."""
    facets, normals = hull_facets(points_mm)
    is_vertex = np.zeros(len(points_mm), bool)
    is_vertex[facets] = True
    vertices_mm = points_mm.compress(is_vertex, axis=0) - np.asarray(center_mm, np.float64)
    facets = (np.cumsum(is_vertex, dtype=np.int32) - np.int32(1)).take(facets)
    first = np.zeros(len(vertices_mm) + 1, np.int32)
    neighbors = np.empty(facets.size, np.int32)
    volume_mm3 = _connect(vertices_mm, facets, first, neighbors)
    edges = Edges(vertices_mm, first, neighbors)
    directions, nearby = half_sphere().directions, half_sphere().nearby
    touching, width_mm = np.zeros((len(directions), 2), np.int32), np.empty(len(directions))
    _touch_all(edges, directions, nearby, touching, width_mm)
    return ConvexBody(
        volume_mm3=volume_mm3,
        facets=facets,
        normals=normals,
        edges=edges,
        touching=touching,
        width_mm=width_mm,
    )


@compiled
def _connect(vertices_mm: Array, facets: Indices, first: Indices, neighbors: Indices) -> float:
    """Fill in the edges, of which one leaves a vertex along each of its facets; returns the volume in mm3."""
    sixfold_mm3 = 0.0
    for facet in range(len(facets)):
        a, b, c = facets[facet, 0], facets[facet, 1], facets[facet, 2]
        ax, ay, az = vertices_mm[a, 0], vertices_mm[a, 1], vertices_mm[a, 2]
        bx, by, bz = vertices_mm[b, 0], vertices_mm[b, 1], vertices_mm[b, 2]
        cx, cy, cz = vertices_mm[c, 0], vertices_mm[c, 1], vertices_mm[c, 2]
        sixfold_mm3 += ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        for k in range(3):
            first[facets[facet, k]] += 1
    for vertex in range(len(vertices_mm)):
        first[vertex + 1] += first[vertex]
    for facet in range(len(facets)):
        for k in range(3):
            start = facets[facet, k]
            first[start] -= 1
            neighbors[first[start]] = facets[facet, (k + 1) % 3]
    return sixfold_mm3 / 6


@compiled
def highest(edges: Edges, x: float, y: float, z: float, start: int) -> int:
    """The vertex farthest along a direction, climbing from another one."""
    points = edges.vertices_mm
    summit = start
    top = points[start, 0] * x + points[start, 1] * y + points[start, 2] * z
    while True:
        vertex = summit
        for k in range(edges.first[vertex], edges.first[vertex + 1]):
            other = edges.neighbors[k]
            height = points[other, 0] * x + points[other, 1] * y + points[other, 2] * z
            if height > top:
                top, summit = height, other
        if summit == vertex:
            return summit


@compiled
def unit(x: float, y: float, z: float) -> tuple[float, float, float]:
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@compiled
def touch(edges: Edges, x: float, y: float, z: float, touching: Indices, row: int) -> float:
    """Width in mm along a unit direction; a row of `touching` (R, 2) holds vertices nearby, then those that touch."""
    points, width_mm = edges.vertices_mm, 0.0
    for end in range(2):
        vertex = highest(edges, x, y, z, touching[row, end])
        touching[row, end] = vertex
        width_mm += points[vertex, 0] * x + points[vertex, 1] * y + points[vertex, 2] * z
        x, y, z = -x, -y, -z
    return width_mm


@compiled
def _touch_all(edges: Edges, directions: Array, nearby: Indices, touching: Indices, width_mm: Array) -> None:
    """Fill in `ConvexBody.touching` and `ConvexBody.width_mm`."""
    for i in range(len(directions)):
        touching[i, 0], touching[i, 1] = touching[nearby[i], 0], touching[nearby[i], 1]
        width_mm[i] = touch(edges, directions[i, 0], directions[i, 1], directions[i, 2], touching, i)
