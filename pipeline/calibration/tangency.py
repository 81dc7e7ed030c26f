"""Do two cameras agree on one body? Epipolar tangency, from outlines alone, without any reconstruction.

A plane through the optical centres of two cameras that touches the body is seen by both of them: it touches
the outline in both images (Cipolla and Giblin, *Visual Motion of Curves and Surfaces*, 2000). So the two
planes through the baseline that touch the outline of camera a are those that touch the outline of camera b.
A plane through the baseline is one angle; the difference of the two angles is the residual, expressed in
pixels of image motion across the epipolar line (to first order the Sampson distance of the two points).

A camera that moved has all its pairs wrong, the others one pair each: the median over a camera's pairs names it.
What no pair shows, nobody can see: the whole rig turned, moved or scaled, an outline too wide everywhere,
a camera turned about the line of sight to a round body.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.compiled import compiled
from pipeline.frames import CameraId
from pipeline.outline_hull import hull_corners, is_closed
from pipeline.rig import RigCalibration
from pipeline.segmentation.silhouette import Silhouette

Array = NDArray[np.float64]
Outlines = Mapping[CameraId, Array]

ALARM_PX = 0.3
"""Score from which a camera is said to have moved, three times that of a healthy one."""
MAX_SLOPE = 5.0
"""Of a touching plane against the one through the body's middle; beyond it the baseline (nearly) pierces the
silhouette, and a plane through it has nothing to touch."""
MIN_PAIRS = 3
"""The median of fewer pairs says nothing about who is wrong."""
REWEIGHTINGS = 10
LEAST_RESIDUAL_PX = 0.05
"""Below it, the noise of an outline, all residuals weigh the same."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OutlineHulls:
    """The corners of the outlines' convex hulls: only they can touch a plane."""

    cameras: tuple[CameraId, ...]  # V
    rays: Array  # (V, H, 3) in each camera's own frame, 1 along the optical axis; short hulls repeat their first
    is_trusted: NDArray[np.bool_]  # (V, H) the edge was seen on both sides of the corner
    is_closed: NDArray[np.bool_]  # (V,) the edge was seen all around


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EpipolarTangents:
    """The touching planes of all pairs of cameras: P pairs, two planes each, V cameras."""

    cameras: tuple[CameraId, ...]  # V
    pairs: NDArray[np.int64]  # (P, 2) indices of the two cameras
    rays: Array  # (P, 2 cameras, 2 planes, 3) world directions of the points that touch, 1 along the optical axis
    residuals_px: Array  # (P, 2 planes) first camera minus second; NaN where a plane is not to be trusted
    ray_gradients: Array  # (P, 2 cameras, 2 planes, 3) change of the residual with each of these rays
    gradients: Array  # (P, 2 cameras, 2 planes, 2) the same per pixel (u, v) that an outline moves


def epipolar_tangents(outlines: Outlines, rig: RigCalibration) -> EpipolarTangents:
    """Compare the touching planes of every pair of cameras.

    Parameters
    ----------
    outlines
        Edge points (N, 2) as (u, v) in order around the body; a plane that touches beside a gap is not trusted.
    rig
        Calibrates every camera in `outlines`; cameras without an outline are left out.
    """
    return tangents_of(outline_hulls(outlines, rig), rig)


def outline_hulls(outlines: Outlines, rig: RigCalibration) -> OutlineHulls:
    """The first half of `epipolar_tangents`, which does not change with the poses of the cameras."""
    views = [camera for camera in rig.cameras if len(outlines.get(camera.id, ())) >= 3]
    corners, trusted = [], []
    for camera in views:
        outline_uv = outlines[camera.id]
        on_hull, goes_on = hull_corners(outline_uv)
        corners.append(camera.flat_rays(outline_uv[on_hull]))
        trusted.append(goes_on)
    longest = max((len(points) for points in corners), default=1)
    rays = np.ones((len(views), longest, 3))
    is_trusted = np.empty((len(views), longest), bool)
    for view, (points, flags) in enumerate(zip(corners, trusted, strict=True)):
        rays[view, : len(points), :2], rays[view, len(points) :, :2] = points, points[0]
        is_trusted[view, : len(flags)], is_trusted[view, len(flags) :] = flags, flags[0]
    return OutlineHulls(
        cameras=tuple(camera.id for camera in views),
        rays=rays,
        is_trusted=is_trusted,
        is_closed=np.array([is_closed(outlines[camera.id]) for camera in views], bool),
    )


