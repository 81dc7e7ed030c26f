"""Watch the geometry of the rig by the results of its stones, and name the cameras that have moved.

Every result has a score for each camera, the epipolar residual of its outlines against those of the others
(`pipeline.views.epipolar_tangency`), and the residual of its outline against the hull of the others. A camera that was
hit raises the first at the next stones; dust and failing light raise the second, slowly.

Whether a view is dropped is decided for each stone alone, by the pipeline: it does not depend on which stones
came before, hence not on the number of workers. Only the alarm is kept here.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median

import numpy as np

from pipeline.fall import Fall
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.views.epipolar_tangency import ALARM_PX
from service.base.messages import Code, CodedText, message
from service.base.status import Checks, trouble_check
from service.health.findings import CameraFinding, Severity, described
from service.results.fields import Result

WINDOW = 20
"""Latest stones over which medians are taken."""
MIN_STONES = 5
"""Fewest stones with a meaningful median; a view that was dropped counts sooner."""
DISPLACED_IN_A_ROW, CONTRADICTING_IN_A_ROW = 2, 3
"""Stones in a row whose view contradicts the tangents of the others, or only their hull, before it is an alarm: before
a spot of the wall a piece of a stone may be taken for background, but hardly of the next one in the same view."""
RESIDUAL_DRIFT_PX = 0.3
"""Alarm limit of the rise of the median residual against the hull, compared with this calibration's first stones."""
SHARP_WIDTH_PX = 2.6
"""Width of a sharp outline, from 10 to 90 %: lens and pixels."""
MAX_TAN_TO_FALL = 0.2
"""Tangent of the angle (11 degrees) between a shift and the fall up to which a wrong time can explain the shift."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraScore:
    """Median scores of one camera over the latest stones; `None` while these are too few."""

    tangency_px: float | None = None
    tangency_drift_px: float | None = None  # against the first stones since `restart`
    residual_px: float | None = None
    residual_drift_px: float | None = None


@dataclass(slots=True)
class _Series:
    """The first and the latest values of a figure, one a stone."""

    first: list[float] = field(default_factory=list)
    latest: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))

    def add(self, value: float) -> None:
        if len(self.first) < WINDOW:
            self.first.append(value)
        self.latest.append(value)

    @property
    def recent_median(self) -> float | None:
        """Median of the latest values, None while they are too few."""
        return median(self.latest) if len(self.latest) >= MIN_STONES else None

    @property
    def drift(self) -> float | None:
        """Rise of the median since the first values."""
        return None if self.recent_median is None else self.recent_median - median(self.first)


@dataclass(slots=True)
class _Camera:
    calibration: CameraCalibration
    tangency: _Series = field(default_factory=_Series)
    blurs: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW))  # relative to a sharp outline's
    residual: _Series = field(default_factory=_Series)
    shifts_px: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=MIN_STONES))
    latest_px: float | None = None  # score of the latest stone
    n_dropped: int = 0  # latest stones in a row whose measurement dropped this view

    @property
    def alarm_px(self) -> float:
        """Score from which it has moved: outlines agree to a tenth of their blur, sharp ones to 0.1 px."""
        return ALARM_PX * max(1.0, median(self.blurs or [1.0]))

    @property
    def is_dropped(self) -> bool:
        """Whether its view was dropped for another reason than a single odd silhouette."""
        is_displaced = self.latest_px is not None and self.latest_px >= self.alarm_px
        return self.n_dropped >= (DISPLACED_IN_A_ROW if is_displaced else CONTRADICTING_IN_A_ROW)

    @property
    def score_px(self) -> float | None:
        return self.latest_px if self.is_dropped else self.tangency.recent_median

    @property
    def shift_px(self) -> tuple[float, float]:
        """Image shift (u, v): median over the latest few stones, or that of the stone it was dropped from."""
        shifts = list(self.shifts_px)[-1 if self.is_dropped else 0 :] or [(0.0, 0.0)]
        return median(du for du, _ in shifts), median(dv for _, dv in shifts)


class RigWatch:
    """Watches the cameras' geometry: `feed` it the records of all stones, in the order of their triggers."""

    def __init__(self, rig: RigCalibration, fall: Fall = Fall()) -> None:  # noqa: B008 - frozen
        self._speed_mm_s = fall.speed_at_center_mm_s
        self.restart(rig)

    def restart(self, rig: RigCalibration) -> None:
        """Start again with another calibration: scores are of the calibration that they were measured with."""
        self._calibration_id = rig.calibration_id
        self._cameras = {camera.id: _Camera(camera) for camera in rig.cameras}

    def feed(self, record: Result) -> None:
        """Take one result into account, unless it is of another calibration or compares no views."""
        scores_px = record.tangency_px
        if not scores_px or record.calibration_id != self._calibration_id:
            return
        widths_px = {name: seen.edge_width_px for name, seen in record.optics.items()}
        typical_px = median([width_px for width_px in widths_px.values() if width_px] or [SHARP_WIDTH_PX])
        for name, camera in self._cameras.items():
            # a sharp outline is compared with the others' blurred ones
            camera.blurs.append(max(typical_px, widths_px.get(name) or 0.0) / SHARP_WIDTH_PX)
            camera.latest_px = scores_px.get(name)
            if name in scores_px:  # it saw the stone whole
                camera.tangency.add(scores_px[name])
                camera.n_dropped = camera.n_dropped + 1 if name in record.dropped_views else 0
            if name in record.image_shifts_px:
                u_px, v_px = record.image_shifts_px[name]
                camera.shifts_px.append((u_px, v_px))
            if name in record.view_residuals_px:
                camera.residual.add(record.view_residuals_px[name])

    def scores(self) -> dict[CameraId, CameraScore]:
        """Return the scores of every camera of the rig."""
        return {
            name: CameraScore(
                tangency_px=camera.tangency.recent_median,
                tangency_drift_px=camera.tangency.drift,
                residual_px=camera.residual.recent_median,
                residual_drift_px=camera.residual.drift,
            )
            for name, camera in self._cameras.items()
        }

    def checks(self) -> Checks:
        """Check whether cameras still are where their calibration says, by the outlines of the stones."""
        findings = self.findings()
        scores_px = [px for score in self.scores().values() if (px := score.tangency_px) is not None]
        scores_px += [finding.score_px for finding in findings]
        worst_px = round(max(scores_px), 2) if scores_px else None
        return {"rig": trouble_check(described(findings, len(self._cameras)), worst_px, "px")}

    def findings(self) -> tuple[CameraFinding, ...]:
        """Return the cameras that contradict their calibration, worst first, for operators."""
        displaced = [
            CameraFinding(
                cameras=(name,),
                score_px=score_px,
                severity=Severity.OUT_OF_SPECIFICATION if camera.is_dropped else Severity.MAINTENANCE,
                detail=_describe_displacement(camera, score_px, self._speed_mm_s),
            )
            for name, camera in self._cameras.items()
            if (score_px := camera.score_px) is not None
            and (camera.is_dropped or score_px >= camera.alarm_px)
        ]
        if 2 * len(displaced) > len(self._cameras):
            displaced = [_in_common(displaced, len(self._cameras))]
        differing = [
            CameraFinding(
                cameras=(name,),
                score_px=camera.residual.recent_median or 0.0,
                severity=Severity.MAINTENANCE,
                detail=message(
                    Code.CAMERA_LEAVES_HULL,
                    residual_px=camera.residual.recent_median or 0.0,
                    drift_px=drift_px,
                ),
            )
            for name, camera in self._cameras.items()
            if (drift_px := camera.residual.drift) is not None
            and drift_px >= RESIDUAL_DRIFT_PX
            and not any(name in finding.cameras for finding in displaced)
        ]
        return tuple(sorted([*displaced, *differing], key=lambda finding: -finding.score_px))


