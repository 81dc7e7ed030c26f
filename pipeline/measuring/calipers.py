"""Widths of a convex body between parallel planes: Feret diameters and the triple of ASTM D4791.

The width along a unit direction u is w(u) = max p.u - min p.u over the vertices p. With p and q the two
vertices that touch the planes, w(v) >= (p - q).v for *every* direction v, because p and q stay in the
body. This bound turns the searches below from guesses into certificates.
"""

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.measuring.directions import COVERING_RAD, half_sphere

Array = NDArray[np.float64]

WIDTH_TOLERANCE = 1e-4
"""Relative gap between the least width seen and the least one possible at which its search ends."""
MAX_TRIANGLES = 512
"""Triangles of directions split at a time: more can hold the least width only of a nearly round body."""
CHUNK = 1 << 21
"""Products vertex x direction held in memory at a time."""


def widths(vertices_mm: Array, directions: Array) -> tuple[Array, Array]:
    """Widths (M,) along unit directions (M, 3), and the vectors p - q (M, 3) between the touching vertices."""
    width_mm = np.empty(len(directions))
    spans_mm = np.empty((len(directions), 3))
    step = max(CHUNK // len(vertices_mm), 1)
    for i in range(0, len(directions), step):
        heights = directions[i : i + step] @ vertices_mm.T
        top, bottom = heights.argmax(axis=1), heights.argmin(axis=1)
        rows = np.arange(len(heights))
        width_mm[i : i + step] = heights[rows, top] - heights[rows, bottom]
        spans_mm[i : i + step] = vertices_mm[top] - vertices_mm[bottom]
    return width_mm, spans_mm


def max_feret(vertices_mm: Array, width_mm: Array, spans_mm: Array) -> Array:
    """The vector (3,) between the two vertices farthest apart; exact.

    `width_mm` and `spans_mm` are the `widths` along `half_sphere()`. Some direction of that set is
    within d = COVERING_RAD of the diameter D, hence the body is at least D cos d wide along it and
    both ends of the diameter lie within D (1 - cos d) of its planes: only those vertices are compared.
    """
    directions, _ = half_sphere()
    slack = 1 - np.cos(COVERING_RAD)
    depth_mm = slack / (1 - slack) * width_mm.max()
    lengths_mm = np.linalg.norm(spans_mm, axis=1)
    best = spans_mm[lengths_mm.argmax()]
    for direction in directions[width_mm >= lengths_mm.max() * (1 - slack)]:
        heights = vertices_mm @ direction
        upper = vertices_mm[heights >= heights.max() - depth_mm]
        lower = vertices_mm[heights <= heights.min() + depth_mm]
        distances_mm = scipy.spatial.distance.cdist(upper, lower)
        i, j = np.unravel_index(distances_mm.argmax(), distances_mm.shape)
        if distances_mm[i, j] > np.linalg.norm(best):
            best = upper[i] - lower[j]
    return best


def min_feret_mm(vertices_mm: Array, width_mm: Array, spans_mm: Array) -> float:
    """The least width, exact within `WIDTH_TOLERANCE`.

    Branch and bound over the triangles of `half_sphere()`: inside a triangle with corners u_i the
    width is nowhere less than max_i min_j (p_i - q_i).u_j. Triangles that cannot beat the least
    width seen are dropped, the others split into four. Where more than `MAX_TRIANGLES` stay, the
    most promising are split and the certificate ends at the bound of the best one left.
    """
    directions, triangles = half_sphere()
    corners, spans_mm = directions[triangles], spans_mm[triangles]
    least_mm = float(width_mm.min())
    while True:
        bounds_mm = np.einsum("tik,tjk->tij", spans_mm, corners).min(axis=2).max(axis=1)
        promising = np.argsort(bounds_mm)[:MAX_TRIANGLES]
        promising = promising[bounds_mm[promising] < least_mm * (1 - WIDTH_TOLERANCE)]
        if len(promising) == 0:
            return least_mm
        corners, spans_mm = corners[promising], spans_mm[promising]
        middles = corners + corners[:, [1, 2, 0]]
        middles /= np.linalg.norm(middles, axis=2, keepdims=True)
        middle_width_mm, middle_spans_mm = widths(vertices_mm, middles.reshape(-1, 3))
        least_mm = min(least_mm, float(middle_width_mm.min()))
        corners = _split(corners, middles)
        spans_mm = _split(spans_mm, middle_spans_mm.reshape(-1, 3, 3))


def _split(corners: Array, middles: Array) -> Array:
    """Values at the corners (4 T, 3, 3) of the four parts of triangles whose sides have been halved."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = middles[:, 0], middles[:, 1], middles[:, 2]
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def extents_across(vertices_mm: Array, axis: Array) -> tuple[float, float]:
    """Greatest dimension perpendicular to an axis (3,), and the dimension perpendicular to both; exact."""
    across = np.linalg.svd(axis[None, :])[2][1:]
    flat_mm = vertices_mm @ across.T
    flat_mm = flat_mm[scipy.spatial.ConvexHull(flat_mm).vertices]
    distances_mm = scipy.spatial.distance.squareform(scipy.spatial.distance.pdist(flat_mm))
    i, j = np.unravel_index(distances_mm.argmax(), distances_mm.shape)
    x, y = (flat_mm[i] - flat_mm[j]) / distances_mm[i, j]
    return float(distances_mm[i, j]), float(np.ptp(flat_mm @ [-y, x]))
