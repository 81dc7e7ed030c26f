"""Verify the rig with a ball of a known diameter while the daemon runs."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Response
from pydantic import BaseModel, ConfigDict, Field

from service.api.auth import require
from service.api.context import Context
from service.api.problems import documented, found
from service.api.settings import Scope
from service.api.version import BASE
from service.calibration.verifications import Verification, VerificationPlan, VerificationState
from service.results.fields import TIME

router = APIRouter(prefix="/verifications", tags=["verifications"])

VerificationName = Annotated[str, Path(pattern=r"^[0-9]{4,9}$", description="`id` of a verification")]


class VerificationRequest(BaseModel):
    """What to verify with: the next balls that fall."""

    model_config = ConfigDict(extra="forbid")

    diameter_mm: float = Field(default=15.0, ge=1, le=50, description="Of the ball, mm")
    count: int = Field(default=5, ge=2, le=100, description="So many balls are measured")
    note: Annotated[str, Field(max_length=2000)] | None = None
    by: Annotated[str, Field(min_length=1, max_length=200)] | None = None


class VerifiedBallDocument(BaseModel):
    """One ball as it was measured."""

    bundle: str
    equivalent_diameter_mm: float | None = Field(description="Null when it was rejected")
    vertical_minus_horizontal_mm: float | None = Field(description="Of its diameter, mm")
    detail: str | None = Field(description="Why it was rejected")


class VerificationSummary(BaseModel):
    """Over the balls measured so far."""

    error_mm: float = Field(
        description="Mean of the equivalent diameter minus the true one, mm; limit 0.10 either way by default"
    )
    sd_mm: float = Field(description="Of the equivalent diameter, mm; limit 0.05 by default")
    vertical_minus_horizontal_mm: float | None = Field(
        description="Mean of the diameter, mm; limit 0.05 either way by default"
    )


class VerificationDocument(BaseModel):
    """A verification, under way or with its verdict."""

    id: str
    state: VerificationState
    diameter_mm: float = Field(description="Of the ball, as entered; mm")
    count: int = Field(description="Balls to measure; rejected ones do not count")
    calibration_id: str = Field(description="Calibration that is verified")
    created_at: str = Field(json_schema_extra=TIME)
    changed_at: str = Field(description="The last ball, or the end", json_schema_extra=TIME)
    by: str | None
    note: str | None
    summary: VerificationSummary | None = Field(description="Null before the first ball")
    balls: list[VerifiedBallDocument]
    problems: list[str] = Field(description="Why it failed or was cancelled, with the remedy")


class Verifications(BaseModel):
    """All verifications, newest first."""

    items: list[VerificationDocument]


@router.get(
    "", response_model=Verifications, dependencies=[Depends(require(Scope.READ))], responses=documented()
)
async def verifications(context: Context) -> dict[str, Any]:
    """All verifications, newest first."""
    return {"items": [_document(each) for each in context.control.calibrations.verifications.all()]}


@router.post(
    "",
    status_code=201,
    response_model=VerificationDocument,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=documented(409),
)
async def start_verification(
    context: Context, wanted: VerificationRequest, response: Response
) -> dict[str, Any]:
    """Measure the next balls with the calibration in use; ask for it again until there is a verdict.

    409 while somebody else waits for balls, or when none would be seen. On live cameras all that falls is a `ball`
    until then. A failed verification makes the rig *out of specification*, it does not stop it.
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
    responses=documented(404),
)
async def verification(context: Context, verification: VerificationName) -> dict[str, Any]:
    """How far a verification is, or its verdict."""
    known = context.control.calibrations.verifications.find(verification)
    return _document(found(known, "verification", verification))


@router.post(
    "/{verification}/cancel",
    response_model=VerificationDocument,
    dependencies=[Depends(require(Scope.OPERATE))],
    responses=documented(404),
)
async def cancel_verification(context: Context, verification: VerificationName) -> dict[str, Any]:
    """End a verification without a verdict; one that has ended stays as it is."""
    cancelled = await context.control.calibrations.verifications.cancel(verification, "somebody cancelled it")
    return _document(found(cancelled, "verification", verification))


def _document(verification: Verification) -> dict[str, Any]:
    summary = verification.summary
    return {**asdict(verification), "summary": None if summary is None else asdict(summary)}