def tangents_of(hulls: OutlineHulls, rig: RigCalibration) -> EpipolarTangents:
    """The second half of `epipolar_tangents`."""
    views = rig.subset(hulls.cameras).cameras
    R = np.array([camera.R for camera in views]).reshape(-1, 3, 3)
    centers_mm = np.array([camera.center_mm for camera in views]).reshape(-1, 3)
    focal_px = np.array([[camera.K[0, 0], camera.K[1, 1]] for camera in views]).reshape(-1, 2)
    rays = hulls.rays @ R
    pairs = np.column_stack(np.triu_indices(len(views), 1))
    frames = _frames(centers_mm, rays.mean(axis=1), pairs)
    angles, trusted, touching, by_ray, by_pixel = _touching(
        rays, hulls.is_trusted, pairs, frames, R, focal_px
    )
    scale = np.maximum(np.sqrt((by_pixel**2).sum(axis=(1, 3)) / 2), 1e-12)  # of the angle, rad/px
    residuals_px = (angles[:, 0] - angles[:, 1]) / scale
    residuals_px[~trusted.all(axis=1)] = np.nan
    return EpipolarTangents(
        cameras=hulls.cameras,
        pairs=pairs,
        rays=touching,
        residuals_px=residuals_px,
        ray_gradients=by_ray / scale[:, None, :, None],
        gradients=by_pixel / scale[:, None, :, None],
    )


def outlines_of(silhouettes: Mapping[CameraId, Silhouette]) -> dict[CameraId, Array]:
    """The outlines of the usable silhouettes."""
    return {camera: seen.outline_uv for camera, seen in silhouettes.items() if seen.is_usable}


def epipolar_residuals_px(tangents: EpipolarTangents) -> Array:
    """Residual of each pair (P,): rms of its two planes, NaN where neither is to be trusted."""
    known = ~np.isnan(tangents.residuals_px)
    total = np.where(known, tangents.residuals_px, 0) ** 2
    count = known.sum(axis=1)
    return np.where(count > 0, np.sqrt(total.sum(axis=1) / np.maximum(count, 1)), np.nan)


def tangency_scores_px(
    tangents: EpipolarTangents, without: Collection[CameraId] = ()
) -> dict[CameraId, float]:
    """Median residual of each camera's pairs, those with cameras in `without` left out; too few pairs, no score."""
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
    """By how much (du, dv) each camera's outline lies beside where the others expect it.

    The shift that leaves the least sum of absolute residuals over the camera's pairs (least squares, reweighted),
    so that a few pairs with another bad camera do not count.
    """
    n_cameras = len(tangents.cameras)
    if n_cameras <= MIN_PAIRS:
        return {}
    shifts_px, counts = _least_shifts(
        tangents.pairs, tangents.gradients, tangents.residuals_px, np.zeros((n_cameras, 2))
    )
    return {
        camera: (du, dv)
        for camera, (du, dv), count in zip(tangents.cameras, shifts_px.tolist(), counts.tolist(), strict=True)
        if count >= 2 * MIN_PAIRS
    }


