"""Feret diameters and the dimensions of ASTM D4791 of a convex body.

With p and q the two vertices that touch the planes normal to u, w(v) >= (p - q).v for *every* direction v,
because p and q stay in the body. This bound turns the searches below from guesses into certificates.
"""

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.measuring.convex import ConvexBody, touching
from pipeline.measuring.directions import COVERING_RAD, half_sphere

Array = NDArray[np.float64]

WIDTH_TOLERANCE = 1e-4
"""Relative gap between the least width seen and the least one possible at which its search ends."""
MAX_DIRECTIONS = 128
"""Directions in which the greatest dimension is looked for; a longish body needs one or two."""
MAX_PRODUCTS = 1 << 21
"""Vertices times directions evaluated at a time in the search for the least width."""


def max_feret(body: ConvexBody) -> Array:
    """The vector (3,) between the two vertices farthest apart.

    Some direction of `half_sphere()` is within d = COVERING_RAD of the diameter D, hence the body is
    at least D cos d wide along it and both ends of the diameter lie within D (1 - cos d) of its
    planes: only those vertices are compared. Exact, unless the body is so round that more than
    `MAX_DIRECTIONS` qualify; then 1 - cos d = 0.12 % short at the very most.
    """
    directions, _ = half_sphere()
    slack = 1 - np.cos(COVERING_RAD)
    depth_mm = slack / (1 - slack) * body.width_mm.max()
    lengths_mm = np.linalg.norm(body.spans_mm, axis=1)
    best, best_mm = body.spans_mm[lengths_mm.argmax()], lengths_mm.max()
    widest = np.argsort(-body.width_mm)[:MAX_DIRECTIONS]
    for direction in directions[widest[body.width_mm[widest] >= best_mm * (1 - slack)]]:
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
    width seen are dropped, the others split into four. Of a nearly round body, where very many
    stay, only the most promising are split, and the certificate ends at the bound of the best left.
    """
    directions, triangles = half_sphere()
    corners, spans_mm = directions[triangles], body.spans_mm[triangles]
    least_mm = float(body.width_mm.min())
    n_split = int(np.clip(MAX_PRODUCTS // (3 * len(body.vertices_mm)), 32, 512))
    while True:
        bounds_mm = np.einsum("tik,tjk->tij", spans_mm, corners).min(axis=2).max(axis=1)
        promising = np.argsort(bounds_mm)[:n_split]
        promising = promising[bounds_mm[promising] < least_mm * (1 - WIDTH_TOLERANCE)]
        if len(promising) == 0:
            return least_mm
        corners, spans_mm = corners[promising], spans_mm[promising]
        middles = corners + corners[:, [1, 2, 0]]
        middles /= np.linalg.norm(middles, axis=2, keepdims=True)
        upper, lower = touching(body.vertices_mm, middles.reshape(-1, 3))
        middle_spans_mm = (body.vertices_mm[upper] - body.vertices_mm[lower]).reshape(-1, 3, 3)
        least_mm = min(least_mm, float(np.einsum("tij,tij->ti", middle_spans_mm, middles).min()))
        corners, spans_mm = _split(corners, middles), _split(spans_mm, middle_spans_mm)


def _split(corners: Array, middles: Array) -> Array:
    """Values at the corners (4 T, 3, 3) of the four parts of triangles whose sides have been halved."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = middles[:, 0], middles[:, 1], middles[:, 2]
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def extents_across(body: ConvexBody, axis: Array) -> tuple[float, float]:
    """Greatest dimension perpendicular to an axis (3,), and the dimension perpendicular to both; exact."""
    across = np.linalg.svd(axis[None, :])[2][1:]
    flat_mm = body.vertices_mm @ across.T
    flat_mm = flat_mm[scipy.spatial.ConvexHull(flat_mm).vertices]
    distances_mm = scipy.spatial.distance.squareform(scipy.spatial.distance.pdist(flat_mm))
    i, j = np.unravel_index(distances_mm.argmax(), distances_mm.shape)
    x, y = (flat_mm[i] - flat_mm[j]) / distances_mm[i, j]
    return float(distances_mm[i, j]), float(np.ptp(flat_mm @ [-y, x]))
