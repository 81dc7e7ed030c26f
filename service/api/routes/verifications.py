"""Verify the rig with a ball of known diameter while the daemon runs."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from pipeline.gradation.control_chart import control_chart
from service.api.auth import Who, require
from service.api.context import Context
from service.api.problems import existing, problem_responses
from service.api.routes.calibration_schemas import DiameterMm
from service.api.settings import Scope
from service.api.version import BASE
from service.base.schema import TIME
from service.calibration.verifications import Verification, VerificationPlan, VerificationState

router = APIRouter(prefix="/verifications", tags=["verifications"])

VerificationName = Annotated[str, Path(pattern=r"^[0-9]{4,9}$", description="`id` of a verification")]


class VerificationRequest(BaseModel):
    """Request for a verification with the next balls."""

    model_config = ConfigDict(extra="forbid")

    diameter_mm: DiameterMm = Field(default=15.0, description="Diameter of the ball, mm")
    count: int = Field(default=5, ge=2, le=100, strict=True, description="Number of drops to measure")
    note: Annotated[str, Field(max_length=2000)] | None = Field(
        default=None, description="Whatever is to be kept with it"
    )
    by: Annotated[str, Field(min_length=1, max_length=200)] | None = Field(
        default=None, description="Who verifies"
    )


class VerifiedBallDocument(BaseModel):
    """One ball of a verification."""

    bundle: str = Field(description="Name of the bundle of images")
    equivalent_diameter_mm: float | None = Field(
        description="Diameter of the sphere of equal volume, mm; null when rejected, or far from the stated one"
    )
    vertical_minus_horizontal_mm: float | None = Field(
        description="Vertical minus horizontal diameter, mm; null: unknown"
    )
    detail: str | None = Field(description="Why it does not count; null when it does")


class VerificationSummary(BaseModel):
    """Averages over the balls measured so far; the limits are those of `[verification]` in the configuration."""

    error_mm: float = Field(
        description="Mean of the equivalent diameters minus the true one, mm; default limit 0.10 either way"
    )
    sd_mm: float = Field(description="Standard deviation of the equivalent diameters, mm; default limit 0.05")
    vertical_minus_horizontal_mm: float | None = Field(
        description="Mean of vertical minus horizontal diameter, mm; default limit 0.05 either way"
    )


class VerificationDocument(BaseModel):
    """A verification: its balls, and its verdict once they are complete."""

    id: str = Field(description="Name of the verification in the addresses")
    state: VerificationState = Field(description="How far it is, or its verdict")
    diameter_mm: float = Field(description="Diameter of the ball as requested, mm")
    count: int = Field(
        description="Number of drops to measure; rejected ones and those of another size do not count"
    )
    calibration_id: str = Field(description="`calibration_id` of the calibration that is verified")
    created_at: str = Field(description="When it was begun, RFC 3339 UTC", json_schema_extra=TIME)
    changed_at: str = Field(description="The latest ball, or the end", json_schema_extra=TIME)
    by: str | None = Field(description="Who verifies; null: unknown")
    note: str | None = Field(description="As it was given")
    summary: VerificationSummary | None = Field(description="Null before the first ball")
    balls: list[VerifiedBallDocument] = Field(description="In the order in which they fell")
    problems: list[str] = Field(description="Why it failed or was cancelled, with the remedy")


class VoidVerificationRequest(BaseModel):
    """Why a verdict counts no more."""

    model_config = ConfigDict(extra="forbid")

    reason: Annotated[str, Field(min_length=1, max_length=2000)] = Field(
        description="Why the verdict counts no more; kept with the verification"
    )


class ChartPoint(BaseModel):
    """One verification of the chart."""

    verification: str = Field(description="`id` of the verification")
    at: str = Field(description="When it ended, RFC 3339 UTC", json_schema_extra=TIME)
    state: VerificationState = Field(description="Its verdict")
    error_mm: float = Field(description="Mean of the equivalent diameters minus the true one")
    is_beyond_limits: bool = Field(description="Further than three standard deviations from the centre")
    is_shifted: bool = Field(description="The ninth in a row on one side of the centre, or one after it")


class ChartDocument(BaseModel):
    """Control chart of the verifications with one ball, ISO 7870-2: void ones are left out."""

    diameter_mm: float = Field(description="True diameter of the ball, mm")
    centre_mm: float = Field(description="Centre line: mean error, mm")
    lower_mm: float | None = Field(description="Null with fewer than 8 verifications")
    upper_mm: float | None = Field(
        description="Upper limit, three standard deviations above the centre, mm; null with fewer than 8"
    )
    points: list[ChartPoint] = Field(description="Oldest first")


class VerificationLimits(BaseModel):
    """What a verification must reach, as configured."""

    every_h: float = Field(description="A verification is overdue so long after the latest, hours; 0: never")
    error_mm: float = Field(description="Limit of the mean error, either way, mm")
    sd_mm: float = Field(description="Limit of the standard deviation, mm")
    vertical_minus_horizontal_mm: float = Field(
        description="Limit of vertical minus horizontal diameter, either way, mm"
    )


class Verifications(BaseModel):
    """All verifications, newest first, and what each must reach."""

    limits: VerificationLimits = Field(description="Section `[verification]` of the configuration")
    items: list[VerificationDocument] = Field(description="Newest first")


@router.get(
    "",
    response_model=Verifications,
    dependencies=[Depends(require(Scope.READ))],
)
async def verifications(context: Context) -> dict[str, Any]:
    """List the verifications, newest first."""
    known = context.control.calibrations.verifications
    return {"limits": asdict(known.parameters), "items": [_document(each) for each in known.all()]}


@router.post(
    "",
    status_code=201,
    response_model=VerificationDocument,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(409),
)
async def start_verification(
    context: Context, wanted: VerificationRequest, response: Response, asking: Who
) -> dict[str, Any]:
    """Begin a verification: measure the next balls with the calibration in use.

    Get it again until its state is `passed` or `failed`. 409 while another verification or a calibration is open, or
    when the rig cannot see drops (`held`, `disarming`, `stopping`). On live cameras everything that falls until the
    verdict has the kind `ball`. A failed verification puts the rig *out of specification*; it keeps measuring.
    """
    control = context.control
    plan = VerificationPlan(**wanted.model_dump())
    verification = await control.calibrations.verify(plan, control.acquisition_status().state)
    await context.store.note_change(asking, "verification begun", verification.id, after=_facts(verification))
    response.headers["Location"] = f"{BASE}/verifications/{verification.id}"
    return _document(verification)


@router.get(
    "/chart",
    response_model=ChartDocument,
    dependencies=[Depends(require(Scope.READ))],
)
async def verification_chart(
    context: Context,
    diameter_mm: Annotated[float, Query(gt=0, le=100, description="Of the ball")] = 15.0,
) -> dict[str, Any]:
    """Get the control chart of the verifications with a ball: centre, limits, and which are out of control."""
    series = context.control.calibrations.verifications.series(diameter_mm)
    points = [(each, summary) for each in series if (summary := each.summary) is not None]
    found = control_chart([summary.error_mm for _, summary in points], centre=0.0) if points else None
    return {
        "diameter_mm": diameter_mm,
        "centre_mm": 0.0,
        "lower_mm": found and found.lower,
        "upper_mm": found and found.upper,
        "points": [
            {
                "verification": each.id,
                "at": each.changed_at,
                "state": each.state,
                "error_mm": summary.error_mm,
                "is_beyond_limits": found is not None and number in found.beyond_limits,
                "is_shifted": found is not None and number in found.shifted,
            }
            for number, (each, summary) in enumerate(points)
        ],
    }


@router.get(
    "/{verification}",
    response_model=VerificationDocument,
    dependencies=[Depends(require(Scope.READ))],
    responses=problem_responses(404),
)
async def verification(context: Context, verification: VerificationName) -> dict[str, Any]:
    """Get a verification."""
    known = context.control.calibrations.verifications.find(verification)
    return _document(existing(known, "verification", verification))


@router.post(
    "/{verification}/cancel",
    response_model=VerificationDocument,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(404),
)
async def cancel_verification(
    context: Context, verification: VerificationName, asking: Who
) -> dict[str, Any]:
    """Cancel a verification: it ends without a verdict. One that has ended stays as it is."""
    known = context.control.calibrations.verifications
    before = existing(known.find(verification), "verification", verification)
    after = existing(await known.cancel(verification, "cancelled on request"), "verification", verification)
    await context.store.note_change(
        asking, "verification cancelled", verification, before=_facts(before), after=_facts(after)
    )
    return _document(after)


@router.post(
    "/{verification}/void",
    response_model=VerificationDocument,
    dependencies=[Depends(require(Scope.CONFIGURE))],
    responses=problem_responses(404),
)
async def void_verification(
    context: Context, verification: VerificationName, wanted: VoidVerificationRequest, asking: Who
) -> dict[str, Any]:
    """Declare a verification void: its verdict counts no more, for health and results the one before does."""
    known = context.control.calibrations.verifications
    before = existing(known.find(verification), "verification", verification)
    after = existing(await known.void(verification, wanted.reason), "verification", verification)
    await context.store.note_change(
        asking, "verification voided", verification, before=_facts(before), after=_facts(after)
    )
    return _document(after)


def _facts(verification: Verification) -> dict[str, Any]:
    """Return what the audit is to know of a verification: all but its balls."""
    return {name: value for name, value in asdict(verification).items() if name != "balls"}


def _document(verification: Verification) -> dict[str, Any]:
    summary = verification.summary
    return {**asdict(verification), "summary": None if summary is None else asdict(summary)}
