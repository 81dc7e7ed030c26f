"""Where the cameras are now, from the stones that fall anyway.

The planes through the baseline of two cameras that touch a stone are the same for both (see `tangency`). Every
stone gives two such equations a pair of cameras; from a score of stones they say how a camera has moved. Solved
are the poses; the optics stay as calibrated.

Stones have no known size and no known place: the rig's scale, position and orientation cannot be seen in them.
The scale stays that of the last calibration with a ball: cameras that are not solved for hold it, and the priors do.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # what is used of it is imported then
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pipeline.errors import CalibrationError, Problem, ProblemCode
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.views.epipolar_tangency import (
    ALARM_PX,
    MIN_PAIRS,
    OutlineHulls,
    Outlines,
    outline_hulls,
    tangency_scores_px,
    tangents_of,
)

Array = NDArray[np.float64]

MIN_STONES = 20
EVERY_NTH_JUDGES = 5
"""These stones are kept out of the fit and judge it."""
ROTATION_PRIOR_RAD = np.deg2rad(0.1)
SHIFT_PRIOR_MM = 0.3
"""How far a camera moves by itself; the robust loss lets one that was hit move further."""
NOISE_PX = 0.1
"""Of a touching plane; beyond it the loss grows linearly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Movement:
    """Of one camera, against the calibration that it had."""

    rotation_deg: float
    shift_mm: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoneCalibration:
    """A rig that fits the stones, and the evidence for it, from stones that were not fitted."""

    rig: RigCalibration
    moved: Mapping[CameraId, Movement]  # the cameras that were solved for
    scores_before_px: Mapping[CameraId, float]
    scores_after_px: Mapping[CameraId, float]
    n_fitted: int
    n_judges: int

    @property
    def is_acceptable(self) -> bool:
        """Whether no camera contradicts the others any more."""
        return max(self.scores_after_px.values(), default=np.inf) < ALARM_PX


def recalibrate(
    stones: Sequence[Outlines],
    rig: RigCalibration,
    *,
    created_at: str,
    name: str,
    cameras: Collection[CameraId] | None = None,
) -> StoneCalibration:
    """Solve for the poses of some cameras from outlines of stones.

    Parameters
    ----------
    stones
        Outlines (see `tangency.outlines_of`) of at least `MIN_STONES` stones, seen by the rig as it is now.
    rig
        The calibration that no longer fits.
    created_at, name
        Of the new rig. Its `method` and `ball_diameter_mm` stay, as its scale does.
    cameras
        Those to solve for; the others stay where they are. Default: those whose score is beyond `ALARM_PX`, and
        all of them when there is none, or when more than half of the rig are.

    Raises
    ------
    CalibrationError
        There are too few stones, or the rig has no such camera.
    """
    hulls = [outline_hulls(stone, rig) for stone in stones]
    hulls = [stone for stone in hulls if len(stone.cameras) > MIN_PAIRS]
    if len(hulls) < MIN_STONES:
        detail = f"{len(hulls)} stones with usable silhouettes are too few: let at least {MIN_STONES} fall"
        raise CalibrationError([Problem(code=ProblemCode.TOO_FEW_STONES, detail=detail)])
    if unknown := sorted(set(cameras or ()) - set(rig.camera_ids)):
        detail = f"the rig {rig.name} has no camera {', '.join(unknown)}: name cameras of the rig file"
        raise CalibrationError([Problem(code=ProblemCode.UNKNOWN_CAMERA, detail=detail)])
    judges = hulls[EVERY_NTH_JUDGES - 1 :: EVERY_NTH_JUDGES]
    fitted = [stone for n, stone in enumerate(hulls, 1) if n % EVERY_NTH_JUDGES]
    wanted = displaced_cameras(fitted, rig) if cameras is None else cameras
    free = tuple(camera for camera in rig.camera_ids if camera in wanted)
    poses = _Poses(rig, free)
    solution = scipy.optimize.least_squares(
        poses.residuals, np.zeros(6 * len(free)), jac=poses.jacobian, loss="soft_l1", args=(fitted,)
    )
    moved = poses.rig_at(solution.x)
    return StoneCalibration(
        rig=replace(moved, created_at=created_at, name=name),
        moved={
            camera: Movement(
                rotation_deg=float(np.rad2deg(np.linalg.norm(w))), shift_mm=float(np.linalg.norm(t))
            )
            for camera, w, t in zip(free, *poses.unpacked(solution.x), strict=True)
        },
        scores_before_px=median_scores_px(judges, rig),
        scores_after_px=median_scores_px(judges, moved),
        n_fitted=len(fitted),
        n_judges=len(judges),
    )


