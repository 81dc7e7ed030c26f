"""Result of a calibration, with the evidence for its accuracy."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from pipeline.errors import CalibrationProblem
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration, rig_to_document


class ScaleSource(StrEnum):
    """Where a rig's scale comes from. The word is part of the REST contract and of the report files."""

    BALL_DIAMETER = "ball_diameter"
    NOT_OBSERVABLE = "not_observable"
    """The drops do not tell it: lengths are those of the initial rig."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NumberWithSd:
    """A number and its standard deviation."""

    value: float
    sd: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraUncertainty:
    """Standard deviations of one camera's parameters in the rig's own frame; of vectors the largest component."""

    rotation_deg: float
    center_mm: float
    focal_percent: float
    principal_point_px: float
    k1: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictedUncertainty:
    """Uncertainty predicted from the normal equations at the solution."""

    cameras: Mapping[CameraId, CameraUncertainty]
    length_sd_percent: float  # of a length in the measuring volume, including the tolerance of the ball
    observation_px: float  # standard deviation of a ball's centre in one view, from the residuals


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundFall:
    """Direction and speed of the balls' fall, in the frame of the initial rig."""

    direction: tuple[float, float, float]  # unit vector
    speed_mm_s: float
    sd_deg: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundLenses:
    """Aperture and focus of the lenses."""

    focal_length_mm: float  # on the barrel; it only turns the aperture, which images show, into an f-number
    f_number: NumberWithSd
    blur_px: NumberWithSd  # sigma of an edge in focus
    focus_mm: Mapping[CameraId, NumberWithSd]  # depth of the plane in focus, where the balls show it


class UnseenLenses(StrEnum):
    """Why the balls do not show the lenses. The word is part of the REST contract and of the report files."""

    NO_WIDTHS = "no_widths"
    """The widths of edges were not measured, or in too few views."""
    STOPPED_DOWN = "stopped_down"
    """Edges are equally wide at all depths: the aperture is too small to matter."""
    LITTLE_DEPTH = "little_depth"
    """The balls fell in too thin a layer, or too few of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationReport:
    """A calibrated rig with the evidence for it.

    A *residual* is the rms over the drops of the reprojection error in px: the distance between the centre of a ball as
    its outline shows it (the axis of the cone of viewing rays that touch it) and the projection of its fitted centre.
    """

    rig: RigCalibration
    initial: RigCalibration
    drops_used: tuple[str, ...]
    drops_left_out: Mapping[str, str]  # with the reason
    views_left_out: Mapping[str, Mapping[CameraId, str]]  # of the drops, with the reason
    residuals_before_px: Mapping[CameraId, float]
    residuals_after_px: Mapping[CameraId, float]
    held_out_px: float | None  # residual of drops that were held out of the fit
    scale: ScaleSource
    edge_offset_px: float | None  # by how much outlines are too large; found with balls of two sizes only
    ball_centers_mm: Mapping[str, tuple[float, float, float]]
    distance_factor: NumberWithSd  # mean ratio of the cameras' distances from the origin to the initial ones
    focal_factor: NumberWithSd  # mean ratio of the focal lengths to the initial ones
    lenses: FoundLenses | UnseenLenses | None  # `None`: the paper's method does not look for them
    fall: FoundFall | None  # `None`: the drops do not determine it, the vertical is the initial rig's
    uncertainty: PredictedUncertainty | None  # `None` of the paper's method
    problems: tuple[CalibrationProblem, ...] = ()

    @property
    def is_acceptable(self) -> bool:
        """Whether no problem is fatal."""
        return not any(problem.is_fatal for problem in self.problems)


def report_document(report: CalibrationReport) -> dict[str, Any]:
    """Return the report as JSON-ready values."""
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
        "lenses": asdict(report.lenses) if isinstance(report.lenses, FoundLenses) else None,
        "lenses_unseen": report.lenses if isinstance(report.lenses, UnseenLenses) else None,
        "fall": None if report.fall is None else asdict(report.fall),
        "uncertainty": None if report.uncertainty is None else asdict(report.uncertainty),
        "problems": [asdict(problem) for problem in report.problems],
        "rig": rig_to_document(report.rig),
    }
