"""A convex hull that points are added to (Quickhull: Barber, Dobkin and Huhdanpaa 1996).

Each facet has a list of the points above it; the highest of them becomes a vertex: the facets that it sees are replaced
by a cone from their horizon to it, and the points above them are handed to the facets of the cone. Facets take
turns, so that the hull grows from coarse to fine.

Rounding may make the facets that a point sees look as if they had a hole, for instance. Then the growth fails,
and qhull, which merges facets that are nearly coplanar, computes the hull anew.

For the inner body this saves 9 % of the processing time of a stone of 25 mm, beside scipy's hull of all points so far
for each batch (tests/benchmarks/convex_hulls.py).
"""

from typing import NamedTuple

import numpy as np

from pipeline.arrays import Floats, Indices32, PointsMM
from pipeline.compiled import compiled, compiled_within, whole

ROUNDING = 1e-13
"""Height, as a share of the extent, up to which a point does not see the facet below it."""
FLAT = 1e-7
"""Least height of a tetrahedron, as a share of the extent."""
FACES = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
"""Corners of a tetrahedron's facets."""
BESIDE = np.array([[1, 2, 3], [3, 2, 0], [1, 3, 0], [2, 1, 0]])
"""The facets across their edges."""

BASE, N_FACES = whole(0), whole(4)
"""The first of these facets, and their number."""

NONE, NO_FACET = -1, -2
"""In `Growth.above`: no point is above the facet; there is no facet in this place."""
HIGHEST, SEEN_BY = 6, 7
"""Columns of `Growth.facets`, after corners and neighbours."""
TOP = 4
"""Column of `Growth.planes`, after the plane."""
VISIBLE, ENTERED, LOOKED, PATH, WAITING, NEW, VACANT, EDGE = 0, 1, 2, 3, 4, 5, 6, 7
"""Columns of `Growth.lists`."""


class Facets(NamedTuple):
    """The F facets of a convex hull."""

    corners: Indices32  # (F, 3) points, counter-clockwise seen from outside
    across: Indices32  # (F, 3) the facets beyond the edges from corner k to k + 1
    planes: Floats  # (F, 4) outward unit normal n and offset d: n . x + d is the height of x above the facet


class Growth(NamedTuple):
    """Facets in K places that are used again; in few arrays, since the time to compile grows with their number."""

    facets: Indices32  # (K, 8) `Facets.corners` and `across`, the HIGHEST point above, and the vertex last SEEN_BY
    planes: Floats  # (K, 5) `Facets.planes`, and the height of that point, TOP
    above: Indices32  # (K,) the first of the points above; NONE, or NO_FACET
    following: Indices32  # (N,) for each point the next one above the same facet

    lists: Indices32
    """(K, 10) in its columns: facets VISIBLE to the latest vertex, the side through which each was ENTERED, how many
    of its sides were LOOKED at; the PATH to the latest, of their numbers; the first of the points WAITING above each;
    the NEW facets; VACANT places; and, from EDGE on, the horizon: start of each edge, facet beyond, its side."""
    counts: Indices32  # (2,) places in use, and how many of them are vacant
    extent: float
    tolerance: float  # height up to which points above the hull are left out
    rounding: float  # height up to which a point does not see a facet


def growth_for(n_points: int, extent: float, tolerance: float) -> Growth:
    """Return room for the hull of N points; `tolerance` is a share of their extent."""
    capacity = 3 * n_points + 100
    return Growth(
        facets=np.empty((capacity, 8), np.int32),
        planes=np.empty((capacity, 5)),
        above=np.empty(capacity, np.int32),
        following=np.empty(n_points, np.int32),
        lists=np.empty((capacity, 10), np.int32),
        counts=np.zeros(2, np.int32),
        extent=extent,
        tolerance=tolerance * extent,
        rounding=ROUNDING * extent,
    )


def facets_of(growth: Growth) -> Facets:
    """Return the facets of the hull so far."""
    is_facet = growth.above[: growth.counts[0]] != NO_FACET
    n = np.count_nonzero(is_facet)
    facets = Facets(np.empty((n, 3), np.int32), np.empty((n, 3), np.int32), np.empty((n, 4)))
    _copy_facets(growth, np.cumsum(is_facet, dtype=np.int32) - np.int32(1), facets)
    return facets


