"""Feret diameters and the dimensions of ASTM D4791 of a convex body.

With p and q the two vertices that touch the planes normal to u, w(v) >= (p - q).v for *every* direction v,
because p and q stay in the body. This bound turns the searches below from guesses into certificates.
"""

import math

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.compiled import compiled, compiled_within
from pipeline.measuring.convex import ConvexBody, Edges, touch, unit
from pipeline.measuring.directions import COVERING_RAD, half_sphere

Array = NDArray[np.float64]
Indices = NDArray[np.int32]

WIDTH_TOLERANCE = 1e-4
"""Relative gap between the least width seen and the least one possible at which its search ends."""
MAX_DIRECTIONS = 128
"""Directions in which the greatest dimension is looked for; a longish body needs one or two."""
MAX_OPEN = 160
"""Parts of a triangle still to be looked at, three of each size."""
MANY_POINTS = 400
"""Of more than so many in a plane the convex hull is found before each is compared with each."""
RIM = 1e-9
"""A facet so steep (its normal's part along the axis) belongs to either side."""


def max_feret(body: ConvexBody) -> Array:
    """The vector (3,) between the two vertices farthest apart.

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
    best, best_mm = spans_mm[lengths_mm.argmax()], lengths_mm.max()
    wide = np.flatnonzero(body.width_mm >= best_mm * (1 - slack))
    for direction in directions[wide[body.width_mm[wide].argsort()[: -MAX_DIRECTIONS - 1 : -1]]]:
        heights = body.vertices_mm @ direction
        upper = body.vertices_mm[heights >= heights.max() - depth_mm]
        lower = body.vertices_mm[heights <= heights.min() + depth_mm]
        distances_mm = scipy.spatial.distance.cdist(upper, lower)
        i, j = np.unravel_index(distances_mm.argmax(), distances_mm.shape)
        if distances_mm[i, j] > best_mm:
            best, best_mm = upper[i] - lower[j], distances_mm[i, j]
    return best


def min_feret_mm(body: ConvexBody) -> float:
    """The least width, exact within `WIDTH_TOLERANCE`.

    Branch and bound over the triangles of `half_sphere()`: inside a triangle with corners u_i the
    width is nowhere less than max_i min_j (p_i - q_i).u_j. Triangles that cannot beat the least
    width seen are dropped, the others split into four.
    """
    sphere = half_sphere()
    least_mm = float(body.width_mm.min())
    corners, at = np.empty((3 * MAX_OPEN, 3)), np.empty((3 * MAX_OPEN, 2), np.int32)
    return _least_width_mm(
        body.edges, sphere.directions, sphere.triangles, body.touching, corners, at, least_mm
    )


@compiled
def _least_width_mm(
    edges: Edges,
    directions: Array,
    triangles: Indices,
    touching: Indices,
    corners: Array,
    at: Indices,
    least_mm: float,
) -> float:
    """The corners (3 P, 3) of parts of triangles and where they touch are room for the search."""
    for triangle in range(len(triangles)):
        for k in range(3):
            direction = triangles[triangle, k]
            for i in range(3):
                corners[k, i] = directions[direction, i]
            for i in range(2):
                at[k, i] = touching[direction, i]
        n_open = 1
        while n_open > 0:
            n_open -= 1
            part = 3 * n_open
            if _bound_mm(edges, corners, at, part) >= least_mm * (1 - WIDTH_TOLERANCE):
                continue
            if n_open + 4 > MAX_OPEN:  # nothing but rounding is left
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
                at[middle + k, 0], at[middle + k, 1] = at[one, 0], at[one, 1]
                least_mm = min(least_mm, touch(edges, x, y, z, at, middle + k))
            # the parts at corners 1 and 2 are (m0, c1, m1) and (m2, m1, c2); (c0, m0, m2) replaces the whole
            _copy(corners, at, part + 1, part + 4)
            _copy(corners, at, part + 2, part + 8)
            for k in range(2):
                _copy(corners, at, middle, part + 3 - 2 * k)
                _copy(corners, at, middle + 1, part + 5 + 2 * k)
                _copy(corners, at, middle + 2, part + 6 - 4 * k)
            n_open += 4
    return least_mm


@compiled_within
def _copy(corners: Array, at: Indices, row: int, to_row: int) -> None:
    for i in range(3):
        corners[to_row, i] = corners[row, i]
    for i in range(2):
        at[to_row, i] = at[row, i]


@compiled_within
def _bound_mm(edges: Edges, corners: Array, at: Indices, part: int) -> float:
    """No direction within the triangle whose corners begin at a row has a width below this."""
    points = edges.vertices_mm
    bound_mm = 0.0
    for i in range(part, part + 3):
        upper, lower = at[i, 0], at[i, 1]
        x = points[upper, 0] - points[lower, 0]
        y = points[upper, 1] - points[lower, 1]
        z = points[upper, 2] - points[lower, 2]
        least_mm = np.inf
        for j in range(part, part + 3):
            least_mm = min(least_mm, x * corners[j, 0] + y * corners[j, 1] + z * corners[j, 2])
        bound_mm = max(bound_mm, least_mm)
    return bound_mm


def extents_across(body: ConvexBody, axis: Array) -> tuple[float, float]:
    """Greatest dimension perpendicular to an axis (3,), and the dimension perpendicular to both; exact."""
    along = body.normals @ (axis / np.linalg.norm(axis))
    is_near, is_far = np.zeros((2, len(body.vertices_mm)), bool)
    is_near[body.facets.compress(along >= -RIM, axis=0)] = True
    is_far[body.facets.compress(along <= RIM, axis=0)] = True
    flat_mm = body.vertices_mm.compress(is_near & is_far, axis=0) @ _across(axis).T
    if len(flat_mm) > MANY_POINTS:
        flat_mm = flat_mm[scipy.spatial.ConvexHull(flat_mm).vertices]
    distances_mm = scipy.spatial.distance.cdist(flat_mm, flat_mm)
    i, j = np.unravel_index(distances_mm.argmax(), distances_mm.shape)
    u, v = (flat_mm[i] - flat_mm[j]) / distances_mm[i, j]
    return float(distances_mm[i, j]), float(np.ptp(flat_mm @ [-v, u]))


def _across(axis: Array) -> Array:
    """Two unit vectors (2, 3) perpendicular to an axis (3,) and to each other (Duff et al. 2017)."""
    x, y, z = (axis / np.linalg.norm(axis)).tolist()
    sign = math.copysign(1.0, z)
    a = -1 / (sign + z)
    return np.array([[1 + sign * x * x * a, sign * x * y * a, -sign * x], [x * y * a, sign + y * y * a, -y]])
