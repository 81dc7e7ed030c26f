"""The facets of a convex hull (Quickhull: Barber, Dobkin and Huhdanpaa 1996), several times as fast as qhull's.

qhull makes the hull of a sample. Each facet knows the points above it; the highest of them becomes a vertex:
the facets that it sees are replaced by a cone from their horizon to it, and the points above them are handed
to the facets of the cone. Facets take turns, so that the hull grows from coarse to fine.

Rounding may make the facets that a point sees look as if they had a hole, for instance. Then qhull, which
merges facets that are nearly coplanar, does it all.
"""

from typing import NamedTuple

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.compiled import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

TOLERANCE = 3e-5
"""Points less than this share of the extent above the hull are left out."""
ROUNDING = 1e-13
"""A point so little above a facet, as a share of the extent, does not see it."""
N_SAMPLE = 16
RUN = 16
"""Of so many points one is added before all the others, many of which then turn out to be inside."""

NONE, NO_FACET = -1, -2


class _Growth(NamedTuple):
    """Facets in places that are used again, and the horizon of the latest vertex."""

    corners: Indices  # (K, 3) points
    across: Indices  # (K, 3) the facets beyond the edges from corner k to k + 1
    planes: Array  # (K, 4) outward normal, and what is added to its product with a point to get the height
    above: Indices  # (K,) the first of the points above; NONE, or NO_FACET
    highest: Indices  # (K,) of these points
    top: Array  # (K,) its height
    seen_by: Indices  # (K,) the last vertex that saw the facet
    following: Indices  # (N,) for each point the next one above the same facet

    visible: Indices  # (K,) facets that the latest vertex sees
    lists: Indices  # (K,) the first of the points above each of them
    horizon: Indices  # (K, 3) edges around them: start, end, facet beyond
    edge_from: Indices  # (N,) the edge that starts at a point
    edge_of: Indices  # (N,) the vertex to whose horizon that edge belongs
    new: Indices  # (K,) the facet from each edge to the latest vertex
    vacant: Indices  # (K,) places without a facet


def hull_facets(points_mm: Array) -> tuple[Indices, Array]:
    """The facets of the convex hull of points (N, 3).

    Corners (F, 3), counter-clockwise seen from outside, and outward unit normals (F, 3). No point is more
    than `TOLERANCE` of the extent outside.

    Raises
    ------
    scipy.spatial.QhullError
        The points lie in one plane.
    """
    stride = max(len(points_mm) // N_SAMPLE, 1)
    points = np.ascontiguousarray(points_mm - points_mm[::stride].mean(axis=0))  # the origin is inside
    points /= max(np.ptp(column) for column in points.T)
    try:
        corners, across, planes = _qhull(points[::stride])
    except scipy.spatial.QhullError:  # a flat sample
        corners, _, planes = _qhull(points)
        return corners, planes[:, :3]
    growth = _growth(stride * corners, across, planes, len(points))
    n_places = len(corners)
    for waiting in (_protruding(points), np.arange(len(points), dtype=np.int32)):
        is_located = _locate(points, growth, waiting, np.empty((n_places, 3, 3)))
        n_places = _grow(points, growth, n_places) if is_located else 0
        if n_places == 0:
            corners, _, planes = _qhull(points)
            return corners, planes[:, :3]
    is_facet = growth.above[:n_places] != NO_FACET
    return growth.corners[:n_places][is_facet], growth.planes[:n_places, :3][is_facet]


def _protruding(points: Array) -> Indices:
    """Of every `RUN` points, which in a mesh are neighbours, the one farthest from the origin."""
    n_runs = len(points) // RUN
    distances = np.einsum("ij,ij->i", points, points)[: n_runs * RUN].reshape(n_runs, RUN)
    return (distances.argmax(axis=1) + np.arange(0, n_runs * RUN, RUN)).astype(np.int32)


def _qhull(points: Array) -> tuple[Indices, Indices, Array]:
    """Facets as in `_Growth`: corners, facets across the edges, and planes."""
    hull = scipy.spatial.ConvexHull(points)
    a, b, c = (points[hull.simplices[:, k]] for k in range(3))
    is_inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3])[:, None] < 0
    corners = np.where(is_inward, hull.simplices[:, [0, 2, 1]], hull.simplices)
    opposite = np.where(is_inward, hull.neighbors[:, [0, 2, 1]], hull.neighbors)
    return corners.astype(np.int32), opposite[:, [2, 0, 1]].astype(np.int32), hull.equations


