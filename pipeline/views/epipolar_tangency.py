"""Epipolar tangency: whether two cameras agree on one body, from outlines alone, without any reconstruction.

A plane through the optical centres of two cameras that touches the body is seen by both of them: it touches
the outline in both images (Cipolla and Giblin, *Visual Motion of Curves and Surfaces*, 2000). So the two
planes through the baseline that touch the outline of camera a are those that touch the outline of camera b.
A plane through the baseline is one angle; the difference of the two angles is the residual, expressed in
pixels of image motion across the epipolar line (to first order the Sampson distance of the two points).

A camera that moved has all its pairs wrong, the others one pair each: the median over a camera's pairs names it.
No pair shows the whole rig turned, moved or scaled, an outline too wide everywhere, or a camera turned about the
line of sight to a round body.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Flags, Floats, PointsMM, PointsUV, Values
from pipeline.compiled import compiled
from pipeline.frames import CameraId
from pipeline.rig.camera_arrays import CameraArrays, camera_arrays
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation.silhouette import Silhouette
from pipeline.views.outline_hull import (
    MIN_POINTS,
    StackedOutlines,
    hull_corners,
    is_edge_seen,
    stack_outlines,
)

Outlines = Mapping[CameraId, PointsUV]
"""Edge points (N, 2) of each camera in order around the body."""
Pairs = Annotated[NDArray[np.int64], "(P, 2)"]
"""Indices of the two cameras of each pair."""

ALARM_PX = 0.3
"""Score from which a camera is reported as moved: three times that of a healthy one."""
MAX_SLOPE = 5.0
"""Largest slope of a touching plane against the one through the body's middle; beyond it the baseline (nearly) pierces
the silhouette, and a plane through it has nothing to touch."""
MIN_PAIRS = 3
"""Fewest pairs whose median tells which camera is wrong."""
REWEIGHTINGS = 10
LEAST_RESIDUAL_PX = 0.05
"""Noise of an outline: smaller residuals all weigh the same."""
TINY = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutlineHulls:
    """The viewing rays through the corners of V outlines' convex hulls: only they can touch a plane."""

    cameras: tuple[CameraId, ...]  # V
    rays: Floats  # (V, H, 3) in each camera's own frame, 1 along the optical axis; short hulls repeat their first
    is_trusted: NDArray[np.bool_]  # (V, H) the edge was seen on both sides of the corner
    is_closed: Flags  # (V,) the edge was seen all around


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EpipolarTangents:
    """The touching planes of all pairs of cameras: P pairs, two planes each, V cameras."""

    cameras: tuple[CameraId, ...]  # V
    pairs: Pairs  # (P, 2)
    rays: Floats  # (P, 2 cameras, 2 planes, 3) world directions of the points that touch, 1 along the optical axis
    residuals_px: Floats  # (P, 2 planes) first camera minus second; NaN where a plane is not to be trusted
    ray_gradients: Floats  # (P, 2 cameras, 2 planes, 3) change of the residual with each of these rays
    pixel_gradients: Floats  # (P, 2 cameras, 2 planes, 2) the same per pixel (u, v) that an outline moves


def epipolar_tangents(outlines: Outlines, rig: RigCalibration) -> EpipolarTangents:
    """Compare the touching planes of every pair of cameras.

    Parameters
    ----------
    outlines
        Edge points of each camera; a plane that touches beside a gap is not trusted.
    rig
        Calibrates every camera in `outlines`; cameras without an outline are left out.
    """
    return tangents_of(outline_hulls(outlines, rig), rig)


def outline_hulls(outlines: Outlines, rig: RigCalibration) -> OutlineHulls:
    """Find the hulls' corners: the first half of `epipolar_tangents`, which the cameras' poses do not change."""
    cameras = [camera for camera in rig.cameras if len(outlines.get(camera.id, ())) >= MIN_POINTS]
    stacked = stack_outlines([outlines[camera.id] for camera in cameras])
    return hulls_of_views([camera.id for camera in cameras], camera_arrays(cameras), stacked)


def hulls_of_views(
    camera_ids: Sequence[CameraId], cameras: CameraArrays, outlines: StackedOutlines
) -> OutlineHulls:
    """Find the hulls' corners of V cameras' outlines, each of `MIN_POINTS` points or more."""
    corners, is_closed = hull_corners(outlines)
    owners = np.repeat(np.arange(len(camera_ids)), corners.shape[1])
    rays = np.ones((*corners.shape, 3))
    normalized = cameras.normalized_coordinates(outlines.points_uv[corners.ravel()], owners)
    rays[:, :, :2] = normalized.reshape(*corners.shape, 2)
    return OutlineHulls(
        cameras=tuple(camera_ids),
        rays=rays,
        is_trusted=is_edge_seen(outlines, corners, reach=1),
        is_closed=is_closed,
    )


