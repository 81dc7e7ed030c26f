"""Calibrate the rig from balls while the daemon runs, choose which calibration is used, and roll back."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, Field

from service.api.auth import require
from service.api.context import ApiContext, Context
from service.api.problems import Problem, documented
from service.api.schemas import TIME
from service.api.settings import Scope
from service.api.version import BASE
from service.calibration_files import CalibrationRecord, Origin
from service.calibration_plan import CalibrationPlan
from service.calibration_states import CalibrationAction, CalibrationState
from service.calibrations import CalibrationDetails
from service.drop_job import Method

router = APIRouter(prefix="/calibrations", tags=["calibrations"])

CalibrationName = Annotated[str, Path(pattern=r"^[0-9]{4,9}$", description="`id` of a calibration")]
DiameterMm = Annotated[float, Field(ge=1, le=50)]
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
        default="bundle",
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


@router.get(
    "", response_model=Calibrations, dependencies=[Depends(require(Scope.READ))], responses=documented()
)
async def calibrations(context: Context) -> dict[str, Any]:
    """All calibrations, newest first, and which one is in use."""
    known = context.control.calibrations
    return {
        "active": asdict(known.activated),
        "items": [_summary(context, record) for record in known.all()],
        "activations": [asdict(each) for each in known.activations],
    }


@router.post(
    "",
    status_code=201,
    response_model=CalibrationSummary,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=documented(409),
)
async def start_calibration(
    context: Context, wanted: CalibrationRequest, response: Response
) -> dict[str, Any]:
    """Begin to collect drops; 409 while somebody else does, or when none would be seen.

    On live cameras all that falls is a `ball` until the session ends (but with `stones`): it is measured, but is no
    stone. It ends by `accept`, `reject` or `cancel`, or when nothing was seen for ten minutes.
    """
    plan = _valid_plan(wanted)
    control = context.control
    record = await control.calibrations.start(plan, control.acquisition().state)
    response.headers["Location"] = f"{BASE}/calibrations/{record.id}"
    return _summary(context, record)


@router.get(
    "/{calibration}",
    response_model=CalibrationDocument,
    dependencies=[Depends(require(Scope.READ))],
    responses=documented(404),
)
async def calibration(context: Context, calibration: CalibrationName) -> dict[str, Any]:
    """How far a session is: its drops, what they cover, what the calibration in use makes of them; the report."""
    details = await context.control.calibrations.find(calibration)
    if details is None:
        raise _unknown(calibration)
    return _document(context, details)


@router.get(
    "/{calibration}/rig.json",
    response_class=FileResponse,
    dependencies=[Depends(require(Scope.READ))],
    responses={200: {"content": {"application/json": {}}}, **documented(404)},
)
async def calibration_rig(context: Context, calibration: CalibrationName) -> FileResponse:
    """Its rig file, with the checksum; 404 before it is solved."""
    path = context.control.calibrations.rig_path(calibration)
    if path is None:
        raise Problem(404, "unknown-calibration", f"there is no calibration {calibration} with a rig")
    return FileResponse(path, media_type="application/json")


@router.post(
    "/{calibration}/solve",
    status_code=202,
    response_model=CalibrationSummary,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=documented(404, 409),
)
async def solve_calibration(
    context: Context, calibration: CalibrationName, signature: Signature | None = None
) -> dict[str, Any]:
    """Solve it from the drops so far, in a worker; ask for it again until it is `solved`, or `collecting` again."""
    return await _act(context, calibration, CalibrationAction.SOLVE, signature)


@router.post(
    "/{calibration}/accept",
    response_model=CalibrationSummary,
    dependencies=[Depends(require(Scope.CONFIGURE))],
    responses=documented(404, 409),
)
async def accept_calibration(
    context: Context, calibration: CalibrationName, signature: Signature | None = None
) -> dict[str, Any]:
    """Make a solution a version; 409 when its report forbids its use. It is used when it is activated."""
    return await _act(context, calibration, CalibrationAction.ACCEPT, signature)


@router.post(
    "/{calibration}/reject",
    response_model=CalibrationSummary,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=documented(404, 409),
)
async def reject_calibration(
    context: Context, calibration: CalibrationName, signature: Signature | None = None
) -> dict[str, Any]:
    """End a session without using its solution; the record stays."""
    return await _act(context, calibration, CalibrationAction.REJECT, signature)


@router.post(
    "/{calibration}/cancel",
    response_model=CalibrationSummary,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=documented(404, 409),
)
async def cancel_calibration(
    context: Context, calibration: CalibrationName, signature: Signature | None = None
) -> dict[str, Any]:
    """End a session whatever it has come to; the record stays."""
    return await _act(context, calibration, CalibrationAction.CANCEL, signature)


@router.post(
    "/{calibration}/activate",
    response_model=CalibrationSummary,
    dependencies=[Depends(require(Scope.CONFIGURE))],
    responses=documented(404, 409),
)
async def activate_calibration(
    context: Context, calibration: CalibrationName, signature: Signature | None = None
) -> dict[str, Any]:
    """Measure with it from the next stone on; with an older one this is the roll back. Nothing is interrupted."""
    return await _act(context, calibration, CalibrationAction.ACTIVATE, signature)


async def _act(
    context: ApiContext, name: str, action: CalibrationAction, signature: Signature | None
) -> dict[str, Any]:
    by = None if signature is None else signature.by
    record = await context.control.calibrations.act(name, action, by)
    if record is None:
        raise _unknown(name)
    return _summary(context, record)


def _valid_plan(wanted: CalibrationRequest) -> CalibrationPlan:
    members = wanted.model_dump()
    try:
        return CalibrationPlan(**members | {"ball_diameters_mm": tuple(wanted.ball_diameters_mm)})
    except ValueError as err:
        raise Problem(422, "invalid-request", str(err)) from err


def _summary(context: ApiContext, record: CalibrationRecord) -> dict[str, Any]:
    return {**asdict(record), "is_active": record.id == context.control.calibrations.active.id}


def _document(context: ApiContext, details: CalibrationDetails) -> dict[str, Any]:
    return {
        **_summary(context, details.record),
        "drops": [{**asdict(drop), "views": list(drop.views)} for drop in details.drops],
        "coverage": {**asdict(details.coverage), "is_sufficient": details.coverage.is_sufficient},
        "residuals_before_px": details.residuals_px,
        "report": None if details.report is None else _without_rig(details.report),
    }


def _without_rig(report: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in report.items() if name != "rig"}


def _unknown(name: str) -> Problem:
    return Problem(404, "unknown-calibration", f"there is no calibration {name}")