def displaced_cameras(stones: Sequence[OutlineHulls], rig: RigCalibration) -> tuple[CameraId, ...]:
    """The cameras to solve for: those that the others contradict, or all."""
    scores_px = median_scores_px(stones, rig)
    displaced = tuple(camera for camera, score_px in scores_px.items() if score_px >= ALARM_PX)
    return displaced if 0 < len(displaced) <= len(rig.cameras) / 2 else rig.camera_ids


def median_scores_px(stones: Sequence[OutlineHulls], rig: RigCalibration) -> dict[CameraId, float]:
    """Median over the stones of each camera's score; cameras without any are left out."""
    scores_px = [tangency_scores_px(tangents_of(stone, rig)) for stone in stones]
    return {
        camera: float(np.median(known))
        for camera in rig.camera_ids
        if (known := [stone[camera] for stone in scores_px if camera in stone])
    }


@dataclass(frozen=True, slots=True)
class _Poses:
    """The rig as a function of six numbers a free camera: a turn about its own centre, and a shift.

    Both are in the world frame and in units of their priors.
    """

    rig: RigCalibration
    free: tuple[CameraId, ...]

    def unpacked(self, x: Array) -> tuple[Array, Array]:
        """Rotation vectors (F, 3) in rad and shifts (F, 3) in mm."""
        per_camera = x.reshape(-1, 2, 3)
        return ROTATION_PRIOR_RAD * per_camera[:, 0], SHIFT_PRIOR_MM * per_camera[:, 1]

    def rig_at(self, x: Array) -> RigCalibration:
        moves = dict(zip(self.free, zip(*self.unpacked(x), strict=True), strict=True))
        cameras = tuple(
            _moved(camera, *moves[camera.id]) if camera.id in moves else camera for camera in self.rig.cameras
        )
        return replace(self.rig, cameras=cameras)

    def residuals(self, x: Array, stones: Sequence[OutlineHulls]) -> Array:
        """Of all touching planes, in units of their noise, and of the priors."""
        rig = self.rig_at(x)
        found_px = [np.nan_to_num(tangents_of(stone, rig).residuals_px).ravel() for stone in stones]
        return np.concatenate([np.concatenate(found_px) / NOISE_PX, x])

    def jacobian(self, x: Array, stones: Sequence[OutlineHulls]) -> Array:
        """The derivative of `residuals`, for small turns."""
        rig = self.rig_at(x)
        return np.concatenate([*(self._of_stone(stone, rig) for stone in stones), np.eye(len(x))])

    def _of_stone(self, stone: OutlineHulls, rig: RigCalibration) -> Array:
        """With rays a, b of two cameras, r = -k e . (a x b) for the baseline e; k is read off its gradient by a."""
        tangents = tangents_of(stone, rig)
        centers_mm = {camera.id: camera.center_mm for camera in rig.cameras}
        centers = np.array([centers_mm[camera] for camera in tangents.cameras])
        baselines = (centers[tangents.pairs[:, 1]] - centers[tangents.pairs[:, 0]])[:, None]
        a, b = tangents.rays[:, 0], tangents.rays[:, 1]
        by_a = np.cross(b, baselines)
        k = -(tangents.ray_gradients[:, 0] * by_a).sum(axis=-1) / np.maximum((by_a**2).sum(axis=-1), 1e-12)
        by_center = k[..., None] * np.cross(a, b)
        by_turn = np.cross(tangents.rays, tangents.ray_gradients)  # (P, 2 cameras, 2 planes, 3)
        jacobian = np.zeros((len(tangents.pairs), 2, len(self.free), 2, 3))
        for side, sign in ((0, 1.0), (1, -1.0)):
            for pair, camera in enumerate(tangents.pairs[:, side]):
                if (name := tangents.cameras[camera]) in self.free:
                    column = self.free.index(name)
                    jacobian[pair, :, column, 0] = ROTATION_PRIOR_RAD * by_turn[pair, side]
                    jacobian[pair, :, column, 1] = sign * SHIFT_PRIOR_MM * by_center[pair]
        jacobian[np.isnan(tangents.residuals_px)] = 0
        return jacobian.reshape(2 * len(tangents.pairs), -1) / NOISE_PX


def _moved(camera: CameraCalibration, turn: Array, shift_mm: Array) -> CameraCalibration:
    R = camera.R @ Rotation.from_rotvec(-turn).as_matrix()
    return replace(camera, R=R, t_mm=-R @ (camera.center_mm + shift_mm), rms_px=None)
