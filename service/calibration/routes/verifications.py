"""Verify the rig with a ball of known diameter while the daemon runs."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel, ConfigDict, Field

from pipeline.gradation.control_chart import control_chart
from service.base.schema import TIME
from service.calibration.calibrations import Calibrations
from service.calibration.verification_limits import VerificationParameters
from service.calibration.verifications import Verification, VerificationRequest, VerificationState
from service.web.auth import CONFIGURABLE, OPERABLE, READABLE, Who
from service.web.context import Context
from service.web.problems import existing
from service.web.version import BASE

router = APIRouter(prefix="/verifications", tags=["verifications"])

VerificationName = Annotated[str, Path(pattern=r"^[0-9]{4,9}$", description="`id` of a verification")]


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


class VerificationsAnswer(BaseModel):
    """All verifications, newest first, and what each must reach."""

    limits: VerificationParameters = Field(description="Section `[verification]` of the configuration")
    items: list[Verification] = Field(description="Newest first")


@router.get("", dependencies=READABLE)
async def verifications(context: Context) -> VerificationsAnswer:
    """List the verifications, newest first."""
    known = context.part(Calibrations).verifications
    return VerificationsAnswer(limits=known.parameters, items=known.all())


@router.post("", status_code=201, dependencies=OPERABLE)
async def start_verification(
    context: Context, wanted: VerificationRequest, response: Response, asking: Who
) -> Verification:
    """Begin a verification: measure the next balls with the calibration in use.

    Get it again until its state is `passed` or `failed`. 409 while another verification or a calibration is open, or
    when the rig cannot see drops (`held`, `disarming`, `stopping`). On live cameras everything that falls until the
    verdict has the kind `ball`. A failed verification puts the rig *out of specification*; it keeps measuring.
    """
    control = context.control
    verification = await control.part(Calibrations).verify(wanted, control.acquisition_status().state)
    await context.store.note_change(asking, "verification begun", verification.id, after=_facts(verification))
    response.headers["Location"] = f"{BASE}/verifications/{verification.id}"
    return verification


@router.get("/chart", response_model=ChartDocument, dependencies=READABLE)
async def verification_chart(
    context: Context,
    diameter_mm: Annotated[float, Query(gt=0, le=100, description="Of the ball")] = 15.0,
) -> dict[str, Any]:
    """Get the control chart of the verifications with a ball: centre, limits, and which are out of control."""
    series = context.part(Calibrations).verifications.series(diameter_mm)
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


@router.get("/{verification}", dependencies=READABLE)
async def verification(context: Context, verification: VerificationName) -> Verification:
    """Get a verification."""
    known = context.part(Calibrations).verifications.find(verification)
    return existing(known, "verification", verification)


@router.post("/{verification}/cancel", dependencies=OPERABLE)
async def cancel_verification(context: Context, verification: VerificationName, asking: Who) -> Verification:
    """Cancel a verification: it ends without a verdict. One that has ended stays as it is."""
    known = context.part(Calibrations).verifications
    before = existing(known.find(verification), "verification", verification)
    after = existing(await known.cancel(verification, "cancelled on request"), "verification", verification)
    await context.store.note_change(
        asking, "verification cancelled", verification, before=_facts(before), after=_facts(after)
    )
    return after


@router.post("/{verification}/void", dependencies=CONFIGURABLE)
async def void_verification(
    context: Context, verification: VerificationName, wanted: VoidVerificationRequest, asking: Who
) -> Verification:
    """Declare a verification void: its verdict counts no more, for health and results the one before does."""
    known = context.part(Calibrations).verifications
    before = existing(known.find(verification), "verification", verification)
    after = existing(await known.void(verification, wanted.reason), "verification", verification)
    await context.store.note_change(
        asking, "verification voided", verification, before=_facts(before), after=_facts(after)
    )
    return after


def _facts(verification: Verification) -> dict[str, Any]:
    """Return the facts about a verification that the audit keeps: all but its balls."""
    return {name: value for name, value in asdict(verification).items() if name != "balls"}