def _describe_displacement(camera: _Camera, score_px: float, speed_mm_s: float) -> CodedText:
    """Describe the shift that explains the tangents, as a turn, or as a time if it lies along the fall.

    A camera that exposes late sees the stone further down, and so does one that was tilted up: where the shift cannot
    tell these apart both are named. The text ends with the remedy.
    """
    if score_px < camera.alarm_px:
        return message(Code.CAMERA_CONTRADICTS, stones=camera.n_dropped)
    shift = np.array(camera.shift_px)
    shift_px, calibration = float(np.linalg.norm(shift)), camera.calibration
    if shift_px < score_px:
        return message(Code.CAMERA_MISSES_TANGENTS, score_px=score_px)
    shift_figures = {"shift_px": shift_px, "turn_deg": float(np.rad2deg(shift_px / calibration.focal_px))}
    (center_uv, below_uv), _ = calibration.project([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    fall_px_mm = float(np.linalg.norm(below_uv - center_uv))
    along_px, across_px = (
        np.array([below_uv - center_uv, (below_uv - center_uv)[::-1] * [-1, 1]]) @ shift / fall_px_mm
    )
    if abs(across_px) > MAX_TAN_TO_FALL * abs(along_px):
        return message(Code.CAMERA_MOVED, **shift_figures)
    off_us = 1e6 * along_px / fall_px_mm / speed_mm_s
    code = Code.CAMERA_LATE if off_us > 0 else Code.CAMERA_EARLY
    return message(code, off_us=float(abs(off_us)), **shift_figures)


def _in_common(displaced: Sequence[CameraFinding], n_cameras: int) -> CameraFinding:
    """Return one finding for most cameras: what they have in common is more likely the cause than each of them."""
    score_px = median(finding.score_px for finding in displaced)
    return CameraFinding(
        cameras=(),
        score_px=score_px,
        severity=max(finding.severity for finding in displaced),
        detail=message(
            Code.CAMERAS_CONTRADICT, contradicting=len(displaced), cameras=n_cameras, score_px=score_px
        ),
    )
