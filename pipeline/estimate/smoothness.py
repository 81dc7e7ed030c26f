"""How smooth a body is, from place to place and as a whole, as its tangent rays tell.

On a body with corners and flat faces nearly every tangent ray passes through a corner or an edge, where
the planes of other views cut it short. On a smooth body each ray touches at a point of its own, and all
that is known of it is a segment about as long as on a sphere seen by the same cameras: `local_share`.

And the tangent planes of neighbouring contacts of a smooth body rise no higher above its chords than twice
what the hull leaves there; planes at corners, whose normals jump, rise far beyond it: `bulge_share`.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.carving import View
from pipeline.estimate.inner import InnerBody
from pipeline.estimate.tangents import N_ANGLES, Tangents, segments_mm

Array = NDArray[np.float64]

REACH_DEG = 37.5
"""Planes whose normals are further apart do not count; up to there the weight falls with the cosine."""
OFFSET, PER_LOCAL_SHARE, PER_BULGE_SHARE = -1.28, 1.69, 1.14
"""Smoothness, linear in both shares: least mean distance over superellipsoids, ellipsoids smooth and rough,
boxes, cylinders, polyhedra smooth and rough (tests/accuracy/fit_estimate.py). Stones took no part. The minimum
is flat: (-0.8, 0.9, 1.2), fitted to other bodies of these forms, changes their mean distances by 1 um."""
SPHERE_STEP = 7
"""Every seventh ray of a sphere is enough for their median."""
TINY_MM = 1e-6


def segment_shares(tangents: Tangents, sphere_mm: float) -> Array:
    """Lengths (N,) of the segments relative to a sphere's, counted as 1 at most."""
    return np.minimum(tangents.lengths_mm / sphere_mm, 1)


def local_share(inner: InnerBody, tangents: Tangents, shares: Array) -> Array:
    """Mean of `segment_shares` (P,) of the planes that look like the one at each point of an inner body."""
    normals = tangents.normals.astype(np.float32)
    limit = np.float32(np.cos(np.deg2rad(REACH_DEG)))
    weights = normals[inner.rays] @ normals.T
    weights -= limit
    np.maximum(weights, 0, out=weights)
    return (weights @ shares.astype(np.float32) / weights.sum(axis=1)).astype(np.float64)


def bulge_share(half_heights_mm: Array, excess_mm: Array) -> float:
    """Mean share of a smooth body's bulge that the hull has room for: 0.9 for a sphere, 0.1 for a polyhedron.

    Where the hull itself lies within the inner body, in a dent, there is nothing to tell.
    """
    room = np.minimum(excess_mm / np.maximum(half_heights_mm, TINY_MM), 1)
    return float(room.sum() / max(np.count_nonzero(excess_mm), 1))


def smoothness(local: Array, bulge: float) -> Array:
    """From 0 (corners) to 1 (smooth) where the `local_share` is `local` (N,)."""
    return np.clip(OFFSET + PER_LOCAL_SHARE * local + PER_BULGE_SHARE * bulge, 0, 1)


def sphere_segment_mm(views: Sequence[View], center_mm: Array, radius_mm: float) -> float:
    """Median segment of the tangent rays of a sphere seen by these cameras; infinite if they bound none."""
    angles = 2 * np.pi / N_ANGLES * np.arange(N_ANGLES)
    eyes_mm = np.array([camera.center_mm - center_mm for camera, _ in views])
    distances_mm = np.linalg.norm(eyes_mm, axis=1)[:, None, None]
    sines = np.minimum(radius_mm / distances_mm, 1.0)
    right, down = np.moveaxis(np.linalg.svd(eyes_mm[:, None])[2][:, 1:], 1, 0)
    around = np.cos(angles)[:, None] * right[:, None] + np.sin(angles)[:, None] * down[:, None]
    # the normal of a tangent plane points to where it touches
    planes = (np.sqrt(1 - sines**2) * around + sines * eyes_mm[:, None] / distances_mm).reshape(-1, 3)
    touching_mm = radius_mm * planes[::SPHERE_STEP]
    along = touching_mm - np.repeat(eyes_mm, N_ANGLES, axis=0)[::SPHERE_STEP]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    low_mm, high_mm = segments_mm(planes, np.full(len(planes), radius_mm), touching_mm, along)
    return float(np.median(high_mm - low_mm))
