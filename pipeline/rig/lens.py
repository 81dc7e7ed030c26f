"""How a lens bends the image: radial and tangential distortion as OpenCV has it, and its inverse."""

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

ITERATIONS = 20
CONVERGED = 1e-14
"""Change of a coordinate at which the iterations end."""


def distort(normalized: Array, distortion: Array) -> Array:
    """Normalized image coordinates (N, 2) after OpenCV's radial and tangential distortion."""
    if not distortion.any():
        return normalized
    k1, k2, p1, p2, k3 = distortion
    x, y = normalized[:, 0], normalized[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
    )


def undistorted(pixels_uv: Array, owners: Indices, K: Array, distortion: Array) -> Array:
    """Normalized image coordinates (N, 2) of pixels (N, 2) of several cameras, by the index (N,) of each one's.

    As `cv2.undistortPoints`, but for the skew in `K` (V, 3, 3), in a fifth of its time.
    """
    flat = np.empty(pixels_uv.shape)
    _undistort(np.ascontiguousarray(pixels_uv), owners, K, distortion, flat)
    return flat


@compiled
def _undistort(pixels_uv: Array, owners: Indices, K: Array, distortion: Array, flat: Array) -> None:
    """Fill in the normalized coordinates: fixed-point iterations of the inverse of `distort`."""
    for i in range(len(pixels_uv)):
        at = owners[i]
        k1, k2, k3 = distortion[at, 0], distortion[at, 1], distortion[at, 4]
        p1, p2 = distortion[at, 2], distortion[at, 3]
        seen_y = (pixels_uv[i, 1] - K[at, 1, 2]) / K[at, 1, 1]
        seen_x = (pixels_uv[i, 0] - K[at, 0, 2] - K[at, 0, 1] * seen_y) / K[at, 0, 0]
        x, y = seen_x, seen_y
        for _ in range(ITERATIONS):
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            last_x, last_y = x, y
            x = (seen_x - 2 * p1 * last_x * last_y - p2 * (r2 + 2 * last_x * last_x)) / radial
            y = (seen_y - p1 * (r2 + 2 * last_y * last_y) - 2 * p2 * last_x * last_y) / radial
            if abs(x - last_x) + abs(y - last_y) < CONVERGED:
                break
        flat[i, 0], flat[i, 1] = x, y
