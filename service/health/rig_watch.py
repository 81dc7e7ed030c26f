"""The rig watches itself: what the stones say about the cameras, stone after stone.

Every result carries a score per camera, the epipolar residual of its outlines against those of the others
(`pipeline.views.epipolar_tangency`), and the residual of its outline against the others' hull. A camera that is hit
shows in the first, in the next stone; dust and a failing light show in the second, slowly.

Whether a view is left out is decided for each stone alone, by the pipeline: it does not depend on which stones
came before, hence not on the number of workers. What lasts here is only the alarm.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np

from pipeline.fall import Fall
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.views.epipolar_tangency import ALARM_PX

WINDOW = 20
"""Stones that an opinion rests on."""
MIN_STONES = 5
"""The median of fewer says nothing; a view that was left out does."""
IN_A_ROW = 3
"""A view that contradicts the others' hull, though not their tangents, so many times is no accident."""
RESIDUAL_DRIFT_PX = 0.3
"""The median residual against the hull, now beside the first stones' of this calibration."""
ALONG_THE_FALL = 0.2
"""Tangent of the angle (11 degrees) between a shift and the fall up to which it may be one of time."""
REMEDY = "recalibrate (stonefall calibrate RECORDING --method stones, or drop the ball)"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraScore:
    """Of one camera, medians over the latest stones; `None` while too few have been seen."""

    tangency_px: float | None = None
    tangency_drift_px: float | None = None  # against the first stones since `restart`
    residual_px: float | None = None
    residual_drift_px: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspicion:
    """A camera that no longer is what its calibration says; `None` for most of them at once."""

    camera: CameraId | None
    score_px: float
    is_dropped: bool  # the latest stone was measured without it
    detail: str  # what happened to it, how much, and the remedy


@dataclass(slots=True)
class _Series:
    """One number a stone."""

    first: list[float] = field(default_factory=list)
    recent: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))

    def add(self, value: float) -> None:
        if len(self.first) < WINDOW:
            self.first.append(value)
        self.recent.append(value)

    @property
    def now(self) -> float | None:
        return median(self.recent) if len(self.recent) >= MIN_STONES else None

    @property
    def drift(self) -> float | None:
        return None if self.now is None else self.now - median(self.first)


@dataclass(slots=True)
class _Camera:
    calibration: CameraCalibration
    tangency: _Series = field(default_factory=_Series)
    residual: _Series = field(default_factory=_Series)
    shifts_px: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=MIN_STONES))
    latest_px: float | None = None  # score of the latest stone
    n_dropped: int = 0  # latest stones in a row that contradicted this view

    @property
    def is_dropped(self) -> bool:
        """Left out for more than a single odd silhouette."""
        is_beside = self.latest_px is not None and self.latest_px >= ALARM_PX
        return self.n_dropped >= (1 if is_beside else IN_A_ROW)

    @property
    def score_px(self) -> float | None:
        return self.latest_px if self.is_dropped else self.tangency.now

    @property
    def shift_px(self) -> tuple[float, float]:
        """Median over the latest few stones, none from before it moved; or that of the one it was left out of."""
        shifts = list(self.shifts_px)[-1 if self.is_dropped else 0 :] or [(0.0, 0.0)]
        return median(du for du, _ in shifts), median(dv for _, dv in shifts)