@compiled
def _copy_facets(growth: Growth, number: Indices32, facets: Facets) -> None:
    """Fill in the facets of the hull so far, by the `number` (K,) of each place."""
    for place in range(len(number)):
        if growth.above[place] == NO_FACET:
            continue
        n = number[place]
        for k in range(3):
            facets.corners[n, k] = growth.facets[place, k]
            facets.across[n, k] = number[growth.facets[place, 3 + k]]
        for k in range(4):
            facets.planes[n, k] = growth.planes[place, k]


def start(points: PointsMM, chosen: Indices32, growth: Growth) -> bool:
    """Make a tetrahedron of chosen points and list the others of them above it; False when they lie in a plane."""
    return _start(points, chosen, growth, np.zeros((4, 3)), np.full(4, chosen[0]))


@compiled
def _start(points: PointsMM, chosen: Indices32, growth: Growth, axes: Floats, corners: Indices32) -> bool:
    """Find the corners (4,): each is the farthest point from the first one, from their line, from their plane.

    `axes` (4, 3) become unit vectors towards them, orthogonal to those before.
    """
    facets, planes = growth.facets, growth.planes
    first, farthest = corners[0], 0.0
    for n in range(1, 4):
        farthest = 0.0
        for i in range(len(chosen)):
            point = chosen[i]
            x, y = points[point, 0] - points[first, 0], points[point, 1] - points[first, 1]
            z = points[point, 2] - points[first, 2]
            for k in range(1, n):
                along = x * axes[k, 0] + y * axes[k, 1] + z * axes[k, 2]
                x, y, z = x - along * axes[k, 0], y - along * axes[k, 1], z - along * axes[k, 2]
            distance = np.sqrt(x * x + y * y + z * z)
            if distance > farthest:
                farthest, corners[n] = distance, point
                axes[n, 0], axes[n, 1], axes[n, 2] = x / distance, y / distance, z / distance
    if not farthest > FLAT * growth.extent:
        return False
    for _ in range(2):
        for facet in range(4):
            growth.lists[facet, NEW] = facet
            place = growth.lists[facet, NEW]  # an index of the kind that all other facets have
            a, b, c = corners[FACES[facet, 0]], corners[FACES[facet, 1]], corners[FACES[facet, 2]]
            _span(points, facets, planes, place, a, b, c)
            for side in range(3):
                facets[facet, 3 + side] = BESIDE[facet, side]
            growth.above[facet] = NONE
        top = corners[3]
        # the first facet is to look away from the last corner
        if height_above(planes, BASE, points[top, 0], points[top, 1], points[top, 2]) > 0:
            corners[1], corners[2] = corners[2], corners[1]
    growth.counts[0] = 4
    for i in range(len(chosen)):
        _assign(points, growth, chosen[i], N_FACES)
    return True


@compiled
def grow(points: PointsMM, growth: Growth) -> bool:
    """Add the points that are listed above facets; False when rounding defeats the method."""
    lists = growth.lists
    n_places, n_vacant = growth.counts[0], growth.counts[1]
    facet = 0
    for _ in range(len(points)):
        n_passed = 0
        while growth.above[facet] < 0:
            facet = facet + 1 if facet + 1 < n_places else 0
            n_passed += 1
            if n_passed > n_places:
                growth.counts[0], growth.counts[1] = n_places, n_vacant
                return True
        n_visible, n_new = _find_horizon(points, growth, facet)
        if n_new == 0:
            return False
        apex = growth.facets[facet, HIGHEST]
        for k in range(n_visible):
            place = lists[k, VISIBLE]
            lists[k, WAITING] = growth.above[place]
            growth.above[place] = NO_FACET
            lists[n_vacant, VACANT] = place
            n_vacant += 1
        for k in range(n_new):
            if n_vacant > 0:
                n_vacant -= 1
                lists[k, NEW] = lists[n_vacant, VACANT]
            else:
                lists[k, NEW] = n_places
                n_places += 1
        _build_cone(points, growth, apex, n_new)
        for k in range(n_visible):
            point = lists[k, WAITING]
            while point >= 0:
                following = growth.following[point]
                _assign(points, growth, point, n_new)
                point = following
    return False


@compiled_within
def height_above(planes: Floats, facet: int, x: float, y: float, z: float) -> float:
    """Return the height of a point above the plane of a facet."""
    return planes[facet, 0] * x + planes[facet, 1] * y + planes[facet, 2] * z + planes[facet, 3]