def tangents_of(hulls: OutlineHulls, rig: RigCalibration) -> EpipolarTangents:
    """Compare the hulls with the cameras where this rig has them: the second half of `epipolar_tangents`."""
    return pairwise_tangents(
        hulls, camera_arrays([camera for camera in rig.cameras if camera.id in hulls.cameras])
    )


def pairwise_tangents(hulls: OutlineHulls, cameras: CameraArrays) -> EpipolarTangents:
    """Find the planes through each pair's baseline that touch the hulls of these cameras (V), and their residuals."""
    pairs = np.stack(np.triu_indices(len(hulls.cameras), 1), axis=1)
    rays, ray_gradients = np.empty((2, len(pairs), 2, 2, 3))
    pixel_gradients, residuals_px = np.empty((len(pairs), 2, 2, 2)), np.empty((len(pairs), 2))
    world_rays = hulls.rays @ cameras.R
    _touch(
        world_rays, hulls.is_trusted, pairs, world_rays.sum(axis=1), cameras.centers_mm, cameras.R, cameras.K,
        np.empty((2, 3)), np.empty((2, 2), np.int64), residuals_px, rays, ray_gradients, pixel_gradients,
    )  # fmt: skip
    return EpipolarTangents(
        cameras=hulls.cameras,
        pairs=pairs,
        rays=rays,
        residuals_px=residuals_px,
        ray_gradients=ray_gradients,
        pixel_gradients=pixel_gradients,
    )


def outlines_of(silhouettes: Mapping[CameraId, Silhouette]) -> dict[CameraId, PointsUV]:
    """Return the outlines of the usable silhouettes."""
    return {camera: seen.outline_uv for camera, seen in silhouettes.items() if seen.is_usable}


def epipolar_residuals_px(tangents: EpipolarTangents) -> Values:
    """Return the residual (P,) of each pair: rms of its two planes, NaN where neither is to be trusted."""
    known = ~np.isnan(tangents.residuals_px)
    total = np.where(known, tangents.residuals_px, 0) ** 2
    count = known.sum(axis=1)
    return np.where(count > 0, np.sqrt(total.sum(axis=1) / np.maximum(count, 1)), np.nan)