class RigWatch:
    """`feed` it the records of all stones, in the order of their triggers; `suspicions` are for people."""

    def __init__(self, rig: RigCalibration, fall: Fall = Fall()) -> None:  # noqa: B008 - frozen
        self._speed_mm_s = fall.speed_at_center_mm_s
        self.restart(rig)

    def restart(self, rig: RigCalibration) -> None:
        """Begin afresh with another calibration: scores belong to the one that they were measured with."""
        self._calibration_id = rig.calibration_id
        self._cameras = {camera.id: _Camera(camera) for camera in rig.cameras}

    def feed(self, record: Mapping[str, Any]) -> None:
        """Learn from one result; those of other calibrations, and those that compare no views, teach nothing."""
        scores_px = record.get("tangency_px")
        if not scores_px or record["calibration_id"] != self._calibration_id:
            return
        for name, camera in self._cameras.items():
            camera.latest_px = scores_px.get(name)
            if name in scores_px:  # it saw the stone whole
                camera.tangency.add(scores_px[name])
                camera.n_dropped = camera.n_dropped + 1 if name in record["dropped_views"] else 0
            if name in record["image_shifts_px"]:
                camera.shifts_px.append(tuple(record["image_shifts_px"][name]))
            if name in record["view_residuals_px"]:
                camera.residual.add(record["view_residuals_px"][name])

    def scores(self) -> dict[CameraId, CameraScore]:
        """Of every camera of the rig."""
        return {
            name: CameraScore(
                tangency_px=camera.tangency.now,
                tangency_drift_px=camera.tangency.drift,
                residual_px=camera.residual.now,
                residual_drift_px=camera.residual.drift,
            )
            for name, camera in self._cameras.items()
        }

    def suspicions(self) -> tuple[Suspicion, ...]:
        """Cameras that need somebody, worst first."""
        displaced = [
            Suspicion(
                camera=name,
                score_px=score_px,
                is_dropped=camera.is_dropped,
                detail=_what_happened(camera, score_px, self._speed_mm_s),
            )
            for name, camera in self._cameras.items()
            if (score_px := camera.score_px) is not None and (camera.is_dropped or score_px >= ALARM_PX)
        ]
        if 2 * len(displaced) > len(self._cameras):
            displaced = [_most(displaced, len(self._cameras))]
        differing = [
            Suspicion(
                camera=name,
                score_px=camera.residual.now or 0.0,
                is_dropped=False,
                detail=f"its silhouettes have come to leave the others' hull by {camera.residual.now:.1f} px,"
                f" {drift_px:.1f} px more than at first: clean its window, look at its light and focus",
            )
            for name, camera in self._cameras.items()
            if (drift_px := camera.residual.drift) is not None
            and drift_px >= RESIDUAL_DRIFT_PX
            and name not in {suspicion.camera for suspicion in displaced}
        ]
        return tuple(sorted([*displaced, *differing], key=lambda suspicion: -suspicion.score_px))


def _what_happened(camera: _Camera, score_px: float, speed_mm_s: float) -> str:
    """The shift that explains the tangents, as a turn, or as a time if it lies along the fall, and the remedy.

    A camera that is late sees the stone further down, and so does one that was tilted up: what the shift cannot
    tell apart is said to be either.
    """
    if score_px < ALARM_PX:
        return (
            f"contradicts the hull of the others, {camera.n_dropped} stones in a row:"
            " clean its window, look at its light and focus"
        )
    shift = np.array(camera.shift_px)
    shift_px, calibration = float(np.linalg.norm(shift)), camera.calibration
    if shift_px < score_px:
        return (
            f"its outlines miss the others' tangents by {score_px:.1f} px, though not by a shift:"
            f" turned about its line of sight, out of focus, or dirty: clean it, then {REMEDY}"
        )
    turn = f"turned by {np.rad2deg(shift_px / calibration.focal_px):.2f} degrees"
    (center_uv, below_uv), _ = calibration.project([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    fall_px_mm = float(np.linalg.norm(below_uv - center_uv))
    along_px, across_px = (
        np.array([below_uv - center_uv, (below_uv - center_uv)[::-1] * [-1, 1]]) @ shift / fall_px_mm
    )
    if abs(across_px) > ALONG_THE_FALL * abs(along_px):
        return (
            f"moved: it sees the stones {shift_px:.1f} px beside where the others do, as if {turn}: {REMEDY}"
        )
    off_us = 1e6 * along_px / fall_px_mm / speed_mm_s
    when = "late" if off_us > 0 else "early"
    return (
        f"exposes {abs(off_us):.0f} us {when}, or has {turn}:"
        f" it sees the stones {shift_px:.1f} px {'lower' if off_us > 0 else 'higher'} than the others do:"
        f" look at its trigger line and delay; if they are right, {REMEDY}"
    )


def _most(displaced: Sequence[Suspicion], n_cameras: int) -> Suspicion:
    """One alarm for most cameras at once: it is not them."""
    score_px = median(suspicion.score_px for suspicion in displaced)
    return Suspicion(
        camera=None,
        score_px=score_px,
        is_dropped=any(suspicion.is_dropped for suspicion in displaced),
        detail=f"{len(displaced)} of {n_cameras} cameras contradict one another, by {score_px:.1f} px: look at light"
        " and focus, then recalibrate with the ball",
    )
