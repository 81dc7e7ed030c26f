"""The inner body: a smallest body that explains all silhouettes, convex, and touching every tangent ray.

The visual hull is the largest body behind the silhouettes; the body itself lies between the two. Where segments are
short, a point of the surface is known, and the convex hull of these points is within the body's own. Each of them is
the mean of those nearby, which measure the same place: the outermost would add up their errors. Batch by batch
of longer segments it is extended, where it does not touch them yet, to the point nearest to it. For a body with
corners and flat faces the result is its convex hull; for a smooth one it has chords, so that it is too small.
"""

from dataclasses import dataclass

import numpy as np
import scipy.spatial

from pipeline.arrays import Flags, Floats, Indices32, PointsMM, Singles, Values
from pipeline.compiled import compiled, compiled_within
from pipeline.estimate.tangents import Tangents
from pipeline.geometry.bounds import bounds
from pipeline.geometry.growing_hull import (
    NO_FACET,
    Facets,
    Growth,
    facets_of,
    grow,
    growth_for,
    put_above,
    start,
)
from pipeline.geometry.quickhull import restart_by_qhull

BATCH_ENDS = (0.1, 0.3, 0.55, 0.8)
"""Ends of the batches, as shares of the segments by length: the first batch counts as points, the last ends with 1."""
KNOWN_MM = 0.3
"""Length of a segment below which its middle counts as where the ray touches."""
NEAR_MM = 0.07
"""Standard deviation of the weights of contacts by distance, a pixel and a half: within it they measure one place.
"""
TOUCH_MM = 0.023
"""Distance at which a segment counts as touched: half a pixel."""
N_CUTS = 4
"""Cutting planes after the first two, by which the least height above the body is searched."""
TOLERANCE = 1e-8
"""Height above the body, as a share of its extent, up to which points are no corners of it."""
FALLING, RISING, T, BEST_T = 0, 2, 4, 5
"""Columns of the state of `_descend`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InnerBody:
    """A convex polyhedron, relative to the centre of the tangents."""

    points_mm: PointsMM  # (N, 3) a point of each tangent ray; at the corners, where it touches
    facets: Facets  # their corners are tangents
    solvers: Floats  # (F, 3, 3) turn a direction into its weights, up to scale, of a facet's corners
    volume_mm3: float


def inner_body(tangents: Tangents) -> InnerBody | None:
    """Return the convex body that touches all segments; `None` when they do not span one."""
    contacts_mm = tangents.points_mm + (tangents.low_mm + tangents.high_mm)[:, None] / 2 * tangents.directions
    to_mean_mm = np.zeros(contacts_mm.shape)
    _average(contacts_mm, tangents.lengths_mm < KNOWN_MM, to_mean_mm)
    points_mm = contacts_mm + to_mean_mm
    lines = np.column_stack(
        [tangents.points_mm + to_mean_mm, tangents.directions, tangents.low_mm, tangents.high_mm]
    )
    order = np.argsort(tangents.lengths_mm).astype(np.int32)
    first, *batches = np.split(order, (np.array(BATCH_ENDS) * len(order)).astype(int))
    if len(first) == 0:
        return None
    low_mm, high_mm = bounds(points_mm[first])
    growth = growth_for(len(order), float((high_mm - low_mm).max()), TOLERANCE)
    if not start(points_mm, first, growth):  # the best known ones all lie on one side
        first, batches = order, []
        if not start(points_mm, first, growth):
            return None
    added = first
    try:
        for batch in (first[:0], *batches):
            added = np.concatenate([added, _approach(lines, batch, growth, points_mm)])
            if not grow(points_mm, growth):
                restart_by_qhull(points_mm, added, growth)
    except scipy.spatial.QhullError:  # flat but for rounding
        return None
    facets = facets_of(growth)
    solvers = np.empty((len(facets.corners), 3, 3))
    volume_mm3 = _solve(points_mm, facets.corners, solvers)
    return InnerBody(points_mm=points_mm, facets=facets, solvers=solvers, volume_mm3=volume_mm3)


@compiled
def _average(contacts_mm: PointsMM, is_known: Flags, to_mean_mm: PointsMM) -> None:
    """Find the ways from known contacts (N, 3) to the weighted mean of those nearby.

    A convex body takes the outermost of many points: with an error of its own in each, it is too large where many are.
    """
    for i in range(len(contacts_mm)):
        if not is_known[i]:
            continue
        total = x = y = z = 0.0
        for j in range(len(contacts_mm)):
            dx = contacts_mm[j, 0] - contacts_mm[i, 0]
            dy = contacts_mm[j, 1] - contacts_mm[i, 1]
            dz = contacts_mm[j, 2] - contacts_mm[i, 2]
            square_mm2 = dx * dx + dy * dy + dz * dz
            if is_known[j] and square_mm2 < (3 * NEAR_MM) ** 2:
                weight = np.exp(-square_mm2 / (2 * NEAR_MM**2))
                total, x, y, z = total + weight, x + weight * dx, y + weight * dy, z + weight * dz
        to_mean_mm[i, 0], to_mean_mm[i, 1], to_mean_mm[i, 2] = x / total, y / total, z / total


def _approach(lines: Floats, rays: Indices32, growth: Growth, points_mm: PointsMM) -> Indices32:
    """Return those of the rays that a convex body does not touch, with their points nearest to it listed above facets.

    `lines` (N, 8) are points, directions, and ends of the segments; the points found are put into `points_mm`.
    """
    n = len(rays)
    state, height_mm = np.empty((n, 6)), np.full(n, np.inf)
    search = (
        np.empty((3, n), np.float32),
        np.empty(n, np.float32),
        np.empty(n, np.int32),
        np.empty(n, np.int32),
    )
    _descend(lines, rays, growth, points_mm, state, height_mm, search)
    return rays[height_mm > TOUCH_MM]


@compiled
def _descend(
    lines: Floats,
    rays: Indices32,
    growth: Growth,
    points_mm: PointsMM,
    state: Floats,
    least_mm: Values,
    search: tuple[Singles, Singles, Indices32, Indices32],
) -> None:
    """Find the least heights (R,) of rays above a convex body, and list the points of those that miss it.

    Along a ray the greatest height above a facet is convex and piecewise linear: two planes, one rising and one
    falling, meet below its minimum, and each step replaces one of them by the plane that is greatest there
    (Kelley's cutting planes in one dimension). Columns of the `state` (R, 6) are slopes of the FALLING and of the
    RISING plane, each with its height where t is 0; T; and the best of all T so far. `search` is scratch.
    """
    planes, (at_mm, highest_mm, facets, best) = growth.planes, search
    for step in range(2 + N_CUTS):
        for i in range(len(rays)):
            ray = rays[i]
            t_mm = lines[ray, 7] if step == 1 or (step > 1 and state[i, RISING] <= 0) else lines[ray, 6]
            if step > 1 and state[i, FALLING] < 0 < state[i, RISING]:
                cut_mm = (state[i, FALLING + 1] - state[i, RISING + 1]) / (
                    state[i, RISING] - state[i, FALLING]
                )
                t_mm = min(max(cut_mm, lines[ray, 6]), lines[ray, 7])
            state[i, T] = t_mm
            for k in range(3):
                at_mm[k, i] = lines[ray, k] + t_mm * lines[ray, 3 + k]
        _find_highest(at_mm, growth, highest_mm, facets)
        for i in range(len(rays)):
            ray, facet, t_mm = rays[i], facets[i], state[i, T]
            slope = height_mm = 0.0
            for k in range(3):
                slope += planes[facet, k] * lines[ray, 3 + k]
                height_mm += planes[facet, k] * lines[ray, k]
            height_mm += planes[facet, 3]
            column = RISING if step == 1 or (step > 1 and slope > 0) else FALLING
            state[i, column], state[i, column + 1] = slope, height_mm
            if step > 1 and height_mm + t_mm * slope < least_mm[i]:
                least_mm[i], state[i, BEST_T] = height_mm + t_mm * slope, t_mm
                best[i] = facet
    for i in range(len(rays)):
        if least_mm[i] > TOUCH_MM:
            for k in range(3):
                points_mm[rays[i], k] = lines[rays[i], k] + state[i, BEST_T] * lines[rays[i], 3 + k]
            put_above(growth, best[i], rays[i], least_mm[i])


@compiled_within
def _find_highest(points_mm: Singles, growth: Growth, highest_mm: Singles, index: Indices32) -> None:
    """Find the greatest height (R,) of points (3, R) above a facet, and its index; in vectors, as points are last."""
    planes = growth.planes
    highest_mm[:] = -np.inf
    for facet in range(growth.counts[0]):
        if growth.above[facet] == NO_FACET:
            continue
        x, y = np.float32(planes[facet, 0]), np.float32(planes[facet, 1])
        z, offset_mm = np.float32(planes[facet, 2]), np.float32(planes[facet, 3])
        for i in range(len(index)):
            height_mm = x * points_mm[0, i] + y * points_mm[1, i] + z * points_mm[2, i] + offset_mm
            is_higher = height_mm > highest_mm[i]
            highest_mm[i] = height_mm if is_higher else highest_mm[i]
            index[i] = facet if is_higher else index[i]


@compiled
def _solve(points_mm: PointsMM, corners: Indices32, solvers: Floats) -> float:
    """Fill in `InnerBody.solvers`, the cross products of each facet's corners; return the volume in mm3."""
    sixfold_mm3 = 0.0
    for facet in range(len(corners)):
        for k in range(3):
            b, c = corners[facet, (k + 1) % 3], corners[facet, (k + 2) % 3]
            bx, by, bz = points_mm[b, 0], points_mm[b, 1], points_mm[b, 2]
            cx, cy, cz = points_mm[c, 0], points_mm[c, 1], points_mm[c, 2]
            solvers[facet, k, 0] = by * cz - bz * cy
            solvers[facet, k, 1] = bz * cx - bx * cz
            solvers[facet, k, 2] = bx * cy - by * cx
        for k in range(3):
            sixfold_mm3 += points_mm[corners[facet, 0], k] * solvers[facet, 0, k]
    return sixfold_mm3 / 6
