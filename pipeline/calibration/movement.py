"""Find cameras that are not where the initial rig has them, and cameras that moved between the drops."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import PointsUV, Vector, Vector2
from pipeline.calibration.drops import BallDrop
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration

HALF_VOLUME_MM = 8.0
"""Half the edge of the cube of points that stands for the measuring volume."""
SMALL_MM = 0.01
"""Step of the numerical derivatives."""
N_REWEIGHTINGS = 30
MIN_SHIFT_PX = 0.02
"""Floor of the shifts in the weights, which stay finite."""
MIN_SIDE = 2
"""Least number of drops before and after a step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A lasting shift of a camera's images between two drops."""

    after: str  # name of the last drop before it
    shift_px: float
    significance: float  # the shift in standard deviations of itself


def image_changes_px(rig: RigCalibration, initial: RigCalibration) -> Mapping[CameraId, float]:
    """Return for each camera the rms difference between its images of the measuring volume in two rigs.

    Rotation, place, focal length and principal point of a camera compensate one another, their effect on the image is
    unique. Place and size of the rig as a whole do not count: the similarity that explains the shifts of most cameras
    (least sum of their rms) is subtracted.
    """
    axis_mm = np.array([-HALF_VOLUME_MM, 0.0, HALF_VOLUME_MM])
    points_mm = np.stack(np.meshgrid(axis_mm, axis_mm, axis_mm), axis=-1).reshape(-1, 3)
    before = [camera for camera in initial.cameras if camera.id in rig.camera_ids]
    seen_uv = np.stack([camera.project(points_mm)[0] for camera in before])  # (C, N, 2)
    shifts_uv = np.stack([camera.project(points_mm)[0] for camera in rig.cameras]) - seen_uv
    moved_mm = [points_mm + SMALL_MM * unit for unit in np.eye(3)]
    moved_mm += [points_mm + SMALL_MM / HALF_VOLUME_MM * np.cross(unit, points_mm) for unit in np.eye(3)]
    moved_mm += [points_mm * (1 + SMALL_MM / HALF_VOLUME_MM)]
    motions_uv = np.stack(
        [[camera.project(points)[0] for camera in before] - seen_uv for points in moved_mm], axis=-1
    )  # (C, N, 2, 7)
    weights = np.ones(len(before))
    for _ in range(N_REWEIGHTINGS):
        root = np.sqrt(weights)[:, None, None]
        common, *_ = np.linalg.lstsq(
            (motions_uv * root[..., None]).reshape(-1, len(moved_mm)), (shifts_uv * root).ravel(), rcond=None
        )
        own_px = np.sqrt(((shifts_uv - motions_uv @ common) ** 2).sum(axis=2).mean(axis=1))
        weights = 1 / np.maximum(own_px, MIN_SHIFT_PX)
    return {camera.id: float(own_px[index]) for index, camera in enumerate(rig.cameras)}


def steps(
    drops: Sequence[BallDrop],
    rig: RigCalibration,
    ball_centers_mm: Mapping[str, tuple[float, float, float]],
) -> Mapping[CameraId, Step]:
    """Return for each camera the most significant step of its residuals over the drops, which are in order of time."""
    found = {}
    for camera in rig.cameras:
        names, residuals_uv = [], []
        for drop in drops:
            if drop.name in ball_centers_mm and camera.id in drop.views:
                names.append(drop.name)
                center_mm = np.array(ball_centers_mm[drop.name])
                residuals_uv.append(_residual_uv(camera, drop.views[camera.id].outline_uv, center_mm))
        if (step := _most_significant_step(names, np.array(residuals_uv))) is not None:
            found[camera.id] = step
    return found


def _residual_uv(camera: CameraCalibration, outline_uv: PointsUV, ball_mm: Vector) -> Vector2:
    """Return the observed minus the predicted image of a ball's centre.

    Observed is the axis of the cone of viewing rays that touch the ball: the ends of their unit vectors lie in a
    plane, whose normal is the axis.
    """
    normal, *_ = np.linalg.lstsq(camera.rays(outline_uv), np.ones(len(outline_uv)), rcond=None)
    seen_uv, _ = camera.project((camera.center_mm + normal / np.linalg.norm(normal))[None])
    predicted_uv, _ = camera.project(ball_mm[None])
    return np.asarray(seen_uv[0] - predicted_uv[0])


def _most_significant_step(names: Sequence[str], residuals_uv: PointsUV) -> Step | None:
    n_drops = len(names)
    best: Step | None = None
    for n_before in range(MIN_SIDE, n_drops - MIN_SIDE + 1):
        before_uv, after_uv = residuals_uv[:n_before], residuals_uv[n_before:]
        mean_before, mean_after = before_uv.mean(axis=0), after_uv.mean(axis=0)
        squares = ((before_uv - mean_before) ** 2).sum() + ((after_uv - mean_after) ** 2).sum()
        variance = squares / (2 * (n_drops - 2)) * (1 / n_before + 1 / (n_drops - n_before))
        shift_px = float(np.linalg.norm(mean_after - mean_before))
        significance = shift_px / max(float(np.sqrt(variance)), 1e-6)
        if best is None or significance > best.significance:
            best = Step(after=names[n_before - 1], shift_px=shift_px, significance=significance)
    return best
