"""The views that carve, as numpy and as compiled loops take them."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled, compiled_within
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.segmentation.silhouette import Silhouette

Array = NDArray[np.float32]
View = tuple[CameraCalibration, Silhouette]
Lens = tuple[Any, ...]
"""A row of `Pinholes.lenses`, all in double or all in single precision, in which what it projects stays."""

HALVES = 8
"""Of a cube; where half i, j, k is, each 0 or 1, is number 4 i + 2 j + k."""
CORNERS = np.array([[1, j, k] for j in (-1, 1) for k in (-1, 1)], np.float64)
"""Of a cube around the origin, those that are not opposite to another."""
CHUNK = 64
"""So many cubes are looked at at once: what is known of them stays in the cache. The arrays for it are made where they
are filled: of others the compiler knows neither the strides nor that they are apart, and takes one cube at a time."""


class Pinholes(NamedTuple):
    """V cameras that see regions of their images, and the largest extents of a cube of half edge 1 in their frames.

    In single precision, in which pixels are off by less than 1e-3.
    """

    R: Array  # (V, 3, 3)
    t_mm: Array  # (V, 3)
    lenses: Array  # (V, 10) of region pixels: fx, skew, cx, fy, cy, then k1, k2, p1, p2, k3
    focals_px: Array  # (V,) mean
    stretches_px: Array  # (V,) most that a step of 1 at depth 1 is in the image, anywhere in the grid
    across: Array  # (V,) from the cube's centre to a corner, at right angles to the optical axis
    along: Array  # (V,) the same along it


def usable_views(silhouettes: Mapping[CameraId, Silhouette], rig: RigCalibration) -> list[View]:
    """Cameras with their usable silhouettes, in the rig's order."""
    unknown = sorted(set(silhouettes) - set(rig.camera_ids))
    if unknown:
        raise ValueError(f"the rig has no camera {', '.join(unknown)}")
    return [
        (camera, silhouettes[camera.id])
        for camera in rig.cameras
        if camera.id in silhouettes and silhouettes[camera.id].is_usable
    ]


def pinholes_of(views: Sequence[View], size_mm: float) -> Pinholes:
    """The views' cameras; distances in the image are bounded within a cube of this edge around the origin."""
    cameras = [camera for camera, _ in views]
    K = np.array([camera.K for camera in cameras])
    distortions = np.array([camera.distortion for camera in cameras])
    R, t_mm = np.array([camera.R for camera in cameras]), np.array([camera.t_mm for camera in cameras])
    radius_mm = np.sqrt(3) / 2 * size_mm
    # no point of the cube is seen under a larger one; of a camera within the cube any may be
    slope = (np.hypot(t_mm[:, 0], t_mm[:, 1]) + radius_mm) / np.maximum(t_mm[:, 2] - radius_mm, 1e-3)
    # a bound of the norm of the distortion's derivative
    k1, k2, p1, p2, k3 = np.abs(distortions).T
    bend = 3 * k1 * slope**2 + 5 * k2 * slope**4 + 7 * k3 * slope**6 + 6 * (p1 + p2) * slope
    corners = np.einsum("vij,cj->vci", R, CORNERS)
    entries = {
        "R": R,
        "t_mm": t_mm,
        "lenses": lenses_of(K, distortions, [silhouette for _, silhouette in views]),
        "focals_px": [camera.focal_px for camera in cameras],
        "stretches_px": (1 + bend) * (np.maximum(K[:, 0, 0], K[:, 1, 1]) + np.abs(K[:, 0, 1])),
        "across": np.linalg.norm(corners[:, :, :2], axis=2).max(axis=1),
        "along": np.abs(corners[:, :, 2]).max(axis=1),
    }
    return Pinholes(**{name: np.asarray(entry, np.float32) for name, entry in entries.items()})