@compiled
def _least_shifts(
    pairs: NDArray[np.int64], gradients: Array, residuals_px: Array, shifts_px: Array
) -> tuple[Array, NDArray[np.int64]]:
    """The shifts (V, 2) of `image_shifts_px`, found from those given, and of how many residuals (V,)."""
    counts = np.zeros(len(shifts_px), np.int64)
    for camera in range(len(shifts_px)):
        for weighting in range(REWEIGHTINGS):
            uu, uv, vv, u, v, count = 1e-9, 0.0, 1e-9, 0.0, 0.0, 0
            for pair in range(len(pairs)):
                if pairs[pair, 0] != camera and pairs[pair, 1] != camera:
                    continue
                side = int(pairs[pair, 1] == camera)
                for plane in range(2):
                    residual_px = residuals_px[pair, plane]
                    if np.isnan(residual_px):
                        continue
                    by_u, by_v = gradients[pair, side, plane, 0], gradients[pair, side, plane, 1]
                    left_px = residual_px - by_u * shifts_px[camera, 0] - by_v * shifts_px[camera, 1]
                    weight = 1.0 if weighting == 0 else 1 / max(abs(left_px), LEAST_RESIDUAL_PX)
                    uu, uv, vv = (
                        uu + weight * by_u * by_u,
                        uv + weight * by_u * by_v,
                        vv + weight * by_v * by_v,
                    )
                    u, v = u + weight * by_u * residual_px, v + weight * by_v * residual_px
                    count += 1
            determinant = uu * vv - uv * uv
            shifts_px[camera, 0] = (vv * u - uv * v) / determinant
            shifts_px[camera, 1] = (uu * v - uv * u) / determinant
            counts[camera] = count
    return shifts_px, counts


def _frames(centers_mm: Array, middles: Array, pairs: NDArray[np.int64]) -> Array:
    """Unit vectors (P, 3, 2) square to each baseline: towards the body, and across."""
    first, second = pairs.T
    baseline = _unit(centers_mm[second] - centers_mm[first])
    towards = np.zeros_like(baseline)
    for side in (first, second):
        towards += _unit(middles[side] - (middles[side] * baseline).sum(axis=1, keepdims=True) * baseline)
    towards = _unit(towards)
    return np.stack([towards, np.cross(baseline, towards)], axis=2)


@compiled
def _touching(
    rays: Array,
    is_trusted: NDArray[np.bool_],
    pairs: NDArray[np.int64],
    frames: Array,
    R: Array,
    focal_px: Array,
) -> tuple[Array, NDArray[np.bool_], Array, Array, Array]:
    """The two extreme planes of both cameras of each pair (P, 2) among rays (V, H, 3), by the pairs' frames (P, 3, 2).

    Returns their angles (P, 2, 2), whether they can be trusted (P, 2, 2), the rays (P, 2, 2, 3) that touch, and the
    gradients of the first camera's angle minus the second's: by ray (P, 2, 2, 3) and by pixel (P, 2, 2, 2).
    """
    shape = (len(pairs), 2, 2)
    angles, trusted = np.empty(shape), np.empty(shape, np.bool_)
    touching, by_ray, by_pixel = np.empty((*shape, 3)), np.empty((*shape, 3)), np.zeros((*shape, 2))
    for pair in range(len(pairs)):
        frame = frames[pair]
        for side in range(2):
            view, sign = pairs[pair, side], 1 - 2 * side
            least, greatest, is_pierced = np.inf, -np.inf, False
            first = last = 0
            for corner in range(rays.shape[1]):
                ray = rays[view, corner]
                towards = ray[0] * frame[0, 0] + ray[1] * frame[1, 0] + ray[2] * frame[2, 0]
                across = ray[0] * frame[0, 1] + ray[1] * frame[1, 1] + ray[2] * frame[2, 1]
                is_pierced |= towards <= 0
                slope = across / towards
                if slope < least:
                    least, first = slope, corner
                if slope > greatest:
                    greatest, last = slope, corner
            for plane, corner in enumerate((first, last)):
                at = (pair, side, plane)
                x = y = 0.0
                for axis in range(3):
                    touching[at][axis] = rays[view, corner, axis]
                    x += rays[view, corner, axis] * frame[axis, 0]
                    y += rays[view, corner, axis] * frame[axis, 1]
                trusted[at] = is_trusted[view, corner] and not is_pierced and abs(y) <= MAX_SLOPE * x
                angles[at] = np.arctan2(y, x)
                for axis in range(3):
                    turn = sign * (x * frame[axis, 1] - y * frame[axis, 0]) / max(x * x + y * y, 1e-12)
                    by_ray[at][axis] = turn
                    for image_axis in range(2):
                        by_pixel[at][image_axis] += (
                            turn * R[view, image_axis, axis] / focal_px[view, image_axis]
                        )
    return angles, trusted, touching, by_ray, by_pixel


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))
