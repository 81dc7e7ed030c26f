"""Radial and tangential lens distortion (k1, k2, p1, p2, k3) as OpenCV defines it, and its inverse."""

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from pipeline.arrays import Floats, Indices, PointsUV
from pipeline.compiled import compiled

MAX_ITERATIONS = 20
CONVERGED = 1e-14
"""Change of a coordinate at which the iterations of the inverse end."""

RegionLens = tuple[Any, ...]
"""Intrinsics of one camera for pixels of a region: fx, skew, cx, fy, cy, then k1, k2, p1, p2, k3.

All in double or all in single precision, which decides the precision of what is projected."""


def distort(normalized: PointsUV, distortion: Annotated[Floats, "(5,)"]) -> PointsUV:
    """Return the distorted coordinates (N, 2) of normalized image coordinates (N, 2)."""
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


def normalized_coordinates(pixels_uv: PointsUV, owners: Indices, K: Floats, distortion: Floats) -> PointsUV:
    """Return the undistorted image coordinates (x/z, y/z) of pixels (N, 2), each seen by camera `owners` (N,).

    As `cv2.undistortPoints`, but with the skew in `K` (V, 3, 3), for several cameras with `distortion` (V, 5), and in
    a fifth of its time.
    """
    normalized = np.empty(pixels_uv.shape)
    _undistort(np.ascontiguousarray(pixels_uv), owners, K, distortion, normalized)
    return normalized


@compiled
def _undistort(
    pixels_uv: PointsUV, owners: Indices, K: Floats, distortion: Floats, normalized: PointsUV
) -> None:
    """Fill in the normalized coordinates: fixed-point iterations of the inverse of `distort`."""
    for i in range(len(pixels_uv)):
        at = owners[i]
        k1, k2, k3 = distortion[at, 0], distortion[at, 1], distortion[at, 4]
        p1, p2 = distortion[at, 2], distortion[at, 3]
        seen_y = (pixels_uv[i, 1] - K[at, 1, 2]) / K[at, 1, 1]
        seen_x = (pixels_uv[i, 0] - K[at, 0, 2] - K[at, 0, 1] * seen_y) / K[at, 0, 0]
        x, y = seen_x, seen_y
        for _ in range(MAX_ITERATIONS):
            r2 = x * x + y * y
            radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
            last_x, last_y = x, y
            x = (seen_x - 2 * p1 * last_x * last_y - p2 * (r2 + 2 * last_x * last_x)) / radial
            y = (seen_y - p1 * (r2 + 2 * last_y * last_y) - 2 * p2 * last_x * last_y) / radial
            if abs(x - last_x) + abs(y - last_y) < CONVERGED:
                break
        normalized[i, 0], normalized[i, 1] = x, y


def region_lenses(K: Floats, distortion: Floats, offsets_uv: Sequence[tuple[int, int]]) -> Floats:
    """Return the `RegionLens` rows (V, 10) of cameras (V, 3, 3) and (V, 5) whose regions begin at these pixels."""
    left, top = np.array(offsets_uv).T
    return np.column_stack(
        [K[:, 0, 0], K[:, 0, 1], K[:, 0, 2] - left, K[:, 1, 1], K[:, 1, 2] - top, distortion]
    )


@compiled
def region_pixel(lens: RegionLens, x: float, y: float) -> tuple[float, float]:
    """Return the region pixel (u, v) of normalized coordinates x, y, as `CameraCalibration.project` has it."""
    fx, skew, cx, fy, cy, k1, k2, p1, p2, k3 = lens
    r2 = x * x + y * y
    bend = r2 * (k1 + r2 * (k2 + r2 * k3))  # whole numbers would make doubles of floats
    a = x + x * bend + (p1 + p1) * x * y + p2 * (r2 + x * x + x * x)
    b = y + y * bend + p1 * (r2 + y * y + y * y) + (p2 + p2) * x * y
    return fx * a + skew * b + cx, fy * b + cy
