"""Smoothness of a body, from place to place and as a whole, judged by its tangent rays.

On a body with corners and flat faces nearly every tangent ray passes through a corner or an edge, where
the planes of other views cut it short. On a smooth body each ray touches at a point of its own,
which is known to lie on a segment about as long as on a sphere seen by the same cameras: `local_share`.

And the tangent planes of neighbouring contacts of a smooth body rise no higher above its chords than twice
what the hull leaves there; planes at corners, whose normals jump, rise far beyond it: `bulge_share`.
"""

import numpy as np

from pipeline.arrays import Directions, PointsMM, Singles, Values
from pipeline.compiled import compiled, compiled_within
from pipeline.estimate.tangents import N_ANGLES, OUTWARDS, Tangents, segments_mm

REACH_DEG = 37.5
"""Angle between normals up to which planes count as neighbours; up to there their weight falls with the cosine."""
OFFSET, PER_LOCAL_SHARE, PER_BULGE_SHARE = -1.28, 1.69, 1.14
"""Coefficients of smoothness, linear in both shares, of least mean distance over superellipsoids, ellipsoids smooth and
rough, boxes, cylinders, polyhedra smooth and rough (tests/accuracy/fit_estimate.py). Stones took no part. The minimum
is flat: (-0.8, 0.9, 1.2), fitted to other bodies of these forms, changes their mean distances by 1 um."""
SPHERE_STEP = 7
"""Step from ray to ray of a sphere: every seventh is enough for their median."""
TINY = 1e-7


def segment_shares(tangents: Tangents, sphere_mm: float) -> Values:
    """Return the lengths (N,) of the segments relative to a sphere's, 1 at most."""
    return np.minimum(tangents.lengths_mm / sphere_mm, 1)


def local_share(normals: Directions, shares: Values) -> Values:
    """Return the weighted mean (N,) of `segment_shares` (N,) over the neighbours of each plane, by normals (N, 3)."""
    sums = np.zeros((2, len(shares)), np.float32)
    _add_weights(np.ascontiguousarray(normals.T, np.float32), shares.astype(np.float32), sums)
    return (sums[1] / sums[0]).astype(np.float64)


@compiled
def _add_weights(normals: Singles, shares: Singles, sums: Singles) -> None:
    """Add each plane's weight, and that times its share, to the sums (2, N) of all: in vectors, as these are last."""
    limit = np.float32(np.cos(np.deg2rad(REACH_DEG)))
    for j in range(len(shares)):
        x, y, z, share = normals[0, j], normals[1, j], normals[2, j], shares[j]
        for i in range(len(shares)):
            weight = max(x * normals[0, i] + y * normals[1, i] + z * normals[2, i] - limit, np.float32(0))
            sums[0, i] += weight
            sums[1, i] += weight * share


@compiled
def bulge_share(half_heights: Values, radii: Values) -> float:
    """Return the mean share of a smooth body's bulge that the hull leaves: 0.9 for a sphere, 0.1 for a polyhedron.

    Both (N,) as in `InnerSurface`. Places where the hull itself lies within the inner body, in a dent, do not count.
    """
    room, n_outside = 0.0, 0
    for i in range(len(radii)):
        if radii[i] < 1:
            room += min((1 - radii[i]) / max(half_heights[i], TINY), 1.0)
            n_outside += 1
    return room / max(n_outside, 1)


@compiled_within
def smoothness(local: float, bulge: float) -> float:
    """Return the smoothness of a place with these shares, from 0 (corners) to 1 (smooth)."""
    return min(max(OFFSET + PER_LOCAL_SHARE * local + PER_BULGE_SHARE * bulge, 0.0), 1.0)


def sphere_segment_mm(centers_mm: PointsMM, radius_mm: float) -> float:
    """Return the median segment of the tangent rays of a sphere; infinite if the planes bound none.

    The cameras' centres (V, 3) are relative to that of the sphere.
    """
    distances_mm = np.sqrt((centers_mm**2).sum(axis=1, keepdims=True))
    sines = np.minimum(radius_mm / distances_mm, 1.0)
    cosines = np.sqrt(1 - sines**2)
    # rows of Householder's matrices: along the first of each the camera lies, before or behind
    sides = np.copysign(1.0, centers_mm[:, :1])
    mirrors = centers_mm + sides * distances_mm * np.array([1.0, 0.0, 0.0])
    mirrors /= np.sqrt((mirrors**2).sum(axis=1, keepdims=True))
    axes = np.eye(3) - 2 * mirrors[:, :, None] * mirrors[:, None]
    # the normal of a tangent plane points to where it touches
    axes *= np.concatenate([-sides * sines, cosines, cosines], axis=1)[:, :, None]
    planes = (np.column_stack([np.ones(N_ANGLES), *OUTWARDS]) @ axes).reshape(-1, 3)
    touching_mm = radius_mm * planes[::SPHERE_STEP]
    along = touching_mm - centers_mm[np.arange(0, len(planes), SPHERE_STEP) // N_ANGLES]
    along /= np.sqrt((along**2).sum(axis=1, keepdims=True))
    low_mm, high_mm = segments_mm(planes, np.full(len(planes), radius_mm), touching_mm, along)
    return float(np.median(high_mm - low_mm))
