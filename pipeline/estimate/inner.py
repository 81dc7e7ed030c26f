"""A smallest body that explains all silhouettes: convex, and touching every tangent ray.

The visual hull is the largest body behind the silhouettes; the body itself lies between the two. Points
of short segments are known points of the surface, and so is their convex hull within the body's own. For
longer and longer segments it is extended, where it does not touch them yet, to the point nearest to it.
Of a body with corners and flat faces this leaves its convex hull; of a smooth one the chords, too small.
"""

from dataclasses import dataclass

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.estimate.tangents import Tangents
from pipeline.growing_hull import (
    NO_FACET,
    Facets,
    Growth,
    facets_of,
    grow_surely,
    growth_for,
    put_above,
    start,
)

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

SHARES = (0.1, 0.3, 0.55, 0.8)
"""Of the segments, by length: the first are points, the others are added batch by batch."""
TOUCH_MM = 0.01
"""Distance at which a segment counts as touched: a fifth of a pixel."""
CUTS = 4
TOLERANCE = 1e-8
"""Points so little above the body, as a share of its extent, are no corners of it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InnerBody:
    """A convex polyhedron, relative to the centre of the tangents."""

    points_mm: Array  # (N, 3) of each tangent; at the corners, where it touches
    facets: Facets  # their corners are tangents
    volume_mm3: float


def inner_body(tangents: Tangents) -> InnerBody | None:
    """The convex body that touches all segments; `None` when they do not span one."""
    order = np.argsort(tangents.lengths_mm).astype(np.int32)
    first, *batches = np.split(order, (np.array(SHARES) * len(order)).astype(int))
    if len(first) == 0:
        return None
    points_mm = tangents.points_mm + (tangents.low_mm + tangents.high_mm)[:, None] / 2 * tangents.directions
    extent_mm = float(np.ptp(points_mm[first], axis=0).max())
    growth = growth_for(len(order), extent_mm, TOLERANCE)
    if not start(points_mm, first, growth):
        return None
    added = first
    try:
        grow_surely(points_mm, added, growth)
        for batch in batches:
            added = np.concatenate([added, _approach(tangents.lines(), batch, growth, points_mm)])
            grow_surely(points_mm, added, growth)
    except scipy.spatial.QhullError:  # flat but for rounding
        return None
    facets = facets_of(growth)
    a, b, c = (points_mm[facets.corners[:, k]] for k in range(3))
    volume_mm3 = float(np.einsum("ij,ij->", a, np.cross(b, c))) / 6
    return InnerBody(points_mm=points_mm, facets=facets, volume_mm3=volume_mm3)


@compiled
def _approach(lines: Array, rays: Indices, growth: Growth, points_mm: Array) -> Indices:
    """Those of some rays that a convex body does not touch; their points nearest to it wait above its facets.

    `lines` (N, 8) are points, directions, and ends of the segments; the points found are put into `points_mm`.
    Along a ray the greatest height above a facet is convex and piecewise linear: two planes, one rising and one
    falling, meet below its minimum, and each step replaces one of them by the plane that is greatest there
    (Kelley's cutting planes in one dimension).
    """
    n, planes = len(rays), growth.planes
    at_mm = np.empty((3, n))
    t_mm, best_mm, best_t_mm = np.empty(n), np.full(n, np.inf), np.empty(n)
    best_facet = np.zeros(n, np.int32)
    # falling and rising plane of each ray: slope, and height where t is 0
    slopes, heights_mm = np.empty((2, n)), np.empty((2, n))
    for step in range(-2, CUTS):
        for i in range(n):
            line = lines[rays[i]]
            if step < 0:
                t_mm[i] = line[8 + step]
            elif slopes[0, i] >= 0:  # all rising: the minimum is at the near end
                t_mm[i] = line[6]
            elif slopes[1, i] <= 0:  # all falling
                t_mm[i] = line[7]
            else:
                cut_mm = (heights_mm[0, i] - heights_mm[1, i]) / (slopes[1, i] - slopes[0, i])
                t_mm[i] = min(max(cut_mm, line[6]), line[7])
            for k in range(3):
                at_mm[k, i] = line[k] + t_mm[i] * line[3 + k]
        height_mm, facet = _highest(at_mm, growth)
        for i in range(n):
            line = lines[rays[i]]
            plane = planes[facet[i]]
            slope = plane[0] * line[3] + plane[1] * line[4] + plane[2] * line[5]
            which = 2 + step if step < 0 else int(slope > 0)
            slopes[which, i] = slope
            heights_mm[which, i] = height_mm[i] - slope * t_mm[i]
            if step >= 0 and height_mm[i] < best_mm[i]:
                best_mm[i], best_t_mm[i], best_facet[i] = height_mm[i], t_mm[i], facet[i]
    missed = rays[best_mm > TOUCH_MM]
    for i in range(n):
        if best_mm[i] > TOUCH_MM:
            for k in range(3):
                points_mm[rays[i], k] = lines[rays[i], k] + best_t_mm[i] * lines[rays[i], 3 + k]
            put_above(growth, best_facet[i], rays[i], best_mm[i])
    return missed


@compiled
def _highest(points_mm: Array, growth: Growth) -> tuple[Array, NDArray[np.int64]]:
    """The greatest height of points (3, R) above a facet, and above which; in vectors, as the points are last."""
    n, planes = points_mm.shape[1], growth.planes
    highest_mm, index = np.full(n, -np.inf), np.zeros(n, np.int64)
    for facet in range(growth.counts[0]):
        if growth.above[facet] == NO_FACET:
            continue
        x, y, z, offset_mm = planes[facet, 0], planes[facet, 1], planes[facet, 2], planes[facet, 3]
        for i in range(n):
            height_mm = x * points_mm[0, i] + y * points_mm[1, i] + z * points_mm[2, i] + offset_mm
            is_higher = height_mm > highest_mm[i]
            highest_mm[i] = height_mm if is_higher else highest_mm[i]
            index[i] = facet if is_higher else index[i]
    return highest_mm, index
