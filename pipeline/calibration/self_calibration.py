"""Recalibrate camera poses from the stones that fall anyway.

Epipolar tangency: the planes through the baseline of two cameras that touch a stone are the same for both (see
`pipeline.views.epipolar_tangency`). Every stone gives two such equations per pair of cameras; twenty stones tell how
a camera has moved. Only poses are solved for; the intrinsic parameters stay as calibrated.

Stones have no known size or place: the rig's scale, position and orientation are not observable from them. The scale
stays that of the last calibration with a ball, held by the cameras that are not solved for and by the priors.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # imports its submodules on use
from scipy.spatial.transform import Rotation

from pipeline.arrays import Floats, Values, Vector
from pipeline.errors import CalibrationError, CalibrationProblem, ProblemCode
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

MIN_STONES = 20
HELD_OUT_EVERY = 5
"""Every fifth stone is held out of the fit and judges it."""
ROTATION_PRIOR_RAD = np.deg2rad(0.1)
SHIFT_PRIOR_MM = 0.3
"""Standard deviations by which a camera drifts; one that was hit may move further, as the loss is robust."""
NOISE_PX = 0.1
"""Standard deviation of a tangent plane's residual; beyond it the loss grows linearly."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Movement:
    """Change of one camera's pose from the calibration that it had."""

    rotation_deg: float
    shift_mm: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StoneCalibration:
    """A rig fitted to stones, with the tangency scores of stones held out of the fit as evidence."""

    rig: RigCalibration
    moved: Mapping[CameraId, Movement]  # the cameras that were solved for
    scores_before_px: Mapping[CameraId, float]
    scores_after_px: Mapping[CameraId, float]
    n_fitted: int  # stones in the fit
    n_judges: int  # stones held out of it

    @property
    def is_acceptable(self) -> bool:
        """Whether no camera contradicts the others any more, by the alarm limit."""
        return max(self.scores_after_px.values(), default=np.inf) < ALARM_PX


def recalibrate(
    stones: Sequence[Outlines],
    rig: RigCalibration,
    *,
    created_at: str,
    name: str,
    cameras: Collection[CameraId] | None = None,
) -> StoneCalibration:
    """Solve for the poses of some of a rig's cameras from outlines of stones.

    Parameters
    ----------
    stones
        Outlines (see `epipolar_tangency.outlines_of`) of at least `MIN_STONES` stones, seen by the rig as it is now.
    rig
        The calibration that no longer fits.
    created_at, name
        Those of the new rig. Its `method` and `ball_diameter_mm` stay, as its scale does.
    cameras
        Cameras to solve for; the others stay where they are. Default: those whose score is beyond `ALARM_PX`, or
        all if there are none, or if these are more than half of the rig.

    Raises
    ------
    CalibrationError
        There are too few stones, or the rig does not have one of `cameras`.
    """
    hulls = [outline_hulls(stone, rig) for stone in stones]
    hulls = [stone for stone in hulls if len(stone.cameras) > MIN_PAIRS]
    if len(hulls) < MIN_STONES:
        detail = f"{len(hulls)} stones with usable silhouettes are too few: let at least {MIN_STONES} fall"
        raise CalibrationError([CalibrationProblem(code=ProblemCode.TOO_FEW_STONES, detail=detail)])
    if unknown := sorted(set(cameras or ()) - set(rig.camera_ids)):
        detail = f"the rig {rig.name} has no camera {', '.join(unknown)}: name cameras of the rig file"
        raise CalibrationError([CalibrationProblem(code=ProblemCode.UNKNOWN_CAMERA, detail=detail)])
    judges = hulls[HELD_OUT_EVERY - 1 :: HELD_OUT_EVERY]
    fitted = [stone for n, stone in enumerate(hulls, 1) if n % HELD_OUT_EVERY]
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
    """Return the cameras to solve for: those beyond the alarm limit; all, if these are none or most."""
    scores_px = median_scores_px(stones, rig)
    displaced = tuple(camera for camera, score_px in scores_px.items() if score_px >= ALARM_PX)
    return displaced if 0 < len(displaced) <= len(rig.cameras) / 2 else rig.camera_ids


