"""Excess volume of a sphere's visual hull over the sphere: the method's least bias, from the cameras' places alone."""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import Singles

N_DIRECTIONS = 5000
"""Number of sampled directions: it makes the excess good to 1e-3 of it, single precision to 1e-5."""


def sphere_hull_excess(camera_centers_mm: ArrayLike, center_mm: ArrayLike, radius_mm: float) -> float:
    """Return the volume of a sphere's visual hull, seen by cameras at (N, 3), over the sphere's volume.

    The hull is the intersection of the tangent cones. Seen from the sphere's centre, a cone of
    half-angle alpha whose axis makes the angle psi with the direction u ends at

        r(u) = radius / sin(psi - alpha)

    (nowhere for psi <= alpha); the hull ends at the least r(u) of all cameras, and its volume is the
    mean of r^3 over all directions. Reference: 1.0076 for a sphere of 15 mm in the nominal rig.

    Raises
    ------
    ValueError
        A camera is inside the sphere, or the cameras leave the hull open.
    """
    if not radius_mm > 0:
        raise ValueError(f"the radius must be positive, not {radius_mm}")
    axes = np.asarray(center_mm, dtype=np.float64) - np.asarray(camera_centers_mm, dtype=np.float64)
    distances_mm = np.linalg.norm(axes, axis=1)
    if not (distances_mm > radius_mm).all():
        raise ValueError(f"camera {int(distances_mm.argmin())} is inside the sphere")
    sin_alpha = (radius_mm / distances_mm).astype(np.float32)
    cos_alpha = np.sqrt(1 - sin_alpha**2)
    cos_psi = (axes / distances_mm[:, None]).astype(np.float32) @ sphere_directions(N_DIRECTIONS)
    sin_psi = np.sqrt(np.maximum(1 - cos_psi**2, 0))
    # radius over r(u); laid out camera by camera, so that numpy works on contiguous rows
    nearest = (sin_psi * cos_alpha[:, None] - cos_psi * sin_alpha[:, None]).max(axis=0)
    if not (nearest > 0).all():
        raise ValueError(f"{len(axes)} cameras leave the hull of the sphere open")
    return float(np.mean(1 / (nearest * nearest * nearest), dtype=np.float64))


@cache
def sphere_directions(n: int) -> Singles:
    """Return n unit directions (3, n), evenly spread over the sphere (Fibonacci spiral)."""
    i = np.arange(n) + 0.5
    z = 1 - 2 * i / n
    azimuth = np.pi * (1 + np.sqrt(5)) * i
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], dtype=np.float32)
