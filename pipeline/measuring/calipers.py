"""Feret diameters and the dimensions of ASTM D4791 of a convex body.

If p and q are the two vertices that touch the tangent planes normal to u, then w(v) >= (p - q).v for *every*
direction v, because p and q belong to the body. With this bound the searches below prove their results.
"""

import math

import numpy as np
import scipy.spatial

from pipeline.arrays import Floats, Indices32, Vector
from pipeline.compiled import compiled, compiled_within
from pipeline.measuring.convex import ConvexBody, Edges, touch, unit
from pipeline.measuring.directions import COVERING_RAD, half_sphere

WIDTH_TOLERANCE = 1e-4
"""Relative gap between the least width found and its lower bound at which the search ends."""
NEAR = 0.004
"""Relative gap between the least widths of estimate and hull within which neither is nearer to the truth: so much wider
is an arc of 10 degrees between two tangent planes than its chord."""
MAX_DIRECTIONS = 128
"""Largest number of directions in which the greatest dimension is looked for; a longish body needs one or two."""
MAX_OPEN = 160
"""Capacity of the stack of open parts of a triangle: three of each size."""
MANY_POINTS = 400
"""Beyond this number of points in a plane, pairs are compared on their convex hull only."""
RIM = 1e-9
"""A facet whose unit normal has no larger component along the axis belongs to both sides."""


def farthest_vertices(body: ConvexBody) -> tuple[Vector, Vector]:
    """Return the two vertices that are farthest apart.

    Some direction of `half_sphere()` is within d = COVERING_RAD of the diameter D, hence the body is
    at least D cos d wide along it and both ends of the diameter lie within D (1 - cos d) of its
    planes: only those vertices are compared. Exact, unless the body is so round that more than
    `MAX_DIRECTIONS` qualify; then 1 - cos d = 0.12 % short at the very most.
    """
    directions = half_sphere().directions
    slack = 1 - np.cos(COVERING_RAD)
    depth_mm = slack / (1 - slack) * body.width_mm.max()
    upper, lower = (body.vertices_mm.take(body.touching[:, end], axis=0) for end in (0, 1))
    spans_mm = upper - lower
    lengths_mm = np.sqrt(np.vecdot(spans_mm, spans_mm))
    widest = lengths_mm.argmax()
    best, best_mm = (upper[widest], lower[widest]), lengths_mm[widest]
    wide = np.flatnonzero(body.width_mm >= best_mm * (1 - slack))
    for direction in directions[wide[body.width_mm[wide].argsort()[: -MAX_DIRECTIONS - 1 : -1]]]:
        heights = body.vertices_mm @ direction
        upper = body.vertices_mm[heights >= heights.max() - depth_mm]
        lower = body.vertices_mm[heights <= heights.min() + depth_mm]
        distances_mm = scipy.spatial.distance.cdist(upper, lower)
        i, j = np.unravel_index(distances_mm.argmax(), distances_mm.shape)
        if distances_mm[i, j] > best_mm:
            best, best_mm = (upper[i], lower[j]), distances_mm[i, j]
    return best


def max_feret(body: ConvexBody) -> Vector:
    """Return the vector between the two vertices that are farthest apart."""
    upper, lower = farthest_vertices(body)
    return upper - lower


def min_feret_mm(body: ConvexBody) -> float:
    """Return the least width of a body, exact within `WIDTH_TOLERANCE`."""
    return min_feret(body)[0]


def min_feret(body: ConvexBody) -> tuple[float, Vector]:
    """Return the least width of a body, exact within `WIDTH_TOLERANCE`, and its unit direction (3,).

    Branch and bound over the triangles of `half_sphere()`: inside a triangle with corners u_i the
    width is nowhere less than max_i min_j (p_i - q_i).u_j. Triangles that cannot beat the least
    width found so far are dropped, the others split into four.
    """
    sphere = half_sphere()
    narrowest = body.width_mm.argmin()
    direction = sphere.directions[narrowest].copy()
    corners, ends = np.empty((3 * MAX_OPEN, 3)), np.empty((3 * MAX_OPEN, 2), np.int32)
    least_mm = _least_width_mm(
        body.edges,
        sphere.directions,
        sphere.triangles,
        body.touching,
        corners,
        ends,
        float(body.width_mm[narrowest]),
        direction,
    )
    return least_mm, direction


def least_width_within_mm(estimate_mm: float, hull_mm: float) -> float:
    """Return the least width of a body, given those of its estimate and of its hull: the estimate's, or a mean of both.

    A round bar is nearly as thin from all sides; its estimate is flat between the planes that were seen and thinnest
    where it is flattest, while the planes that were seen cut the hull to the bar's own width. The mean of both counts
    where they are close. Where the thinnest side was not seen, the hull is much wider and tells nothing.
    """
    gap = (hull_mm - estimate_mm) / (NEAR * estimate_mm)
    return estimate_mm + min(max(2 - gap, 0.0), 1.0) / 2 * (hull_mm - estimate_mm)