def _growth(corners: Indices, across: Indices, planes: Array, n_points: int) -> _Growth:
    """Room for the hull of N points, with the facets of a first one."""
    n_facets = len(corners)
    capacity = 3 * n_points + 100
    growth = _Growth(
        corners=np.empty((capacity, 3), np.int32),
        across=np.empty((capacity, 3), np.int32),
        planes=np.empty((capacity, 4)),
        above=np.empty(capacity, np.int32),
        highest=np.empty(capacity, np.int32),
        top=np.empty(capacity),
        seen_by=np.empty(capacity, np.int32),
        following=np.empty(n_points, np.int32),
        visible=np.empty(capacity, np.int32),
        lists=np.empty(capacity, np.int32),
        horizon=np.empty((capacity, 3), np.int32),
        edge_from=np.empty(n_points, np.int32),
        edge_of=np.full(n_points, NONE, np.int32),
        new=np.empty(capacity, np.int32),
        vacant=np.empty(capacity, np.int32),
    )
    growth.corners[:n_facets], growth.across[:n_facets], growth.planes[:n_facets] = corners, across, planes
    growth.above[:n_facets], growth.seen_by[:n_facets] = NONE, NONE
    return growth


@compiled
def _grow(points: Array, growth: _Growth, n_facets: int) -> int:
    """Places in use when no point is above a facet; 0 when rounding defeats the method."""
    n_places, n_vacant = n_facets, 0
    facet = 0
    for _ in range(len(points)):
        n_passed = 0
        while growth.above[facet] < 0:
            facet = facet + 1 if facet + 1 < n_places else 0
            n_passed += 1
            if n_passed > n_places:
                return n_places
        n_visible, n_new = _look(points, growth, facet)
        if n_new == 0:
            return 0
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
        _hand_out(points, growth, n_visible, n_new)
    return 0


@compiled
def _locate(points: Array, growth: _Growth, waiting: Indices, walls: Array) -> bool:
    """Give points to facets that they are above, walking to the facet on the ray from the origin.

    A facet is left through a side where the point is behind the wall, the plane of that side and the
    origin, whose inward normals are put into `walls` (K, 3, 3). False when rounding leads in a circle.
    """
    planes = growth.planes
    facet = 0
    for place in range(len(walls)):
        if growth.above[place] == NO_FACET:
            continue
        facet = place
        for side in range(3):
            a, b = growth.corners[place, side], growth.corners[place, (side + 1) % 3]
            ax, ay, az = points[a, 0], points[a, 1], points[a, 2]
            bx, by, bz = points[b, 0], points[b, 1], points[b, 2]
            walls[place, side, 0] = ay * bz - az * by
            walls[place, side, 1] = az * bx - ax * bz
            walls[place, side, 2] = ax * by - ay * bx
    for point in waiting:
        x, y, z = points[point, 0], points[point, 1], points[point, 2]
        n_steps = 0
        while True:
            height = planes[facet, 0] * x + planes[facet, 1] * y + planes[facet, 2] * z + planes[facet, 3]
            if height > TOLERANCE:
                _put_above(growth, facet, point, height)
                break
            side = 0
            while side < 3 and (
                walls[facet, side, 0] * x + walls[facet, side, 1] * y + walls[facet, side, 2] * z > -ROUNDING
            ):
                side += 1
            if side == 3:
                break
            facet = growth.across[facet, side]
            n_steps += 1
            if n_steps > len(walls):
                return False
    return True


