"""What the REST interface says of calibrations."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from service.calibration.files import Origin
from service.calibration.plan import BALL_DIAMETERS_MM, Method
from service.calibration.states import CalibrationState
from service.results.fields import TIME

DiameterMm = Annotated[float, Field(ge=BALL_DIAMETERS_MM[0], le=BALL_DIAMETERS_MM[1])]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class CalibrationRequest(BaseModel):
    """What to calibrate with; all that falls from now on is observed."""

    model_config = ConfigDict(extra="forbid")

    ball_diameters_mm: list[DiameterMm] = Field(
        default=[],
        max_length=2,
        description="One ball, or two that differ by a fifth or more: then outlines that are too large or too small"
        " are found out as well; mm",
    )
    method: Method = Field(
        default=Method.BUNDLE,
        description="`bundle`: all cameras and balls together; `paper`: its Algorithm 1; `stones`: puts cameras that"
        " moved back in place, from the stones that fall anyway, without any ball",
    )
    note: Annotated[str, Field(max_length=2000)] | None = None
    by: Name | None = Field(default=None, description="Who calibrates")


class Signature(BaseModel):
    """Who decides."""

    model_config = ConfigDict(extra="forbid")

    by: Name | None = None


class CalibrationSummary(BaseModel):
    """One calibration: a session while it is open, a version once it is accepted."""

    id: str
    state: CalibrationState
    is_active: bool = Field(description="Whether stones are measured with it now")
    calibration_id: str | None = Field(
        description="Checksum of its rig file, as results name it; null without a rig"
    )
    origin: Origin = Field(description="`configured`: the rig file of the configuration")
    method: str = Field(
        description="Of a configured rig file `nominal`, `imported`, `paper` or `bundle`; of a session as asked for"
    )
    ball_diameters_mm: list[float] = Field(description="As entered, mm")
    created_at: str = Field(json_schema_extra=TIME)
    changed_at: str = Field(description="Of its state", json_schema_extra=TIME)
    by: str | None = Field(description="Who began it")
    decided_by: str | None = Field(description="Who accepted, rejected or cancelled it")
    note: str | None
    initial_calibration_id: str | None = Field(description="Calibration in use when it was begun")
    detail: str | None = Field(
        description="Why it was cancelled, could not be solved, or must not be accepted"
    )


class ActivationDocument(BaseModel):
    """One choice of the calibration in use."""

    id: str
    calibration_id: str
    at: str = Field(json_schema_extra=TIME)
    by: str | None


class Calibrations(BaseModel):
    """All sessions and versions, newest first, and what was used when."""

    active: ActivationDocument = Field(description="In use, since when and by whom")
    items: list[CalibrationSummary]
    activations: list[ActivationDocument] = Field(description="All choices, newest first")


class Drop(BaseModel):
    """One ball of a session, or one stone."""

    bundle: str
    diameter_mm: float | None = Field(
        description="Of the balls that were entered, the one it can only be; mm"
    )
    views: list[str] = Field(description="Cameras that show it whole")
    refused: dict[str, str] = Field(description="Views left out, each with the reason")
    center_mm: list[float] | None = Field(description="Where it was, world frame, mm")
    residuals_px: dict[str, float] = Field(
        description="With the calibration it was measured with, px: a ball's centre in each view against all views"
        " together; a stone's median epipolar residual"
    )
    problem: str | None = Field(description="Why nothing was observed")


class CameraCoverageDocument(BaseModel):
    """What one camera saw of the drops."""

    n_drops: int
    field_share: float = Field(description="Of its image that showed a drop, 0..1")


class CoverageDocument(BaseModel):
    """How the drops fill the measuring volume and the images."""

    is_sufficient: bool
    missing: str | None = Field(description="What to drop next")
    n_drops: int = Field(description="Located, by two cameras or more")
    extent_mm: list[float] = Field(description="Of their centres along x, y, z; mm")
    spread_mm: list[float] = Field(description="Sd of their centres along their principal axes, mm")
    cameras: dict[str, CameraCoverageDocument]


class CalibrationDocument(CalibrationSummary):
    """All that is known of one calibration."""

    drops: list[Drop] = Field(description="In the order in which they fell")
    coverage: CoverageDocument
    residuals_before_px: dict[str, float] = Field(
        description="Per camera over the drops so far, with the calibration in use when they fell; rms, px"
    )
    report: dict[str, Any] | None = Field(
        description="What the solution found, null before: residuals in px before and after, drops and views left"
        " out, centres of the balls in mm, uncertainty, problems"
    )