def lenses_of(
    K: NDArray[np.float64], distortions: NDArray[np.float64], silhouettes: Sequence[Silhouette]
) -> NDArray[np.float64]:
    """`Pinholes.lenses` (V, 10) of cameras (V, 3, 3) and (V, 5) that see the regions of these silhouettes."""
    left, top = np.array([silhouette.offset_uv for silhouette in silhouettes]).T
    return np.column_stack(
        [K[:, 0, 0], K[:, 0, 1], K[:, 0, 2] - left, K[:, 1, 1], K[:, 1, 2] - top, distortions]
    )


@compiled
def lens_of(pinholes: Pinholes, view: int) -> Lens:
    """A row of `lenses`."""
    row = pinholes.lenses
    return (
        row[view, 0], row[view, 1], row[view, 2], row[view, 3], row[view, 4],
        row[view, 5], row[view, 6], row[view, 7], row[view, 8], row[view, 9],
    )  # fmt: skip


@compiled
def pixel_of(lens: Lens, x: float, y: float) -> tuple[float, float]:
    """Region pixel u, v of a point at x, y in depth 1, as `CameraCalibration.project` has it."""
    fx, skew, cx, fy, cy, k1, k2, p1, p2, k3 = lens
    r2 = x * x + y * y
    bend = r2 * (k1 + r2 * (k2 + r2 * k3))  # whole numbers would make doubles of floats
    a = x + x * bend + (p1 + p1) * x * y + p2 * (r2 + x * x + x * x)
    b = y + y * bend + p1 * (r2 + y * y + y * y) + (p2 + p2) * x * y
    return fx * a + skew * b + cx, fy * b + cy


@compiled_within
def look(
    pinholes: Pinholes,
    view: int,
    centres_mm: Array,
    which: NDArray[np.int32],
    begin: int,
    n: int,
    half_mm: float,
    seen: Array,
) -> None:
    """How a camera sees the centres of the halves of cubes: region pixels u, v, depth and slope to the optical axis.

    Of the cubes around `centres_mm` (3, N) the `n` are looked at that stand in `which` from `begin` on, into
    `seen` (HALVES, 4, CHUNK); `half_mm` is half of a half's edge.
    """
    R, t = pinholes.R, pinholes.t_mm  # rows of arrays would be counted references
    xx, xy, xz = R[view, 0, 0], R[view, 0, 1], R[view, 0, 2]
    yx, yy, yz = R[view, 1, 0], R[view, 1, 1], R[view, 1, 2]
    zx, zy, zz = R[view, 2, 0], R[view, 2, 1], R[view, 2, 2]
    lens = lens_of(pinholes, view)
    turned_mm = np.empty((3, CHUNK), np.float32)
    for cube in range(n):
        at = np.uint64(which[begin + cube])
        x, y, z = centres_mm[0, at], centres_mm[1, at], centres_mm[2, at]
        turned_mm[0, cube] = t[view, 0] + (xx * x + xy * y + xz * z)
        turned_mm[1, cube] = t[view, 1] + (yx * x + yy * y + yz * z)
        turned_mm[2, cube] = t[view, 2] + (zx * x + zy * y + zz * z)
    for half in range(HALVES):
        i = np.float32(half_mm if half & 4 else -half_mm)
        j = np.float32(half_mm if half & 2 else -half_mm)
        k = np.float32(half_mm if half & 1 else -half_mm)
        to_x, to_y, to_z = xx * i + xy * j + xz * k, yx * i + yy * j + yz * k, zx * i + zy * j + zz * k
        for cube in range(n):
            depth_mm = turned_mm[2, cube] + to_z
            x, y = (turned_mm[0, cube] + to_x) / depth_mm, (turned_mm[1, cube] + to_y) / depth_mm
            seen[half, 0, cube], seen[half, 1, cube] = pixel_of(lens, x, y)
            seen[half, 2, cube], seen[half, 3, cube] = depth_mm, np.sqrt(x * x + y * y)
