"""A convex hull that points are added to (Quickhull: Barber, Dobkin and Huhdanpaa 1996).

Each facet knows the points above it; the highest of them becomes a vertex: the facets that it sees are replaced
by a cone from their horizon to it, and the points above them are handed to the facets of the cone. Facets take
turns, so that the hull grows from coarse to fine.

Rounding may make the facets that a point sees look as if they had a hole, for instance. Then the growth fails,
and qhull, which merges facets that are nearly coplanar, does it all.
"""

from typing import NamedTuple

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.compiled import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

ROUNDING = 1e-13
"""A point so little above a facet, as a share of the extent, does not see it."""
FLAT = 1e-7
"""A tetrahedron that is lower, as a share of the extent, is none."""

NONE, NO_FACET = -1, -2


class Facets(NamedTuple):
    """Of a convex hull."""

    corners: Indices  # (F, 3) points, counter-clockwise seen from outside
    across: Indices  # (F, 3) the facets beyond the edges from corner k to k + 1
    planes: (
        Array  # (F, 4) outward unit normal, and what is added to its product with a point to get the height
    )


class Growth(NamedTuple):
    """Facets in K places that are used again, and the horizon of the latest vertex."""

    corners: Indices  # (K, 3) as in `Facets`
    across: Indices  # (K, 3)
    planes: Array  # (K, 4)
    top: Array  # (K,) the greatest height of the points above
    highest: Indices  # (K,) the point that has it
    seen_by: Indices  # (K,) the last vertex that saw the facet
    above: Indices  # (K,) the first of the points above; NONE, or NO_FACET
    following: Indices  # (N,) for each point the next one above the same facet

    visible: Indices  # (K,) facets that the latest vertex sees
    entered: Indices  # (K, 2) through which side each of them was, and how many sides of it were looked at
    path: Indices  # (K,) from the first of them to the latest, as their numbers
    horizon: Indices  # (K, 3) the edges around them, in order: start, facet beyond, its side
    lists: Indices  # (K,) the first of the points above each of them
    new: Indices  # (K,) the facet from each edge to the latest vertex
    vacant: Indices  # (K,) places without a facet
    counts: Indices  # (2,) places in use, and how many of them are vacant
    tolerance: float  # points no higher above the hull are left out
    rounding: float


def growth_for(n_points: int, extent: float, tolerance: float) -> Growth:
    """Room for the hull of N points; `tolerance` is a share of their extent."""
    capacity = 3 * n_points + 100
    # what belongs to a facet is in one place of the memory
    topology = np.empty((capacity, 8), np.int32)
    geometry = np.empty((capacity, 5))
    return Growth(
        corners=topology[:, :3],
        across=topology[:, 3:6],
        planes=geometry[:, :4],
        top=geometry[:, 4],
        highest=topology[:, 6],
        seen_by=topology[:, 7],
        above=np.empty(capacity, np.int32),
        following=np.empty(n_points, np.int32),
        visible=np.empty(capacity, np.int32),
        entered=np.empty((capacity, 2), np.int32),
        path=np.empty(capacity, np.int32),
        horizon=np.empty((capacity, 3), np.int32),
        lists=np.empty(capacity, np.int32),
        new=np.empty(capacity, np.int32),
        vacant=np.empty(capacity, np.int32),
        counts=np.zeros(2, np.int32),
        tolerance=tolerance * extent,
        rounding=ROUNDING * extent,
    )


@compiled
def facets_of(growth: Growth) -> Facets:
    """What has grown."""
    n_places, n_facets = growth.counts[0], growth.counts[0] - growth.counts[1]
    facets = Facets(
        np.empty((n_facets, 3), np.int32), np.empty((n_facets, 3), np.int32), np.empty((n_facets, 4))
    )
    number, n = np.empty(n_places, np.int32), 0
    for place in range(n_places):
        if growth.above[place] != NO_FACET:
            number[place] = n
            n += 1
    for place in range(n_places):
        if growth.above[place] != NO_FACET:
            for k in range(3):
                facets.corners[number[place], k] = growth.corners[place, k]
                facets.across[number[place], k] = number[growth.across[place, k]]
            for k in range(4):
                facets.planes[number[place], k] = growth.planes[place, k]
    return facets


def grow_surely(points: Array, added: Indices, growth: Growth) -> None:
    """Add the points that wait above facets; where rounding defeats `grow`, by qhull from all points `added`.

    Raises
    ------
    scipy.spatial.QhullError
        The points lie in one plane.
    """
    if not grow(points, growth):
        restart_by_qhull(points, added, growth)


