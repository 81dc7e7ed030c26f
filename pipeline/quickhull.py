"""The facets of the convex hull of a mesh, several times as fast as qhull's.

It is grown of every 16th vertex first: nearly all of the others are then inside, and each finds that out on its
own, by a walk from where the one before it ended.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.growing_hull import (
    NO_FACET,
    Growth,
    facets_of,
    grow,
    grow_surely,
    growth_for,
    height_above,
    put_above,
    restart_by_qhull,
    start,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

TOLERANCE = 3e-5
"""Points less than this share of the extent above the hull are left out."""
RUN = 16
"""Of so many points one is added before all the others, many of which then turn out to be inside."""


def hull_facets(points_mm: Array) -> tuple[Indices, Array]:
    """The facets of the convex hull of points (N, 3).

    Corners (F, 3), counter-clockwise seen from outside, and outward unit normals (F, 3). No point is more
    than `TOLERANCE` of the extent outside.

    Raises
    ------
    scipy.spatial.QhullError
        The points lie in one plane.
    """
    points = np.ascontiguousarray(points_mm)
    protruding, extent_mm = _protruding(points)
    growth = growth_for(len(points), extent_mm, TOLERANCE)
    every = np.arange(len(points), dtype=np.int32)
    if start(points, protruding, growth) and grow(points, growth) and _locate(points, growth, extent_mm):
        grow_surely(points, every, growth)
    else:
        restart_by_qhull(points, every, growth)
    facets = facets_of(growth)
    return facets.corners, facets.planes[:, :3]


@compiled
def _protruding(points: Array) -> tuple[Indices, float]:
    """Of every `RUN` points, which in a mesh are neighbours, the one farthest from the middle; and the extent."""
    low_x = low_y = low_z = np.inf
    high_x = high_y = high_z = -np.inf
    for i in range(len(points)):
        low_x, low_y, low_z = min(low_x, points[i, 0]), min(low_y, points[i, 1]), min(low_z, points[i, 2])
        high_x, high_y, high_z = (
            max(high_x, points[i, 0]),
            max(high_y, points[i, 1]),
            max(high_z, points[i, 2]),
        )
    middle_x, middle_y, middle_z = (low_x + high_x) / 2, (low_y + high_y) / 2, (low_z + high_z) / 2
    farthest = np.zeros((len(points) + RUN - 1) // RUN, np.int32)
    for run in range(len(farthest)):
        reach = -1.0
        for i in range(run * RUN, min(run * RUN + RUN, len(points))):
            x, y, z = points[i, 0] - middle_x, points[i, 1] - middle_y, points[i, 2] - middle_z
            if x * x + y * y + z * z > reach:
                reach, farthest[run] = x * x + y * y + z * z, i
    return farthest, max(high_x - low_x, high_y - low_y, high_z - low_z)


@compiled
def _locate(points: Array, growth: Growth, extent: float) -> bool:
    """Have all points wait above facets, walking to the facet on the ray from a point within the hull.

    A facet is left through a side where the point is behind the wall, the plane of that side and the
    origin. False when rounding leads in a circle.
    """
    n_places = growth.counts[0]
    origin, n_facets, last = np.zeros(3), 0, 0
    for facet in range(n_places):
        if growth.above[facet] != NO_FACET:
            origin += points[growth.corners[facet, 0]]
            n_facets, last = n_facets + 1, facet
    origin /= n_facets
    walls = np.empty((n_places, 3, 3))
    for facet in range(n_places):
        if growth.above[facet] == NO_FACET:
            continue
        for side in range(3):
            a, b = growth.corners[facet, side], growth.corners[facet, (side + 1) % 3]
            ax, ay, az = points[a, 0] - origin[0], points[a, 1] - origin[1], points[a, 2] - origin[2]
            bx, by, bz = points[b, 0] - origin[0], points[b, 1] - origin[1], points[b, 2] - origin[2]
            walls[facet, side, 0] = ay * bz - az * by
            walls[facet, side, 1] = az * bx - ax * bz
            walls[facet, side, 2] = ax * by - ay * bx
    least = -growth.rounding * extent * extent
    facet = last
    for point in range(len(points)):
        x, y, z = points[point, 0], points[point, 1], points[point, 2]
        fx, fy, fz = x - origin[0], y - origin[1], z - origin[2]
        n_steps = 0
        while True:
            height = height_above(growth, facet, x, y, z)
            if height > growth.tolerance:
                put_above(growth, facet, point, height)
                break
            side = 0
            while side < 3 and (
                walls[facet, side, 0] * fx + walls[facet, side, 1] * fy + walls[facet, side, 2] * fz > least
            ):
                side += 1
            if side == 3:
                break
            facet = growth.across[facet, side]
            n_steps += 1
            if n_steps > n_places:
                return False
    return True
