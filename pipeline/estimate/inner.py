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

Array = NDArray[np.float64]
Single = NDArray[np.float32]

SHARES = (0.1, 0.3, 0.55, 0.8)
"""Of the segments, by length: the first are points, the others are added batch by batch."""
TOUCH_MM = 0.01
"""Distance at which a segment counts as touched: a fifth of a pixel."""
CUTS = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InnerBody:
    """A convex polyhedron, relative to the centre of the tangents; not all its points need be corners."""

    points_mm: Array  # (P, 3)
    rays: NDArray[np.int64]  # (P,) the tangent whose point of contact each is
    faces: NDArray[np.int64]  # (F, 3) counter-clockwise seen from outside
    neighbors: NDArray[np.int64]  # (F, 3) the faces opposite to these corners
    normals: Array  # (F, 3) of the faces, outwards
    offsets_mm: Array  # (F,) distances of the faces' planes from the centre, negative behind it
    volume_mm3: float


def inner_body(tangents: Tangents) -> InnerBody | None:
    """The convex body that touches all segments; `None` when they do not span one."""
    order = np.argsort(tangents.lengths_mm)
    first, *batches = np.split(order, (np.array(SHARES) * len(order)).astype(int))
    rays, points_mm = first, tangents.at(first, (tangents.low_mm + tangents.high_mm)[first] / 2)
    try:
        hull = scipy.spatial.ConvexHull(points_mm)
        for batch in batches:
            t_mm, distance_mm = _nearest(tangents, batch, hull.equations)
            missed = distance_mm > TOUCH_MM
            if missed.any():
                rays = np.concatenate([rays[hull.vertices], batch[missed]])
                added_mm = tangents.at(batch[missed], t_mm[missed].astype(np.float64))
                hull = scipy.spatial.ConvexHull(np.vstack([hull.points[hull.vertices], added_mm]))
    except (scipy.spatial.QhullError, ValueError):  # flat, or too few points
        return None
    inward = _are_inward(hull)
    return InnerBody(
        points_mm=hull.points,
        rays=rays,
        faces=_turned(hull.simplices, inward),
        neighbors=_turned(hull.neighbors, inward),
        normals=hull.equations[:, :3],
        offsets_mm=-hull.equations[:, 3],
        volume_mm3=float(hull.volume),
    )


def _nearest(tangents: Tangents, rays: NDArray[np.int64], planes: Array) -> tuple[Single, Single]:
    """Where on their segments rays (R,) come nearest to a convex body, and how near.

    The body is `planes[:, :3] @ x + planes[:, 3] <= 0`. Along a ray the greatest of these values is convex
    and piecewise linear: two planes, one rising and one falling, meet below its minimum, and each step
    replaces one of them by the plane that is greatest there (Kelley's cutting planes in one dimension).
    """
    normals, single = planes[:, :3].astype(np.float32), np.float32
    slopes = normals @ tangents.directions[rays].T.astype(single)
    heights_mm = normals @ tangents.points_mm[rays].T.astype(single)
    heights_mm += planes[:, 3:].astype(single)
    low_mm, high_mm = (end[rays].astype(single) for end in (tangents.low_mm, tangents.high_mm))
    every = np.arange(len(rays))

    def greatest(t_mm: Single) -> tuple[Single, Single, Single]:
        value_mm, index = _greatest(heights_mm, slopes, t_mm)
        return value_mm, slopes[index, every], heights_mm[index, every]

    _, falling, falling_mm = greatest(low_mm)
    _, rising, rising_mm = greatest(high_mm)
    best_mm, t_mm = np.full(len(rays), np.inf, np.float32), low_mm
    for _ in range(CUTS):
        with np.errstate(divide="ignore", invalid="ignore"):
            cut_mm = (falling_mm - rising_mm) / (rising - falling)
        # all rising: the minimum is at the near end; all falling: at the far one
        cut_mm = np.where(falling >= 0, low_mm, np.where(rising <= 0, high_mm, cut_mm))
        cut_mm = np.clip(cut_mm, low_mm, high_mm)
        value_mm, slope, height_mm = greatest(cut_mm)
        better = value_mm < best_mm
        best_mm, t_mm = np.where(better, value_mm, best_mm), np.where(better, cut_mm, t_mm)
        up = slope > 0
        rising, rising_mm = np.where(up, slope, rising), np.where(up, height_mm, rising_mm)
        falling, falling_mm = np.where(up, falling, slope), np.where(up, falling_mm, height_mm)
    return t_mm, best_mm


@compiled
def _greatest(heights_mm: Single, slopes: Single, t_mm: Single) -> tuple[Single, NDArray[np.int32]]:
    """The greatest value (R,) at `t_mm` (R,) of lines (P, R), and which it is; in vectors, as the rays are last."""
    best_mm, index = np.full(len(t_mm), -np.inf, np.float32), np.zeros(len(t_mm), np.int32)
    for plane in range(len(slopes)):
        for ray in range(len(t_mm)):
            value_mm = heights_mm[plane, ray] + t_mm[ray] * slopes[plane, ray]
            is_better = value_mm > best_mm[ray]
            best_mm[ray] = value_mm if is_better else best_mm[ray]
            index[ray] = plane if is_better else index[ray]
    return best_mm, index


def _are_inward(hull: scipy.spatial.ConvexHull) -> NDArray[np.bool_]:
    """Whether the corners of faces (F,) run clockwise seen from outside."""
    a, b, c = hull.points[hull.simplices.T]
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0)


def _turned(corners: NDArray[np.int32], which: NDArray[np.bool_]) -> NDArray[np.int64]:
    """`corners` (F, 3) with the order of some faces (F,) reversed."""
    return np.where(which[:, None], corners[:, ::-1], corners).astype(np.int64)
