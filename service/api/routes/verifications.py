"""Verify the rig with a ball of known diameter while the daemon runs."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Response
from pydantic import BaseModel, ConfigDict, Field

from service.api.auth import require
from service.api.context import Context
from service.api.problems import existing, problem_responses
from service.api.routes.calibration_schemas import DiameterMm
from service.api.settings import Scope
from service.api.version import BASE
from service.calibration.verifications import Verification, VerificationPlan, VerificationState
from service.results.fields import TIME

router = APIRouter(prefix="/verifications", tags=["verifications"])

VerificationName = Annotated[str, Path(pattern=r"^[0-9]{4,9}$", description="`id` of a verification")]


class VerificationRequest(BaseModel):
    """Request for a verification with the next balls."""

    model_config = ConfigDict(extra="forbid")

    diameter_mm: DiameterMm = Field(default=15.0, description="Diameter of the ball, mm")
    count: int = Field(default=5, ge=2, le=100, strict=True, description="Number of drops to measure")
    note: Annotated[str, Field(max_length=2000)] | None = None
    by: Annotated[str, Field(min_length=1, max_length=200)] | None = None


class VerifiedBallDocument(BaseModel):
    """One ball of a verification."""

    bundle: str
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

    id: str
    state: VerificationState
    diameter_mm: float = Field(description="Diameter of the ball as requested, mm")
    count: int = Field(
        description="Number of drops to measure; rejected ones and those of another size do not count"
    )
    calibration_id: str = Field(description="`calibration_id` of the calibration that is verified")
    created_at: str = Field(json_schema_extra=TIME)
    changed_at: str = Field(description="The latest ball, or the end", json_schema_extra=TIME)
    by: str | None
    note: str | None
    summary: VerificationSummary | None = Field(description="Null before the first ball")
    balls: list[VerifiedBallDocument]
    problems: list[str] = Field(description="Why it failed or was cancelled, with the remedy")


class Verifications(BaseModel):
    """All verifications, newest first."""

    items: list[VerificationDocument]


@router.get(
    "",
    response_model=Verifications,
    dependencies=[Depends(require(Scope.READ))],
    responses=problem_responses(),
)
async def verifications(context: Context) -> dict[str, Any]:
    """Return all verifications, newest first."""
    return {"items": [_document(each) for each in context.control.calibrations.verifications.all()]}


@router.post(
    "",
    status_code=201,
    response_model=VerificationDocument,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(409),
)
async def start_verification(
    context: Context, wanted: VerificationRequest, response: Response
) -> dict[str, Any]:
    """Measure the next balls with the calibration in use. Get it again until its state is `passed` or `failed`.

    409 while another verification or a calibration is open, or when the rig cannot see drops (`held`,
    `disarming`, `stopping`). On live cameras everything that falls until the verdict has the kind `ball`. A failed
    verification puts the rig *out of specification*; it keeps measuring.
    """
    control = context.control
    plan = VerificationPlan(**wanted.model_dump())
    verification = await control.calibrations.verify(plan, control.acquisition_status().state)
    response.headers["Location"] = f"{BASE}/verifications/{verification.id}"
    return _document(verification)


@router.get(
    "/{verification}",
    response_model=VerificationDocument,
    dependencies=[Depends(require(Scope.READ))],
    responses=problem_responses(404),
)
async def verification(context: Context, verification: VerificationName) -> dict[str, Any]:
    """Return one verification."""
    known = context.control.calibrations.verifications.find(verification)
    return _document(existing(known, "verification", verification))


@router.post(
    "/{verification}/cancel",
    response_model=VerificationDocument,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=problem_responses(404),
)
async def cancel_verification(context: Context, verification: VerificationName) -> dict[str, Any]:
    """Cancel a verification: it ends without a verdict. One that has ended stays as it is."""
    cancelled = await context.control.calibrations.verifications.cancel(verification, "cancelled on request")
    return _document(existing(cancelled, "verification", verification))


def _document(verification: Verification) -> dict[str, Any]:
    summary = verification.summary
    return {**asdict(verification), "summary": None if summary is None else asdict(summary)}