@compiled_within
def put_above(growth: Growth, facet: int, point: int, height: float) -> None:
    """List a point above a facet."""
    if growth.above[facet] < 0 or height > growth.planes[facet, TOP]:
        growth.planes[facet, TOP] = height
        growth.facets[facet, HIGHEST] = point
    growth.following[point] = growth.above[facet]
    growth.above[facet] = point


@compiled_within
def _assign(points: PointsMM, growth: Growth, point: int, n_new: int) -> None:
    """List a point above the first of the new facets that it is above, if any."""
    x, y, z = points[point, 0], points[point, 1], points[point, 2]
    for k in range(n_new):
        facet = growth.lists[k, NEW]
        height = height_above(growth.planes, facet, x, y, z)
        if height > growth.tolerance:
            put_above(growth, facet, point, height)
            break


@compiled_within
def _find_horizon(points: PointsMM, growth: Growth, first: int) -> tuple[int, int]:
    """List the facets that the highest point above one of them sees, and the edges of their horizon; count both.

    Every facet is entered from another and its other sides are looked at in turn, so that the edges of the horizon
    come in order. No edges: it is no ring.
    """
    facets, lists = growth.facets, growth.lists
    apex = facets[first, HIGHEST]
    x, y, z = points[apex, 0], points[apex, 1], points[apex, 2]
    lists[0, VISIBLE], lists[0, ENTERED], lists[0, LOOKED], lists[0, PATH] = first, 2, 0, 0
    facets[first, SEEN_BY] = apex
    n_visible, n_edges, depth, last = 1, 0, 0, NONE
    while depth >= 0:
        at = lists[depth, PATH]
        facet = lists[at, VISIBLE]
        lists[at, LOOKED] += 1
        if lists[at, LOOKED] > 3 or (lists[at, LOOKED] == 3 and depth > 0):
            depth -= 1
            continue
        side = (lists[at, ENTERED] + lists[at, LOOKED]) % 3
        beyond = facets[facet, 3 + side]
        if facets[beyond, SEEN_BY] == apex:
            continue
        start = facets[facet, side]
        # both facets have the edge, in opposite directions
        back = 2 if facets[beyond, 0] == start else 0 if facets[beyond, 1] == start else 1
        if height_above(growth.planes, beyond, x, y, z) > growth.rounding:
            depth += 1
            lists[depth, PATH] = n_visible
            lists[n_visible, VISIBLE], lists[n_visible, ENTERED], lists[n_visible, LOOKED] = beyond, back, 0
            facets[beyond, SEEN_BY] = apex
            n_visible += 1
            continue
        if n_edges > 0 and start != last:
            return n_visible, 0
        last = facets[facet, (side + 1) % 3]
        lists[n_edges, EDGE], lists[n_edges, EDGE + 1], lists[n_edges, EDGE + 2] = start, beyond, back
        n_edges += 1
    return n_visible, n_edges if n_edges > 2 and last == lists[0, EDGE] else 0


@compiled_within
def _build_cone(points: PointsMM, growth: Growth, apex: int, n_edges: int) -> None:
    """Make a new facet from each edge of the horizon to the apex."""
    facets, lists = growth.facets, growth.lists
    before = lists[n_edges - 1, NEW]
    for k in range(n_edges):
        facet = lists[k, NEW]
        start, beyond, back = lists[k, EDGE], lists[k, EDGE + 1], lists[k, EDGE + 2]
        end = lists[k + 1 if k + 1 < n_edges else 0, EDGE]
        _span(points, facets, growth.planes, facet, start, end, apex)
        growth.above[facet] = NONE
        facets[beyond, 3 + back] = facet
        facets[facet, 3], facets[facet, 5], facets[before, 4] = beyond, before, facet
        before = facet


@compiled_within
def _span(points: PointsMM, facets: Indices32, planes: Floats, facet: int, a: int, b: int, c: int) -> None:
    """Make a facet of three points."""
    facets[facet, 0], facets[facet, 1], facets[facet, 2], facets[facet, SEEN_BY] = a, b, c, NONE
    x, y, z = points[c, 0], points[c, 1], points[c, 2]
    ux, uy, uz = points[a, 0] - x, points[a, 1] - y, points[a, 2] - z
    vx, vy, vz = points[b, 0] - x, points[b, 1] - y, points[b, 2] - z
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    scale = 1 / np.sqrt(nx * nx + ny * ny + nz * nz)
    planes[facet, 0], planes[facet, 1], planes[facet, 2] = nx * scale, ny * scale, nz * scale
    planes[facet, 3] = -(nx * x + ny * y + nz * z) * scale
