"""Coverage of the measuring volume and of the images by ball drops, and the drops that are missing."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.arrays import PointsMM, Vector
from pipeline.calibration.drops import BallDrop
from pipeline.frames import CameraId
from pipeline.rig.camera_arrays import nearest_point
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.schema import SCHEMA

CELL_PX = 32
"""Edge of the image cells by which the share of an image that showed a ball is counted."""
DIRECTIONS = {"+x": (0, 1), "-x": (0, -1), "+y": (1, 1), "-y": (1, -1), "+z": (2, 1), "-z": (2, -1)}
"""Axis and sign of the six directions of the world frame, by name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CoverageGoals:
    """Sufficient coverage; eight balls dropped at random within 9 mm mostly reach it."""

    __pydantic_config__ = SCHEMA

    n_drops: int = 8  # the paper's number; twice the drops reduce the error by the root of two only
    """Drops located by two cameras or more."""
    n_drops_per_camera: int = 5  # three determine the pose, two more check it
    """Drops that each camera saw whole."""
    reach_mm: float = 4.0  # half a stone of 8 mm: lengths are extrapolated less than twofold
    """Reach of the centres of the drops in each direction, mm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraCoverage:
    """Drops that one camera saw."""

    __pydantic_config__ = SCHEMA

    n_drops: int
    """Drops that this camera saw whole."""
    field_share: float
    """Share of the image in which drops were seen, 0..1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Coverage:
    """Distribution of the drops over the measuring volume and the images."""

    __pydantic_config__ = SCHEMA

    n_drops: int
    """Drops located by two cameras or more."""
    extent_mm: tuple[float, float, float]
    """Extent of their centres along x, y, z; mm."""
    spread_mm: tuple[float, float, float]
    """Standard deviation of their centres along their principal axes, mm."""
    reaches_mm: Mapping[str, float]
    """How far the centres reach from the middle of the rig, by direction: `+x`, `-x` ... `-z`; mm."""
    cameras: Mapping[CameraId, CameraCoverage]
    """By camera."""
    goals: CoverageGoals
    """What `is_sufficient` asks for."""
    missing: str | None
    """What to drop next; null when nothing is missing."""
    is_sufficient: bool
    """True if the drops suffice for a solution."""


def coverage(drops: Sequence[BallDrop], rig: RigCalibration, goals: CoverageGoals | None = None) -> Coverage:
    """Return the coverage of the measuring volume of `rig`, which may be roughly calibrated, by these drops."""
    goals = goals or CoverageGoals()
    located = [center for drop in drops if (center := ball_center_mm(drop, rig)) is not None]
    centers_mm = np.array(located).reshape(-1, 3)
    cameras = {camera.id: _camera_coverage(drops, camera) for camera in rig.cameras}
    reaches_mm = {
        name: float((sign * centers_mm[:, axis]).max(initial=0)) for name, (axis, sign) in DIRECTIONS.items()
    }
    missing = _missing(len(located), reaches_mm, cameras, goals)
    return Coverage(
        n_drops=len(located),
        extent_mm=_triple(np.ptp(centers_mm, axis=0) if located else np.zeros(3)),
        spread_mm=_triple(_principal_sd_mm(centers_mm)),
        reaches_mm=reaches_mm,
        cameras=cameras,
        goals=goals,
        missing=missing,
        is_sufficient=missing is None,
    )


def ball_center_mm(drop: BallDrop, rig: RigCalibration) -> Vector | None:
    """Return the point nearest to all viewing rays through the ball's centre; `None` with fewer than two views."""
    seen = [camera for camera in rig.cameras if camera.id in drop.views]
    if len(seen) < 2:
        return None
    directions = np.concatenate([camera.rays(drop.views[camera.id].center_uv[None, :]) for camera in seen])
    return nearest_point(np.array([camera.center_mm for camera in seen]), directions)


def _camera_coverage(drops: Sequence[BallDrop], camera: CameraCalibration) -> CameraCoverage:
    views = [drop.views[camera.id] for drop in drops if camera.id in drop.views]
    width_px, height_px = camera.image_size_px
    cells_uv = np.stack(
        np.meshgrid(np.arange(CELL_PX / 2, width_px, CELL_PX), np.arange(CELL_PX / 2, height_px, CELL_PX)),
        axis=-1,
    )
    is_seen = np.zeros(cells_uv.shape[:2], dtype=bool)
    for view in views:
        is_seen |= np.linalg.norm(cells_uv - view.center_uv, axis=-1) <= view.radius_px
    return CameraCoverage(n_drops=len(views), field_share=float(is_seen.mean()))


def _principal_sd_mm(centers_mm: PointsMM) -> Vector:
    """Return the standard deviations of points along their principal axes, greatest first."""
    if len(centers_mm) < 2:
        return np.zeros(3)
    variances = np.linalg.eigvalsh(np.cov(centers_mm, rowvar=False))
    return np.sqrt(np.maximum(variances[::-1], 0))


def _missing(
    n_located: int,
    reaches_mm: Mapping[str, float],
    cameras: Mapping[CameraId, CameraCoverage],
    goals: CoverageGoals,
) -> str | None:
    """Return in words what to drop next, the most important first; `None` if the goals are reached."""
    wanted = []
    if n_located < goals.n_drops:
        wanted.append(f"{goals.n_drops - n_located} more drops")
    short = [f"{name} (so far {mm:.1f} mm)" for name, mm in reaches_mm.items() if mm < goals.reach_mm]
    if short:
        wanted.append(f"drops further than {goals.reach_mm:g} mm towards {', '.join(short)}")
    blind = [
        f"{camera} ({seen.n_drops})"
        for camera, seen in cameras.items()
        if seen.n_drops < min(goals.n_drops_per_camera, n_located)
    ]
    if blind:
        wanted.append(
            f"drops that are whole in {', '.join(blind)}, where fewer than {goals.n_drops_per_camera} were"
        )
    return "; ".join(wanted) or None


def _triple(values: Vector) -> tuple[float, float, float]:
    x, y, z = values
    return float(x), float(y), float(z)