def restart_by_qhull(points: Array, added: Indices, growth: Growth) -> None:
    """Replace what has grown by the library's convex hull of some points.

    Raises
    ------
    scipy.spatial.QhullError
        The points lie in one plane.
    """
    hull = scipy.spatial.ConvexHull(points[added])
    a, b, c = (hull.points[hull.simplices[:, k]] for k in range(3))
    is_inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3])[:, None] < 0
    opposite = np.where(is_inward, hull.neighbors[:, [0, 2, 1]], hull.neighbors)
    n = len(hull.simplices)
    growth.corners[:n] = added[np.where(is_inward, hull.simplices[:, [0, 2, 1]], hull.simplices)]
    growth.across[:n] = opposite[:, [2, 0, 1]]
    growth.planes[:n] = hull.equations
    growth.above[:n] = growth.seen_by[:n] = NONE
    growth.counts[:] = n, 0


@compiled
def start(points: Array, which: Indices, growth: Growth) -> bool:
    """Make a tetrahedron of some points, and the others of them wait above it; False when they lie in a plane."""
    a = b = c = d = which[0]
    for point in which:
        if points[point, 0] < points[a, 0]:
            a = point
    farthest = 0.0
    for point in which:
        x, y, z = _from(points, a, point)
        if x * x + y * y + z * z > farthest:
            farthest, b = x * x + y * y + z * z, point
    ux, uy, uz = _from(points, a, b)
    farthest = 0.0
    for point in which:
        x, y, z = _cross(ux, uy, uz, *_from(points, a, point))
        if x * x + y * y + z * z > farthest:
            farthest, c = x * x + y * y + z * z, point
    _span(points, growth, 0, a, b, c)
    farthest = 0.0
    for point in which:
        height = height_above(growth, 0, points[point, 0], points[point, 1], points[point, 2])
        if abs(height) > abs(farthest):
            farthest, d = height, point
    if not abs(farthest) * ROUNDING > FLAT * growth.rounding:
        return False
    if farthest > 0:
        b, c = c, b
    for facet, (p, q, r) in enumerate(((a, b, c), (a, d, b), (b, d, c), (c, d, a))):
        _span(points, growth, facet, p, q, r)
        growth.new[facet] = facet
    for facet, (p, q, r) in enumerate(((1, 2, 3), (3, 2, 0), (1, 3, 0), (2, 1, 0))):
        growth.across[facet, 0], growth.across[facet, 1], growth.across[facet, 2] = p, q, r
    growth.counts[0] = 4
    for point in which:
        _give(points, growth, point, 4)
    return True


@compiled
def grow(points: Array, growth: Growth) -> bool:
    """Add the points that wait above facets; False when rounding defeats the method."""
    n_places, n_vacant = growth.counts
    facet = 0
    for _ in range(len(points)):
        n_passed = 0
        while growth.above[facet] < 0:
            facet = facet + 1 if facet + 1 < n_places else 0
            n_passed += 1
            if n_passed > n_places:
                growth.counts[0], growth.counts[1] = n_places, n_vacant
                return True
        n_visible, n_new = _look(points, growth, facet)
        if n_new == 0:
            return False
        apex = growth.highest[facet]
        for k in range(n_visible):
            growth.lists[k] = growth.above[growth.visible[k]]
            growth.above[growth.visible[k]] = NO_FACET
            growth.vacant[n_vacant] = growth.visible[k]
            n_vacant += 1
        for k in range(n_new):
            if n_vacant > 0:
                n_vacant -= 1
                growth.new[k] = growth.vacant[n_vacant]
            else:
                growth.new[k] = n_places
                n_places += 1
        _build_cone(points, growth, apex, n_new)
        for k in range(n_visible):
            point = growth.lists[k]
            while point >= 0:
                following = growth.following[point]
                _give(points, growth, point, n_new)
                point = following
    return False


@compiled
def height_above(growth: Growth, facet: int, x: float, y: float, z: float) -> float:
    """Of a point above the plane of a facet."""
    planes = growth.planes
    return planes[facet, 0] * x + planes[facet, 1] * y + planes[facet, 2] * z + planes[facet, 3]


@compiled
def put_above(growth: Growth, facet: int, point: int, height: float) -> None:
    """Have a point wait above a facet."""
    if growth.above[facet] < 0 or height > growth.top[facet]:
        growth.top[facet] = height
        growth.highest[facet] = point
    growth.following[point] = growth.above[facet]
    growth.above[facet] = point