def tangency_scores_px(
    tangents: EpipolarTangents, without: Collection[CameraId] = ()
) -> dict[CameraId, float]:
    """Return the median residual of each camera's pairs; cameras with fewer than `MIN_PAIRS` have none.

    Cameras in `without`, and pairs with them, are left out.
    """
    residuals_px = np.full((len(tangents.cameras),) * 2, np.nan)
    first, second = tangents.pairs.T
    residuals_px[first, second] = residuals_px[second, first] = epipolar_residuals_px(tangents)
    residuals_px[:, [camera in without for camera in tangents.cameras]] = np.nan
    counts = (~np.isnan(residuals_px)).sum(axis=1)
    in_order_px = np.sort(residuals_px, axis=1).tolist()  # unknown ones last
    return {
        camera: (row_px[(count - 1) // 2] + row_px[count // 2]) / 2
        for camera, row_px, count in zip(tangents.cameras, in_order_px, counts.tolist(), strict=True)
        if count >= MIN_PAIRS and camera not in without
    }


def image_shifts_px(tangents: EpipolarTangents) -> dict[CameraId, tuple[float, float]]:
    """Return by how much (du, dv) each camera's outline lies beside where the others expect it.

    It is the shift that leaves the least sum of absolute residuals over the camera's pairs (least squares,
    reweighted), so that a few pairs with another bad camera do not count.
    """
    n_cameras = len(tangents.cameras)
    if n_cameras <= MIN_PAIRS:
        return {}
    shifts_px = np.zeros((n_cameras, 2))
    _find_least_shifts(tangents.pairs, tangents.pixel_gradients, tangents.residuals_px, shifts_px)
    known = (~np.isnan(tangents.residuals_px)).sum(axis=1)
    counts = np.bincount(tangents.pairs.ravel(), np.repeat(known, 2))
    return {
        camera: (du, dv)
        for camera, (du, dv), count in zip(tangents.cameras, shifts_px.tolist(), counts.tolist(), strict=True)
        if count >= 2 * MIN_PAIRS
    }


@compiled
def _find_least_shifts(
    pairs: Pairs, pixel_gradients: Floats, residuals_px: Floats, shifts_px: Annotated[Floats, "(V, 2)"]
) -> None:
    """Move the shifts (V, 2), at first zero, to those of `image_shifts_px`."""
    for camera in range(len(shifts_px)):
        for weighting in range(REWEIGHTINGS):
            uu, uv, vv, u, v = 1e-9, 0.0, 1e-9, 0.0, 0.0
            for pair in range(len(pairs)):
                for side in range(2):
                    if pairs[pair, side] != camera:
                        continue
                    for plane in range(2):
                        residual_px = residuals_px[pair, plane]
                        by_u = pixel_gradients[pair, side, plane, 0]
                        by_v = pixel_gradients[pair, side, plane, 1]
                        left_px = residual_px - by_u * shifts_px[camera, 0] - by_v * shifts_px[camera, 1]
                        weight = 1.0 if weighting == 0 else 1 / max(abs(left_px), LEAST_RESIDUAL_PX)
                        if not np.isnan(residual_px):
                            uu += weight * by_u * by_u
                            uv += weight * by_u * by_v
                            vv += weight * by_v * by_v
                            u += weight * by_u * residual_px
                            v += weight * by_v * residual_px
            determinant = uu * vv - uv * uv
            shifts_px[camera, 0] = (vv * u - uv * v) / determinant
            shifts_px[camera, 1] = (uu * v - uv * u) / determinant


@compiled
def _touch(
    rays: Floats,
    is_trusted: NDArray[np.bool_],
    pairs: Pairs,
    middles: PointsMM,
    centers_mm: PointsMM,
    R: Floats,
    K: Floats,
    frame: Annotated[Floats, "(2, 3)"],
    touched: NDArray[np.int64],
    residuals_px: Floats,
    touching: Floats,
    by_ray: Floats,
    by_pixel: Floats,
) -> None:
    """Fill in the last four: residuals, rays and gradients of `EpipolarTangents` for each pair (P, 2).

    The cameras see world rays (V, H, 3) around middles (V, 3). Angles are measured in the plane across the baseline,
    from the unit vector in the first row of `frame` (2, 3), which points to the first camera's middle, towards the
    second. `frame` and `touched` (2, 2), corners by side and plane, are scratch.
    """
    for pair in range(len(pairs)):
        a, b = pairs[pair, 0], pairs[pair, 1]
        ex, ey = centers_mm[b, 0] - centers_mm[a, 0], centers_mm[b, 1] - centers_mm[a, 1]
        ez = centers_mm[b, 2] - centers_mm[a, 2]
        x, y, z = middles[a, 0], middles[a, 1], middles[a, 2]
        along = (x * ex + y * ey + z * ez) / max(ex * ex + ey * ey + ez * ez, TINY)
        x, y, z = x - along * ex, y - along * ey, z - along * ez
        frame[0, 0], frame[0, 1], frame[0, 2] = x, y, z
        frame[1, 0], frame[1, 1], frame[1, 2] = ey * z - ez * y, ez * x - ex * z, ex * y - ey * x
        for axis in range(2):
            x, y, z = frame[axis, 0], frame[axis, 1], frame[axis, 2]
            length = max(np.sqrt(x * x + y * y + z * z), TINY)
            for k in range(3):
                frame[axis, k] /= length
        is_pierced = False
        for side in range(2):
            view, least, greatest = pairs[pair, side], np.inf, -np.inf
            for corner in range(rays.shape[1]):
                x = y = 0.0
                for k in range(3):
                    x += rays[view, corner, k] * frame[0, k]
                    y += rays[view, corner, k] * frame[1, k]
                is_pierced |= x <= 0
                slope = y / x
                if slope < least:
                    least, touched[side, 0] = slope, corner
                if slope > greatest:
                    greatest, touched[side, 1] = slope, corner
        for plane in range(2):
            is_known, difference, squares = not is_pierced, 0.0, 0.0
            for side in range(2):
                view, corner, sign = pairs[pair, side], touched[side, plane], 1.0 - 2.0 * side
                x = y = 0.0
                for k in range(3):
                    touching[pair, side, plane, k] = rays[view, corner, k]
                    x += rays[view, corner, k] * frame[0, k]
                    y += rays[view, corner, k] * frame[1, k]
                is_known &= is_trusted[view, corner] & (abs(y) <= MAX_SLOPE * x)
                difference += sign * np.arctan2(y, x)
                turn = sign / max(x * x + y * y, TINY)
                for k in range(3):
                    by_ray[pair, side, plane, k] = turn * (x * frame[1, k] - y * frame[0, k])
                for axis in range(2):
                    by_axis = 0.0
                    for k in range(3):
                        by_axis += by_ray[pair, side, plane, k] * R[view, axis, k]
                    by_axis /= K[view, axis, axis]
                    by_pixel[pair, side, plane, axis] = by_axis
                    squares += by_axis * by_axis
            per_px = 1 / max(np.sqrt(squares / 2), TINY)
            residuals_px[pair, plane] = difference * per_px if is_known else np.nan
            for side in range(2):
                for k in range(3):
                    by_ray[pair, side, plane, k] *= per_px
                for k in range(2):
                    by_pixel[pair, side, plane, k] *= per_px
