"""Schemas of calibrations in the REST interface."""

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from service.base.schema import TIME
from service.calibration.files import Origin
from service.calibration.plan import BALL_DIAMETERS_MM, Method
from service.calibration.states import CalibrationState

# strict: `true` is no number; a whole number is one of millimetres all the same
DiameterMm = Annotated[float, Field(ge=BALL_DIAMETERS_MM[0], le=BALL_DIAMETERS_MM[1], strict=True)]
Name = Annotated[str, Field(min_length=1, max_length=200)]


class CalibrationRequest(BaseModel):
    """Request for a calibration. Everything that falls from now on is observed."""

    model_config = ConfigDict(extra="forbid")

    ball_diameters_mm: list[DiameterMm] = Field(
        default=[],
        max_length=2,
        description="Diameter of the ball, mm. Two diameters that differ by a fifth or more also reveal outlines that"
        " are too large or too small. Empty with `stones`",
    )
    method: Method = Field(
        default=Method.BUNDLE,
        description="`bundle`: bundle adjustment of all cameras and balls; `paper`: Algorithm 1 of the paper; `stones`:"
        " new poses for cameras that moved, from any stones, without a ball",
    )
    note: Annotated[str, Field(max_length=2000)] | None = Field(default=None, description="Kept with it")
    by: Name | None = Field(default=None, description="Who calibrates")


class Signature(BaseModel):
    """The person who decides."""

    model_config = ConfigDict(extra="forbid")

    by: Name | None = Field(default=None, description="Kept with the decision")


class CalibrationSummary(BaseModel):
    """One calibration. It is open until it is accepted, rejected or cancelled; an accepted one is a version."""

    id: str = Field(description="Name of the calibration in the addresses")
    state: CalibrationState = Field(
        description="Its state: `collecting`, `solving` and `solved` are open, the others ended"
    )
    is_active: bool = Field(description="Whether stones are measured with it now")
    calibration_id: str | None = Field(
        description="Checksum of its rig file, which results name; null without a rig"
    )
    origin: Origin = Field(
        description="`configured`: from the rig file of the configuration; `session`: from drops"
    )
    method: str = Field(
        description="`bundle`, `paper` or `stones` as requested; of a configured rig file also `nominal` or `imported`"
    )
    ball_diameters_mm: list[float] = Field(description="As requested, mm")
    created_at: str = Field(description="When it was begun, RFC 3339 UTC", json_schema_extra=TIME)
    changed_at: str = Field(description="Latest change of its state", json_schema_extra=TIME)
    by: str | None = Field(description="Who began it")
    decided_by: str | None = Field(description="Who accepted, rejected or cancelled it")
    note: str | None = Field(description="Whatever was noted when it was begun; null for nothing")
    initial_calibration_id: str | None = Field(description="`calibration_id` in use when it was begun")
    detail: str | None = Field(
        description="Why it was cancelled, could not be solved, or must not be accepted; null otherwise"
    )


class ActivationDocument(BaseModel):
    """One activation of a calibration."""

    id: str = Field(description="`id` of the calibration")
    calibration_id: str = Field(description="Checksum of its rig file, which results name")
    at: str = Field(description="When it was activated, RFC 3339 UTC", json_schema_extra=TIME)
    by: str | None = Field(description="Who activated it; null: unknown")


class Calibrations(BaseModel):
    """All calibrations, newest first, and the history of activations."""

    active: ActivationDocument = Field(description="The one in use, since when and by whom")
    items: list[CalibrationSummary] = Field(description="Newest first")
    activations: list[ActivationDocument] = Field(description="All of them, newest first")


class Drop(BaseModel):
    """One ball or stone that was observed."""

    bundle: str = Field(description="Name of the bundle of images")
    diameter_mm: float | None = Field(
        description="Requested diameter that is closest to its apparent size, mm; null: a stone, or too few views"
    )
    views: list[str] = Field(description="Cameras whose image shows it whole")
    refused: dict[str, str] = Field(description="Cameras left out, each with the reason")
    center_mm: list[float] | None = Field(
        description="Centre of the ball in the frame of the rig, mm; null when it was not located"
    )
    residuals_px: dict[str, float] = Field(
        description="Per camera, px, with the calibration in use when it fell: centre of the ball against its position"
        " from all views; of a stone the median epipolar residual"
    )
    problem: str | None = Field(description="Why nothing was observed; null otherwise")


class CameraCoverageDocument(BaseModel):
    """Drops that one camera saw."""

    n_drops: int = Field(description="Drops that this camera saw whole")
    field_share: float = Field(description="Share of the image in which drops were seen, 0..1")


class CoverageGoalsDocument(BaseModel):
    """Coverage that suffices."""

    n_drops: int = Field(description="Drops located by two cameras or more")
    n_drops_per_camera: int = Field(description="Drops that each camera saw whole")
    reach_mm: float = Field(description="Reach of the centres of the drops in each direction, mm")


class CoverageDocument(BaseModel):
    """Distribution of the drops over the measuring volume and the images."""

    is_sufficient: bool = Field(description="Whether the drops suffice for a solution")
    missing: str | None = Field(description="What to drop next; null when nothing is missing")
    n_drops: int = Field(description="Drops located by two cameras or more")
    extent_mm: list[float] = Field(description="Extent of their centres along x, y, z; mm")
    spread_mm: list[float] = Field(
        description="Standard deviation of their centres along their principal axes, mm"
    )
    reaches_mm: dict[str, float] = Field(
        description="How far the centres reach from the middle of the rig, by direction: `+x`, `-x` ... `-z`; mm"
    )
    cameras: dict[str, CameraCoverageDocument] = Field(description="By camera")
    goals: CoverageGoalsDocument = Field(description="What `is_sufficient` asks for")


class CalibrationDocument(CalibrationSummary):
    """One calibration with its drops and its report."""

    drops: list[Drop] = Field(description="In the order in which they fell")
    coverage: CoverageDocument = Field(description="How well the drops so far cover volume and images")
    residuals_before_px: dict[str, float] = Field(
        description="Per camera, rms over the drops so far, with the calibration in use when they fell, px"
    )
    report: dict[str, Any] | None = Field(
        description="Result of the solution: residuals before and after (px), drops and views left out, centres of the"
        " balls (mm), f-number and focus of the lenses (mm) or why they do not show, uncertainty, problems; null before"
        " it is solved"
    )
