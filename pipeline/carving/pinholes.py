"""The cameras of the views that carve, as compiled loops take them, and the projection of cubes' octants.

`CHUNK` cubes are projected at a time, so that what is computed of them stays in the cache.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Singles
from pipeline.compiled import compiled, compiled_within
from pipeline.rig.lens import RegionLens, region_lenses, region_pixel
from pipeline.views.prepared import PreparedViews

OCTANTS = 8
"""Octants of a cube; octant (i, j, k), each 0 or 1, has number 4 i + 2 j + k."""
CORNERS = np.array([[1, j, k] for j in (-1, 1) for k in (-1, 1)], np.float64)
"""The corners of a cube around the origin that are not opposite to another."""
CHUNK = 64
"""Number of cubes projected at a time. The arrays for them are made where they are filled: of others the compiler knows
neither the strides nor that they do not overlap, and takes one cube at a time."""


class Pinholes(NamedTuple):
    """V cameras that see regions of their images, and the largest extents of a cube of half edge 1 in their frames.

    In single precision, in which pixels are off by less than 1e-3.
    """

    R: Singles  # (V, 3, 3)
    t_mm: Singles  # (V, 3)
    lenses: Singles  # (V, 10) a `RegionLens` each
    focals_px: Singles  # (V,) mean
    stretches_px: (
        Singles  # (V,) bound of the length in the image of a step of 1 at depth 1, anywhere in the grid
    )
    across: Singles  # (V,) from the cube's centre to a corner, at right angles to the optical axis
    along: Singles  # (V,) the same along it


def pinholes_of(views: PreparedViews, size_mm: float) -> Pinholes:
    """Return the views' cameras; distances in the image are bounded within a cube of this edge around the origin."""
    K, distortions, R, t_mm = views.cameras
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
        "lenses": region_lenses(K, distortions, [silhouette.offset_uv for silhouette in views.silhouettes]),
        "focals_px": views.cameras.focals_px,
        "stretches_px": (1 + bend) * (np.maximum(K[:, 0, 0], K[:, 1, 1]) + np.abs(K[:, 0, 1])),
        "across": np.linalg.norm(corners[:, :, :2], axis=2).max(axis=1),
        "along": np.abs(corners[:, :, 2]).max(axis=1),
    }
    return Pinholes(**{name: np.asarray(entry, np.float32) for name, entry in entries.items()})


@compiled
def lens_of(pinholes: Pinholes, view: int) -> RegionLens:
    """Return a row of `Pinholes.lenses`."""
    row = pinholes.lenses
    return (
        row[view, 0], row[view, 1], row[view, 2], row[view, 3], row[view, 4],
        row[view, 5], row[view, 6], row[view, 7], row[view, 8], row[view, 9],
    )  # fmt: skip


@compiled_within
def project_octants(
    pinholes: Pinholes,
    view: int,
    centers_mm: Annotated[Singles, "(3, N)"],
    chosen: NDArray[np.int32],
    begin: int,
    n: int,
    quarter_mm: float,
    projected: Annotated[Singles, "(OCTANTS, 4, CHUNK)"],
) -> None:
    """Fill in region pixels u, v, depth in mm and slope to the optical axis of the centres of cubes' octants.

    Of the cubes around `centers_mm` (3, N), with edges of four times `quarter_mm`, those are projected whose indices
    are the `n` of `chosen` from `begin` on.
    """
    R, t = pinholes.R, pinholes.t_mm  # rows of arrays would be counted references
    xx, xy, xz = R[view, 0, 0], R[view, 0, 1], R[view, 0, 2]
    yx, yy, yz = R[view, 1, 0], R[view, 1, 1], R[view, 1, 2]
    zx, zy, zz = R[view, 2, 0], R[view, 2, 1], R[view, 2, 2]
    lens = lens_of(pinholes, view)
    turned_mm = np.empty((3, CHUNK), np.float32)
    for cube in range(n):
        at = np.uint64(chosen[begin + cube])
        x, y, z = centers_mm[0, at], centers_mm[1, at], centers_mm[2, at]
        turned_mm[0, cube] = t[view, 0] + (xx * x + xy * y + xz * z)
        turned_mm[1, cube] = t[view, 1] + (yx * x + yy * y + yz * z)
        turned_mm[2, cube] = t[view, 2] + (zx * x + zy * y + zz * z)
    for octant in range(OCTANTS):
        i = np.float32(quarter_mm if octant & 4 else -quarter_mm)
        j = np.float32(quarter_mm if octant & 2 else -quarter_mm)
        k = np.float32(quarter_mm if octant & 1 else -quarter_mm)
        to_x, to_y, to_z = xx * i + xy * j + xz * k, yx * i + yy * j + yz * k, zx * i + zy * j + zz * k
        for cube in range(n):
            depth_mm = turned_mm[2, cube] + to_z
            x, y = (turned_mm[0, cube] + to_x) / depth_mm, (turned_mm[1, cube] + to_y) / depth_mm
            projected[octant, 0, cube], projected[octant, 1, cube] = region_pixel(lens, x, y)
            projected[octant, 2, cube], projected[octant, 3, cube] = depth_mm, np.sqrt(x * x + y * y)
