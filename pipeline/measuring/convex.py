"""The convex hull of a body and its widths between parallel planes.

The width along a unit direction u is w(u) = max p.u - min p.u over the hull's vertices p: every size that
calipers, bars or holes can measure is one of the hull, and follows from w.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.spatial
from numpy.typing import NDArray

from pipeline.measuring.directions import half_sphere

Array = NDArray[np.float64]

CHUNK = 1 << 21
"""Products vertex x direction held in memory at a time."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConvexBody:
    """A convex hull, with its widths along the M directions of `half_sphere()`."""

    volume_mm3: float
    vertices_mm: Array  # (N, 3)
    touching_mm: Array  # (K, 3) the vertices that touch one of the 2 M planes
    width_mm: Array  # (M,)
    spans_mm: Array  # (M, 3) from the vertex that touches the lower plane to the one at the upper


def convex_body(points_mm: Array) -> ConvexBody:
    """The convex hull of points (N, 3) that do not lie in one plane."""
    hull = scipy.spatial.ConvexHull(points_mm)
    vertices_mm = hull.points[hull.vertices]
    directions, _ = half_sphere()
    upper, lower = touching(vertices_mm, directions)
    spans_mm = vertices_mm[upper] - vertices_mm[lower]
    return ConvexBody(
        volume_mm3=float(hull.volume),
        vertices_mm=vertices_mm,
        touching_mm=vertices_mm[np.union1d(upper, lower)],
        width_mm=np.einsum("ij,ij->i", spans_mm, directions),
        spans_mm=spans_mm,
    )


def touching(vertices_mm: Array, directions: Array) -> NDArray[np.int64]:
    """Indices (2, M) of the vertices that touch the upper and the lower plane normal to directions (M, 3)."""
    indices = np.empty((2, len(directions)), dtype=np.int64)
    for part in _parts(vertices_mm, directions):
        heights = directions[part] @ vertices_mm.T
        indices[0, part], indices[1, part] = heights.argmax(axis=1), heights.argmin(axis=1)
    return indices


def widths(vertices_mm: Array, directions: Array) -> Array:
    """Widths (M,) along unit directions (M, 3)."""
    width_mm = np.empty(len(directions))
    for part in _parts(vertices_mm, directions):
        heights = directions[part] @ vertices_mm.T
        width_mm[part] = heights.max(axis=1) - heights.min(axis=1)
    return width_mm


def _parts(vertices_mm: Array, directions: Array) -> Iterator[slice]:
    step = max(CHUNK // len(vertices_mm), 1)
    return (slice(i, i + step) for i in range(0, len(directions), step))
