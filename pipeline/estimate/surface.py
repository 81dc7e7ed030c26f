"""What the silhouettes say of the surface along each ray from the middle of the body."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import View
from pipeline.compiled import compiled
from pipeline.estimate.inner import InnerBody, inner_body
from pipeline.estimate.smoothness import local_share, segment_shares, sphere_segment_mm
from pipeline.estimate.tangents import tangents_of

Array = NDArray[np.float64]

ROUNDING = 1e-12
"""A ray that leaves a face by no more than this share has not left it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InnerSurface:
    """Along N rays from a centre within the inner body."""

    radii_mm: Array  # (N,) to the surface of the inner body
    half_heights_mm: (
        Array  # (N,) from there, half the mean height of the tangent planes of the face's corners
    )
    local_share: Array  # (N,) of segments, see `smoothness`


def inner_surface(views: Sequence[View], center_mm: Array, from_center_mm: Array) -> InnerSurface | str:
    """The inner body along the rays from `center_mm` through points (N, 3) relative to it; or why there is none."""
    if len(views) < 3:
        return f"{len(views)} views are too few for an inner body"
    tangents = tangents_of(views, center_mm)
    inner = inner_body(tangents)
    if inner is None:
        return "the outlines that were seen do not span a body"
    if not (inner.offsets_mm > 0).all():
        return "the inner body does not hold the hull's centre"
    sphere_mm = sphere_segment_mm(views, center_mm, float(np.cbrt(3 * inner.volume_mm3 / (4 * np.pi))))
    if not np.isfinite(sphere_mm):
        return "the views leave the hull of a sphere open"
    shares = local_share(inner, tangents, segment_shares(tangents, sphere_mm))
    radii_mm, half_heights_mm, share = _along(
        from_center_mm,
        inner.faces,
        inner.neighbors,
        _corner_solver(inner),
        np.column_stack([inner.normals, inner.offsets_mm]),
        np.column_stack([tangents.normals, tangents.offsets_mm])[inner.rays],
        shares,
        np.zeros((2, 2, 2), np.int64),
    )
    return InnerSurface(radii_mm=radii_mm, half_heights_mm=half_heights_mm, local_share=share)


def _corner_solver(inner: InnerBody) -> Array:
    """Matrices (F, 3, 3) that turn a direction into its weights, up to scale, of a face's corners."""
    a, b, c = inner.points_mm[inner.faces.T]
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)


@compiled
def _along(
    points_mm: Array,
    faces: NDArray[np.int64],
    neighbors: NDArray[np.int64],
    solvers: Array,
    face_planes: Array,
    tangent_planes: Array,
    shares: Array,
    last: NDArray[np.int64],
) -> tuple[Array, Array, Array]:
    """The three arrays (N,) of `InnerSurface` for the rays from the origin through points (N, 3).

    A face that the ray misses is left for its neighbour on the ray's side: seen from within, the faces of a
    convex body tile a sphere as a regular triangulation, where such a walk always arrives. It starts where
    the `last` one in the same octant (2, 2, 2) ended, at first anywhere: a mesh's vertices come in rows that
    cross the body, so that this is less than one step away.
    """
    n = len(points_mm)
    radii_mm, half_heights_mm, local_share = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        x, y, z = points_mm[i, 0], points_mm[i, 1], points_mm[i, 2]
        length_mm = np.sqrt(x * x + y * y + z * z)
        x, y, z = x / length_mm, y / length_mm, z / length_mm
        octant = (int(x > 0), int(y > 0), int(z > 0))
        face = last[octant]
        a, b, c = _weights(solvers, face, x, y, z)
        for _ in range(len(faces)):
            if a + b + c > 0 and min(a, b, c) >= -ROUNDING * (a + b + c):
                break
            opposite = 0 if a <= min(b, c) else 1 if b <= c else 2
            face = neighbors[face, opposite]
            a, b, c = _weights(solvers, face, x, y, z)
        else:  # caught between faces without area
            a = b = c = 1.0
        last[octant] = face
        total = a + b + c
        a, b, c = a / total, b / total, c / total
        first, second, third = faces[face, 0], faces[face, 1], faces[face, 2]
        radius_mm = face_planes[face, 3] / _height(face_planes, face, x, y, z)
        height_mm = (
            a * (tangent_planes[first, 3] - radius_mm * _height(tangent_planes, first, x, y, z))
            + b * (tangent_planes[second, 3] - radius_mm * _height(tangent_planes, second, x, y, z))
            + c * (tangent_planes[third, 3] - radius_mm * _height(tangent_planes, third, x, y, z))
        )
        radii_mm[i] = radius_mm
        # square to the face h, along the ray h / cos, and cos is the face's offset over the radius
        half_heights_mm[i] = max(height_mm, 0.0) * radius_mm / (2 * face_planes[face, 3])
        local_share[i] = a * shares[first] + b * shares[second] + c * shares[third]
    return radii_mm, half_heights_mm, local_share


@compiled
def _weights(solvers: Array, face: int, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Of the corners of a face where the ray along (x, y, z) leaves it, up to scale; negative beside it."""
    return (
        solvers[face, 0, 0] * x + solvers[face, 0, 1] * y + solvers[face, 0, 2] * z,
        solvers[face, 1, 0] * x + solvers[face, 1, 1] * y + solvers[face, 1, 2] * z,
        solvers[face, 2, 0] * x + solvers[face, 2, 1] * y + solvers[face, 2, 2] * z,
    )


@compiled
def _height(planes: Array, plane: int, x: float, y: float, z: float) -> float:
    """Of (x, y, z) along a plane's normal."""
    return planes[plane, 0] * x + planes[plane, 1] * y + planes[plane, 2] * z
