"""The convex hull of a body and its widths between parallel planes.

The width along a unit direction u is w(u) = max p.u - min p.u over the hull's vertices p: every size that
calipers, bars or holes can measure follows from w. The vertex that touches a tangent plane is found by climbing
along the hull's edges: on a convex body every local maximum is the global one.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import Directions, Indices32, PointsMM, Values
from pipeline.compiled import compiled
from pipeline.geometry.quickhull import hull_facets
from pipeline.measuring.directions import half_sphere


class Edges(NamedTuple):
    """The vertices of a convex hull and their E edges, as lists of neighbours."""

    vertices_mm: PointsMM
    first: Indices32  # (N + 1,) where in `neighbors` those of each vertex begin
    neighbors: Indices32  # (2 E,)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConvexBody:
    """A convex hull, with its widths along the M directions of `half_sphere()`."""

    volume_mm3: float
    facets: Indices32  # (F, 3) vertices, counter-clockwise seen from outside
    normals: Directions  # (F, 3) outward
    edges: Edges
    touching: Indices32  # (M, 2) the vertices at the upper and at the lower tangent plane
    width_mm: Values  # (M,)

    @property
    def vertices_mm(self) -> PointsMM:
        return self.edges.vertices_mm


def convex_body(points_mm: PointsMM, center_mm: ArrayLike = (0, 0, 0)) -> ConvexBody:
    """Return the convex hull of points that do not lie in one plane, shifted by minus a centre (3,).

    Raises
    ------
    scipy.spatial.QhullError
        The points lie in one plane.
    """
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
def _connect(vertices_mm: PointsMM, facets: Indices32, first: Indices32, neighbors: Indices32) -> float:
    """Fill in `Edges.first` and `Edges.neighbors`, zeros before, and return the volume in mm^3.

    Each vertex has one outgoing edge along each of its facets.
    """
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
    """Return the vertex farthest along a direction, climbing from the vertex `start`."""
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
    """Return the unit vector along (x, y, z)."""
    length = np.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@compiled
def touch(edges: Edges, x: float, y: float, z: float, touching: Indices32, row: int) -> float:
    """Return the width in mm along a unit direction.

    A row of `touching` (R, 2) holds the vertices from which to climb, afterwards those at the two tangent planes.
    """
    points, width_mm = edges.vertices_mm, 0.0
    for end in range(2):
        vertex = highest(edges, x, y, z, touching[row, end])
        touching[row, end] = vertex
        width_mm += points[vertex, 0] * x + points[vertex, 1] * y + points[vertex, 2] * z
        x, y, z = -x, -y, -z
    return width_mm


@compiled
def _touch_all(
    edges: Edges, directions: Directions, nearby: Indices32, touching: Indices32, width_mm: Values
) -> None:
    """Fill in `ConvexBody.touching` and `ConvexBody.width_mm`."""
    for i in range(len(directions)):
        touching[i, 0], touching[i, 1] = touching[nearby[i], 0], touching[nearby[i], 1]
        width_mm[i] = touch(edges, directions[i, 0], directions[i, 1], directions[i, 2], touching, i)