@compiled
def _give(points: Array, growth: Growth, point: int, n_new: int) -> None:
    """Have a point wait above the first of the new facets that it is above, if any."""
    x, y, z = points[point, 0], points[point, 1], points[point, 2]
    for k in range(n_new):
        facet = growth.new[k]
        height = height_above(growth, facet, x, y, z)
        if height > growth.tolerance:
            put_above(growth, facet, point, height)
            break


@compiled
def _look(points: Array, growth: Growth, first: int) -> tuple[int, int]:
    """How many facets the highest point above one of them sees, and how many edges their horizon has.

    Every facet is entered from another and its other sides are looked at in turn, so that the edges of the horizon
    come in order. No edges: it is no ring.
    """
    across, corners, seen_by = growth.across, growth.corners, growth.seen_by
    visible, entered, path, horizon = growth.visible, growth.entered, growth.path, growth.horizon
    apex = growth.highest[first]
    x, y, z = points[apex, 0], points[apex, 1], points[apex, 2]
    visible[0], entered[0, 0], entered[0, 1], path[0] = first, 2, 0, 0
    seen_by[first] = apex
    n_visible, n_edges, depth = 1, 0, 0
    while depth >= 0:
        at = path[depth]
        facet = visible[at]
        entered[at, 1] += 1
        if entered[at, 1] > 3 or (entered[at, 1] == 3 and depth > 0):
            depth -= 1
            continue
        side = (entered[at, 0] + entered[at, 1]) % 3
        beyond = across[facet, side]
        if seen_by[beyond] == apex:
            continue
        start = corners[facet, side]
        # both facets have the edge, in opposite directions
        back = 2 if corners[beyond, 0] == start else 0 if corners[beyond, 1] == start else 1
        if height_above(growth, beyond, x, y, z) > growth.rounding:
            depth += 1
            visible[n_visible], entered[n_visible, 0], entered[n_visible, 1] = beyond, back, 0
            path[depth] = n_visible
            seen_by[beyond] = apex
            n_visible += 1
            continue
        if n_edges > 0 and corners[horizon[n_edges - 1, 1], horizon[n_edges - 1, 2]] != start:
            return n_visible, 0
        horizon[n_edges, 0], horizon[n_edges, 1], horizon[n_edges, 2] = start, beyond, back
        n_edges += 1
    if n_edges < 3 or corners[horizon[n_edges - 1, 1], horizon[n_edges - 1, 2]] != horizon[0, 0]:
        return n_visible, 0
    return n_visible, n_edges


@compiled
def _build_cone(points: Array, growth: Growth, apex: int, n_edges: int) -> None:
    """A new facet from each edge of the horizon to the apex."""
    before = growth.new[n_edges - 1]
    for k in range(n_edges):
        facet = growth.new[k]
        start, beyond, back = growth.horizon[k, 0], growth.horizon[k, 1], growth.horizon[k, 2]
        end = growth.horizon[k + 1 if k + 1 < n_edges else 0, 0]
        _span(points, growth, facet, start, end, apex)
        growth.across[beyond, back] = facet
        growth.across[facet, 0] = beyond
        growth.across[facet, 2] = before
        growth.across[before, 1] = facet
        before = facet


@compiled
def _span(points: Array, growth: Growth, facet: int, a: int, b: int, c: int) -> None:
    """Make a facet of three points."""
    corners, planes = growth.corners, growth.planes
    corners[facet, 0], corners[facet, 1], corners[facet, 2] = a, b, c
    x, y, z = _cross(*_from(points, c, a), *_from(points, c, b))
    scale = 1 / np.sqrt(x * x + y * y + z * z)
    planes[facet, 0], planes[facet, 1], planes[facet, 2] = x * scale, y * scale, z * scale
    planes[facet, 3] = -(x * points[c, 0] + y * points[c, 1] + z * points[c, 2]) * scale
    growth.above[facet] = NONE
    growth.seen_by[facet] = NONE


@compiled
def _from(points: Array, start: int, end: int) -> tuple[float, float, float]:
    return (
        points[end, 0] - points[start, 0],
        points[end, 1] - points[start, 1],
        points[end, 2] - points[start, 2],
    )


@compiled
def _cross(ax: float, ay: float, az: float, bx: float, by: float, bz: float) -> tuple[float, float, float]:
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