@compiled
def _least_width_mm(
    edges: Edges,
    directions: Floats,
    triangles: Indices32,
    touching: Indices32,
    corners: Floats,
    ends: Indices32,
    least_mm: float,
    best: Vector,
) -> float:
    """Return the least width, and set `best` to its direction if one is found below `least_mm`.

    `corners` (3 P, 3) and `ends` (3 P, 2), their tangent vertices, are work arrays.
    """
    for triangle in range(len(triangles)):
        for k in range(3):
            direction = triangles[triangle, k]
            for i in range(3):
                corners[k, i] = directions[direction, i]
            for i in range(2):
                ends[k, i] = touching[direction, i]
        n_open = 1
        while n_open > 0:
            n_open -= 1
            part = 3 * n_open
            if _bound_mm(edges, corners, ends, part) >= least_mm * (1 - WIDTH_TOLERANCE):
                continue
            if n_open + 4 > MAX_OPEN:  # only rounding errors are left
                continue
            middle = part + 9
            for k in range(3):
                one, other = part + k, part + (k + 1) % 3
                x, y, z = unit(
                    corners[one, 0] + corners[other, 0],
                    corners[one, 1] + corners[other, 1],
                    corners[one, 2] + corners[other, 2],
                )
                corners[middle + k, 0], corners[middle + k, 1], corners[middle + k, 2] = x, y, z
                ends[middle + k, 0], ends[middle + k, 1] = ends[one, 0], ends[one, 1]
                width_mm = touch(edges, x, y, z, ends, middle + k)
                if width_mm < least_mm:
                    least_mm = width_mm
                    best[0], best[1], best[2] = x, y, z
            # the parts at corners 1 and 2 are (m0, c1, m1) and (m2, m1, c2); (c0, m0, m2) replaces the whole
            _copy(corners, ends, part + 1, part + 4)
            _copy(corners, ends, part + 2, part + 8)
            for k in range(2):
                _copy(corners, ends, middle, part + 3 - 2 * k)
                _copy(corners, ends, middle + 1, part + 5 + 2 * k)
                _copy(corners, ends, middle + 2, part + 6 - 4 * k)
            n_open += 4
    return least_mm


@compiled_within
def _copy(corners: Floats, ends: Indices32, row: int, to_row: int) -> None:
    for i in range(3):
        corners[to_row, i] = corners[row, i]
    for i in range(2):
        ends[to_row, i] = ends[row, i]


@compiled_within
def _bound_mm(edges: Edges, corners: Floats, ends: Indices32, part: int) -> float:
    """Return a lower bound of the widths along all directions in the triangle whose corners begin at row `part`."""
    points = edges.vertices_mm
    bound_mm = 0.0
    for i in range(part, part + 3):
        upper, lower = ends[i, 0], ends[i, 1]
        x = points[upper, 0] - points[lower, 0]
        y = points[upper, 1] - points[lower, 1]
        z = points[upper, 2] - points[lower, 2]
        least_mm = np.inf
        for j in range(part, part + 3):
            least_mm = min(least_mm, x * corners[j, 0] + y * corners[j, 1] + z * corners[j, 2])
        bound_mm = max(bound_mm, least_mm)
    return bound_mm


def extents_across(body: ConvexBody, axis: Vector) -> tuple[float, float]:
    """Return the greatest dimension perpendicular to an axis, and the dimension perpendicular to both; exact.

    Units are those of the body, mm. The axis need not be a unit vector.
    """
    width_mm, thickness_mm, _ = widest_across(body, axis)
    return width_mm, thickness_mm


def widest_across(body: ConvexBody, axis: Vector) -> tuple[float, float, Vector]:
    """Return the same two dimensions, and the unit direction (3,) of the first."""
    along = body.normals @ (axis / np.linalg.norm(axis))
    is_near, is_far = np.zeros((2, len(body.vertices_mm)), bool)
    is_near[body.facets.compress(along >= -RIM, axis=0)] = True
    is_far[body.facets.compress(along <= RIM, axis=0)] = True
    plane = _across(axis)
    flat_mm = body.vertices_mm.compress(is_near & is_far, axis=0) @ plane.T
    if len(flat_mm) > MANY_POINTS:
        flat_mm = flat_mm[scipy.spatial.ConvexHull(flat_mm).vertices]
    distances_mm = scipy.spatial.distance.cdist(flat_mm, flat_mm)
    i, j = np.unravel_index(distances_mm.argmax(), distances_mm.shape)
    u, v = (flat_mm[i] - flat_mm[j]) / distances_mm[i, j]
    return float(distances_mm[i, j]), float(np.ptp(flat_mm @ [-v, u])), np.array([u, v]) @ plane


def _across(axis: Vector) -> Floats:
    """Return two unit vectors (2, 3) perpendicular to an axis and to each other (Duff et al. 2017)."""
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    sign = math.copysign(1.0, z)
    a = -1 / (sign + z)
    return np.array([[1 + sign * x * x * a, sign * x * y * a, -sign * x], [x * y * a, sign + y * y * a, -y]])
