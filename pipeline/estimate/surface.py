"""The inner body's surface, and the tangent planes above it, along rays from the middle of the body."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Flags, Floats, PointsMM, Values, Vector
from pipeline.compiled import compiled, compiled_within
from pipeline.estimate.smooth_support import inner_of
from pipeline.estimate.smoothness import local_share, segment_shares, sphere_segment_mm
from pipeline.estimate.tangents import find_tangents
from pipeline.geometry.growing_hull import Facets
from pipeline.views.prepared import PreparedViews

ROUNDING = 1e-12
"""Share of its weights by which a ray may lie beside a face that it counts as meeting."""


class InnerSurface(NamedTuple):
    """The inner body along rays from a centre within it through N points, in shares of their distances from it."""

    radii: Values  # (N,) to the surface of the inner body
    half_heights: Values  # (N,) from there, half the mean height of the tangent planes of the face's corners
    local_share: Values  # (N,) of segments, see `smoothness`
    corners_mm: PointsMM  # (C, 3) of the inner body, where tangent rays touch
    is_seen: Flags  # (C,) whether an edge was seen there


def inner_surface(views: PreparedViews, center_mm: Vector, points_mm: PointsMM) -> InnerSurface | str:
    """Return the inner body along the rays from `center_mm` through points (N, 3); or why there is none."""
    if len(views) < 3:
        return f"{len(views)} views are too few for an inner body"
    outlined = views.with_outline()
    if not len(outlined):
        return "no outline was seen"
    found = find_tangents(outlined, center_mm)
    tangents, inner = inner_of(found)
    if inner is None:
        return "the outlines that were seen do not span a body"
    if not (inner.facets.planes[:, 3] < 0).all():
        return "the inner body does not hold the hull's centre"
    centers_mm = views.cameras.centers_mm - center_mm
    sphere_mm = sphere_segment_mm(centers_mm, float(np.cbrt(3 * inner.volume_mm3 / (4 * np.pi))))
    if not np.isfinite(sphere_mm):
        return "the views leave the hull of a sphere open"
    shares = local_share(tangents.normals, segment_shares(found, sphere_mm))
    touching = np.unique(inner.facets.corners)
    corners_mm, is_seen = center_mm + inner.points_mm[touching], tangents.is_seen[touching]
    radii, half_heights, shares_there = np.empty((3, len(points_mm)))
    surface = InnerSurface(radii, half_heights, shares_there, corners_mm, is_seen)
    planes = np.column_stack([tangents.normals, tangents.offsets_mm, shares])
    last = np.zeros((2, 2, 2), np.int32)
    _follow_rays(points_mm, center_mm, inner.facets, inner.solvers, planes, last, surface)
    return surface


@compiled
def _follow_rays(
    points_mm: PointsMM,
    center_mm: Vector,
    facets: Facets,
    solvers: Floats,
    tangents: Floats,
    last: NDArray[np.int32],
    surface: InnerSurface,
) -> None:
    """Fill in the surface along the rays from the centre through points (N, 3).

    `tangents` (T, 5) are normals, offsets and shares of the planes that touch at the corners. A face that the ray
    misses is left for its neighbour on the ray's side: seen from within, the faces of a convex body tile a sphere
    as a regular triangulation, where such a walk always arrives. It starts where the `last` one in the same octant
    (2, 2, 2) ended, at first anywhere: a mesh's vertices come in rows that cross the body, so that this is less
    than one step away.
    """
    corners, across, planes = facets
    center_x, center_y, center_z = center_mm[0], center_mm[1], center_mm[2]
    for i in range(len(points_mm)):
        x, y, z = points_mm[i, 0] - center_x, points_mm[i, 1] - center_y, points_mm[i, 2] - center_z
        octant = (int(x > 0), int(y > 0), int(z > 0))
        face = last[octant]
        a, b, c = _weights(solvers, face, x, y, z)
        for _ in range(len(corners)):
            if a + b + c > 0 and min(a, b, c) >= -ROUNDING * (a + b + c):
                break
            face = across[face, 1 if a <= min(b, c) else 2 if b <= c else 0]
            a, b, c = _weights(solvers, face, x, y, z)
        else:  # caught between faces without area
            a = b = c = 1.0
        last[octant] = face
        first, second, third = corners[face, 0], corners[face, 1], corners[face, 2]
        # of the face's plane and of those that touch at its corners: heights of the point above the centre's level
        own_mm = _height(planes, face, x, y, z)
        radius = -planes[face, 3] / own_mm
        scale = 1 / (a + b + c)
        bulge_mm = scale * (
            a * (tangents[first, 3] - radius * _height(tangents, first, x, y, z))
            + b * (tangents[second, 3] - radius * _height(tangents, second, x, y, z))
            + c * (tangents[third, 3] - radius * _height(tangents, third, x, y, z))
        )
        surface.radii[i] = radius
        # square to the face h, along the ray h / cos, and cos is `own_mm` over the point's distance
        surface.half_heights[i] = max(bulge_mm, 0.0) / (2 * own_mm)
        surface.local_share[i] = scale * (
            a * tangents[first, 4] + b * tangents[second, 4] + c * tangents[third, 4]
        )


@compiled_within
def _weights(solvers: Floats, face: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return the weights, up to scale, of a face's corners where the ray along (x, y, z) leaves it; < 0 beside it."""
    return (
        solvers[face, 0, 0] * x + solvers[face, 0, 1] * y + solvers[face, 0, 2] * z,
        solvers[face, 1, 0] * x + solvers[face, 1, 1] * y + solvers[face, 1, 2] * z,
        solvers[face, 2, 0] * x + solvers[face, 2, 1] * y + solvers[face, 2, 2] * z,
    )


@compiled_within
def _height(planes: Floats, plane: int, x: float, y: float, z: float) -> float:
    """Return the height of (x, y, z) along a plane's normal."""
    return planes[plane, 0] * x + planes[plane, 1] * y + planes[plane, 2] * z
