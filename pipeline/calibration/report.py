"""What a calibration found, and how far it can be trusted."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from pipeline.errors import Problem
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration, rig_to_document


class ScaleSource(StrEnum):
    """Where a rig's scale comes from. The word is part of the REST contract and of the report files."""

    BALL_DIAMETER = "ball_diameter"
    NOT_OBSERVABLE = "not_observable"
    """The drops do not tell it: lengths are those of the initial rig."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A number and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraUncertainty:
    """Standard deviations of one camera's parameters in the rig's own frame, the largest of their components."""

    rotation_deg: float
    center_mm: float
    focal_percent: float
    principal_point_px: float
    k1: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Uncertainty:
    """Predicted from the normal equations at the solution."""

    cameras: Mapping[CameraId, CameraUncertainty]
    length_sd_percent: float  # of a length in the measuring volume; the tolerance of the ball is part of it
    observation_px: float  # sd of a ball's centre in one view, as the residuals show it


@dataclass(frozen=True, slots=True, kw_only=True)
class Fall:
    """Direction in which the balls fall, in the frame of the initial rig."""

    direction: tuple[float, float, float]  # unit
    speed_mm_s: float
    sd_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationReport:
    """A calibrated rig with the evidence for it.

    A *residual* is the distance in px, in the image, between the centre of a ball as its outline shows it (the
    axis of the cone of viewing rays that touch it) and the projection of its fitted place; rms over the drops.
    """

    rig: RigCalibration
    initial: RigCalibration
    drops_used: tuple[str, ...]
    drops_left_out: Mapping[str, str]  # with the reason
    views_left_out: Mapping[str, Mapping[CameraId, str]]  # of the drops, with the reason
    residuals_before_px: Mapping[CameraId, float]
    residuals_after_px: Mapping[CameraId, float]
    held_out_px: float | None  # rms residual of drops that were not used in the fit
    scale: ScaleSource
    edge_offset_px: float | None  # how much too large outlines are; known from balls of two sizes only
    ball_centers_mm: Mapping[str, tuple[float, float, float]]
    distance_factor: Estimate  # of all cameras' distances from the origin against the initial rig
    focal_factor: Estimate  # of all focal lengths
    fall: Fall | None  # `None`: the drops do not show it, the vertical is the initial rig's
    uncertainty: Uncertainty | None  # the paper's method has none
    problems: tuple[Problem, ...] = ()

    @property
    def is_acceptable(self) -> bool:
        """Whether no problem is fatal."""
        return not any(problem.is_fatal for problem in self.problems)


def report_document(report: CalibrationReport) -> dict[str, Any]:
    """The report as JSON-ready values."""
    document = {
        name: getattr(report, name)
        for name in (
            "held_out_px", "scale", "edge_offset_px", "residuals_before_px", "residuals_after_px",
            "drops_left_out", "views_left_out", "ball_centers_mm", "is_acceptable",
        )
    }  # fmt: skip
    return {
        "method": report.rig.method,
        "calibration_id": report.rig.calibration_id,
        "initial_calibration_id": report.initial.calibration_id,
        "ball_diameter_mm": report.rig.ball_diameter_mm,
        "drops_used": list(report.drops_used),
        **document,
        "distance_factor": asdict(report.distance_factor),
        "focal_factor": asdict(report.focal_factor),
        "fall": None if report.fall is None else asdict(report.fall),
        "uncertainty": None if report.uncertainty is None else asdict(report.uncertainty),
        "problems": [asdict(problem) for problem in report.problems],
        "rig": rig_to_document(report.rig),
    }