@compiled
def _put_above(growth: _Growth, facet: int, point: int, height: float) -> None:
    if growth.above[facet] < 0 or height > growth.top[facet]:
        growth.top[facet] = height
        growth.highest[facet] = point
    growth.following[point] = growth.above[facet]
    growth.above[facet] = point


@compiled
def _hand_out(points: Array, growth: _Growth, n_lists: int, n_new: int) -> None:
    """Give each of the listed points to the first of the new facets that it is above."""
    planes, new = growth.planes, growth.new
    for k in range(n_lists):
        point = growth.lists[k]
        while point >= 0:
            x, y, z = points[point, 0], points[point, 1], points[point, 2]
            following = growth.following[point]
            for i in range(n_new):
                facet = new[i]
                height = planes[facet, 0] * x + planes[facet, 1] * y + planes[facet, 2] * z + planes[facet, 3]
                if height > TOLERANCE:
                    _put_above(growth, facet, point, height)
                    break
            point = following


@compiled
def _look(points: Array, growth: _Growth, first: int) -> tuple[int, int]:
    """How many facets the highest point above one sees, and how many edges their horizon has.

    No edges: the horizon is no ring.
    """
    planes, visible = growth.planes, growth.visible
    apex = growth.highest[first]
    x, y, z = points[apex, 0], points[apex, 1], points[apex, 2]
    visible[0] = first
    growth.seen_by[first] = apex
    n_visible, n_edges, k = 1, 0, 0
    while k < n_visible:
        facet = visible[k]
        k += 1
        for side in range(3):
            beyond = growth.across[facet, side]
            if growth.seen_by[beyond] == apex:
                continue
            height = planes[beyond, 0] * x + planes[beyond, 1] * y + planes[beyond, 2] * z + planes[beyond, 3]
            if height > ROUNDING:
                growth.seen_by[beyond] = apex
                visible[n_visible] = beyond
                n_visible += 1
                continue
            start = growth.corners[facet, side]
            if growth.edge_of[start] == apex:
                return n_visible, 0
            growth.edge_of[start] = apex
            growth.edge_from[start] = n_edges
            growth.horizon[n_edges, 0] = start
            growth.horizon[n_edges, 1] = growth.corners[facet, (side + 1) % 3]
            growth.horizon[n_edges, 2] = beyond
            n_edges += 1
    edge = 0
    for n_passed in range(1, n_edges + 1):
        end = growth.horizon[edge, 1]
        if growth.edge_of[end] != apex:
            return n_visible, 0
        edge = growth.edge_from[end]
        if edge == 0:
            return n_visible, n_edges if n_passed == n_edges else 0
    return n_visible, 0


@compiled
def _build_cone(points: Array, growth: _Growth, apex: int, n_edges: int) -> None:
    """A new facet from each edge of the horizon to the apex."""
    for k in range(n_edges):
        facet = growth.new[k]
        start, end, beyond = growth.horizon[k, 0], growth.horizon[k, 1], growth.horizon[k, 2]
        growth.corners[facet, 0], growth.corners[facet, 1], growth.corners[facet, 2] = start, end, apex
        x, y, z = points[apex, 0], points[apex, 1], points[apex, 2]
        ux, uy, uz = points[start, 0] - x, points[start, 1] - y, points[start, 2] - z
        vx, vy, vz = points[end, 0] - x, points[end, 1] - y, points[end, 2] - z
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        scale = 1 / np.sqrt(nx * nx + ny * ny + nz * nz)
        growth.planes[facet, 0], growth.planes[facet, 1], growth.planes[facet, 2] = (
            nx * scale,
            ny * scale,
            nz * scale,
        )
        growth.planes[facet, 3] = -(nx * x + ny * y + nz * z) * scale
        growth.above[facet] = NONE
        growth.seen_by[facet] = NONE
        for side in range(3):
            if growth.corners[beyond, side] == end:
                growth.across[beyond, side] = facet
        beside = growth.new[growth.edge_from[end]]
        growth.across[facet, 0] = beyond
        growth.across[facet, 1] = beside
        growth.across[beside, 2] = facet