def median_scores_px(stones: Sequence[OutlineHulls], rig: RigCalibration) -> dict[CameraId, float]:
    """Return each camera's median tangency score over the stones; cameras without any are left out."""
    scores_px = [tangency_scores_px(tangents_of(stone, rig)) for stone in stones]
    return {
        camera: float(np.median(known))
        for camera in rig.camera_ids
        if (known := [stone[camera] for stone in scores_px if camera in stone])
    }


@dataclass(frozen=True, slots=True)
class _Poses:
    """The rig as a function of six parameters per free camera: a rotation about its own centre, and a shift.

    Both are in the world frame and in units of their priors.
    """

    rig: RigCalibration
    free: tuple[CameraId, ...]

    def unpacked(self, x: Values) -> tuple[Floats, Floats]:
        """Return rotation vectors (F, 3) in rad and shifts (F, 3) in mm."""
        per_camera = x.reshape(-1, 2, 3)
        return ROTATION_PRIOR_RAD * per_camera[:, 0], SHIFT_PRIOR_MM * per_camera[:, 1]

    def rig_at(self, x: Values) -> RigCalibration:
        """Return the rig with these parameters."""
        moves = dict(zip(self.free, zip(*self.unpacked(x), strict=True), strict=True))
        cameras = tuple(
            _moved(camera, *moves[camera.id]) if camera.id in moves else camera for camera in self.rig.cameras
        )
        return replace(self.rig, cameras=cameras)

    def residuals(self, x: Values, stones: Sequence[OutlineHulls]) -> Values:
        """Return the residuals of all tangent planes, in units of their noise, and of the priors."""
        rig = self.rig_at(x)
        found_px = [np.nan_to_num(tangents_of(stone, rig).residuals_px).ravel() for stone in stones]
        return np.concatenate([np.concatenate(found_px) / NOISE_PX, x])

    def jacobian(self, x: Values, stones: Sequence[OutlineHulls]) -> Floats:
        """Return the derivatives of `residuals`, to first order in the rotations."""
        rig = self.rig_at(x)
        return np.concatenate([*(self._of_stone(stone, rig) for stone in stones), np.eye(len(x))])

    def _of_stone(self, stone: OutlineHulls, rig: RigCalibration) -> Floats:
        """Return one stone's rows of the Jacobian.

        With rays a, b of two cameras, r = -k e . (a x b) for the baseline e; k follows from its gradient by a.
        """
        tangents = tangents_of(stone, rig)
        centers_mm = {camera.id: camera.center_mm for camera in rig.cameras}
        centers = np.array([centers_mm[camera] for camera in tangents.cameras])
        baselines = (centers[tangents.pairs[:, 1]] - centers[tangents.pairs[:, 0]])[:, None]
        a, b = tangents.rays[:, 0], tangents.rays[:, 1]
        by_a = np.cross(b, baselines)
        k = -(tangents.ray_gradients[:, 0] * by_a).sum(axis=-1) / np.maximum((by_a**2).sum(axis=-1), 1e-12)
        by_center = k[..., None] * np.cross(a, b)
        by_rotation = np.cross(tangents.rays, tangents.ray_gradients)  # (P, 2 cameras, 2 planes, 3)
        jacobian = np.zeros((len(tangents.pairs), 2, len(self.free), 2, 3))
        for side, sign in ((0, 1.0), (1, -1.0)):
            for pair, camera in enumerate(tangents.pairs[:, side]):
                if (name := tangents.cameras[camera]) in self.free:
                    column = self.free.index(name)
                    jacobian[pair, :, column, 0] = ROTATION_PRIOR_RAD * by_rotation[pair, side]
                    jacobian[pair, :, column, 1] = sign * SHIFT_PRIOR_MM * by_center[pair]
        jacobian[np.isnan(tangents.residuals_px)] = 0
        return jacobian.reshape(2 * len(tangents.pairs), -1) / NOISE_PX


def _moved(camera: CameraCalibration, rotation: Vector, shift_mm: Vector) -> CameraCalibration:
    R = camera.R @ Rotation.from_rotvec(-rotation).as_matrix()
    return replace(camera, R=R, t_mm=-R @ (camera.center_mm + shift_mm), rms_px=None)
