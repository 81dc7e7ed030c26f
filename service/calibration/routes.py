"""Routes of calibrations, to calibrate, choose and roll back while the daemon runs, and of verifications."""

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, Field

from pipeline.gradation.control_chart import (
    NELSON_RUN,
    SIGMAS,
    WESTERN_ELECTRIC,
    RuleName,
    baseline_of,
    control_chart,
)
from service.base.messages import Code, message
from service.base.schema import TIME, Name, RequestBody
from service.base.status import AcquisitionStatus
from service.calibration.calibrations import Calibrations
from service.calibration.drop_files import CalibrationDocument
from service.calibration.files import Activation, CalibrationSummary
from service.calibration.states import CalibrationAction, CalibrationRequest
from service.calibration.verification_limits import VerificationParameters
from service.calibration.verifications import Verification, VerificationRequest, VerificationState
from service.web.auth import CONFIGURABLE, OPERABLE, READABLE, Who, require
from service.web.context import ApiContext, Context
from service.web.problems import existing, problem_responses
from service.web.settings import Scope
from service.web.version import BASE

router = APIRouter(prefix="/calibrations", tags=["calibrations"])

CalibrationName = Annotated[str, Path(pattern=r"^[0-9]{4,9}$", description="`id` of a calibration")]


class Signature(RequestBody):
    """The person who decides."""

    by: Name | None = Field(default=None, description="Kept with the decision")


class CalibrationsAnswer(BaseModel):
    """All calibrations, newest first, and the history of activations."""

    active: Activation = Field(description="The one in use, since when and by whom")
    items: list[CalibrationSummary] = Field(description="Newest first")
    activations: list[Activation] = Field(description="All of them, newest first")


@router.get("", dependencies=READABLE)
async def calibrations(context: Context) -> CalibrationsAnswer:
    """List the calibrations, newest first, and the one in use."""
    known = context.part(Calibrations)
    return CalibrationsAnswer(
        active=known.activated,
        items=[known.summary(record) for record in known.all()],
        activations=list(known.activations),
    )


@router.post("", status_code=201, dependencies=OPERABLE)
async def start_calibration(
    context: Context, wanted: CalibrationRequest, response: Response, asking: Who
) -> CalibrationSummary:
    """Open a calibration: it collects drops. 409 while another calibration or verification is open.

    409 also when the rig cannot see drops (`held`, `disarming`, `stopping`). On live cameras everything that falls has
    the kind `ball` while a calibration is open, except with method `stones`: it is measured, but does not count as a
    stone. `accept`, `reject`, `cancel`, or ten minutes without a drop end it.
    """
    control = context.control
    known = control.part(Calibrations)
    record = await known.start(wanted, control.part(AcquisitionStatus).state)
    await context.store.note_change(asking, "calibration opened", record.id, after=asdict(record))
    response.headers["Location"] = f"{BASE}/calibrations/{record.id}"
    return known.summary(record)


@router.get("/{calibration}", dependencies=READABLE)
async def calibration(context: Context, calibration: CalibrationName) -> CalibrationDocument:
    """Get a calibration: its drops, their coverage and residuals, and its report."""
    return existing(await context.part(Calibrations).find(calibration), "calibration", calibration)


@router.get(
    "/{calibration}/rig.json",
    response_class=FileResponse,
    dependencies=READABLE,
    responses={200: {"content": {"application/json": {}}}},
)
async def calibration_rig(context: Context, calibration: CalibrationName) -> FileResponse:
    """Download the rig file of a calibration, with its checksum; 404 before it is solved."""
    rig_path = context.part(Calibrations).rig_path(calibration)
    path = existing(rig_path, "calibration", f"{calibration} with a rig")
    return FileResponse(path, media_type="application/json")


def _add_action(action: CalibrationAction, scope: Scope, text: str, status: int = 200) -> None:
    """Add the route of an action; `text` is its description in the OpenAPI document."""

    @router.post(
        f"/{{calibration}}/{action}",
        name=f"{action}_calibration",
        description=text,
        status_code=status,
        dependencies=[Depends(require(scope))],
        responses=problem_responses(404, 409),
    )
    async def act(
        context: Context, calibration: CalibrationName, asking: Who, signature: Signature | None = None
    ) -> CalibrationSummary:
        by = None if signature is None else signature.by
        before = _facts(context, calibration, action)
        known = context.part(Calibrations)
        found = existing(await known.act(calibration, action, by), "calibration", calibration)
        after = _facts(context, calibration, action)
        done = "activated" if action is CalibrationAction.ACTIVATE else found.state
        await context.store.note_change(
            asking, f"calibration {done}", calibration, before=before, after=after
        )
        return known.summary(found)


_add_action(
    CalibrationAction.SOLVE,
    Scope.OPERATE,
    "Solve a calibration from the drops so far, in a process of its own. Get it again until its state is `solved`, or"
    " `collecting` when that failed (see `detail`).",
    202,
)
_add_action(
    CalibrationAction.ACCEPT,
    Scope.CONFIGURE,
    "Accept a calibration: its solution is a version, which can be activated. 409 when its report forbids its use.",
)
_add_action(
    CalibrationAction.REJECT,
    Scope.OPERATE,
    "Reject a calibration: close a solved one without using it. Its record is kept.",
)
_add_action(
    CalibrationAction.CANCEL,
    Scope.OPERATE,
    "Cancel a calibration: close an open one in any state. Its record is kept.",
)
_add_action(
    CalibrationAction.ACTIVATE,
    Scope.CONFIGURE,
    "Activate a calibration: measure with it from the next stone on, without a pause. An older one rolls back.",
)


def _facts(context: ApiContext, name: str, action: CalibrationAction) -> dict[str, Any] | None:
    """Return the state that an action may change: the calibration in use, or the record of this one."""
    known = context.part(Calibrations)
    if action is CalibrationAction.ACTIVATE:
        return asdict(known.activated)
    return next((asdict(record) for record in known.all() if record.id == name), None)


verifying = APIRouter(prefix="/verifications", tags=["verifications"])

VerificationName = Annotated[str, Path(pattern=r"^[0-9]{4,9}$", description="`id` of a verification")]


class VoidVerificationRequest(RequestBody):
    """Why a verdict counts no more."""

    reason: str = Field(
        min_length=1,
        max_length=2000,
        description="Why the verdict counts no more; kept with the verification",
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


@verifying.get("", dependencies=READABLE)
async def verifications(context: Context) -> VerificationsAnswer:
    """List the verifications, newest first."""
    known = context.part(Calibrations).verifications
    return VerificationsAnswer(limits=known.parameters, items=known.all())


@verifying.post("", status_code=201, dependencies=OPERABLE)
async def start_verification(
    context: Context, wanted: VerificationRequest, response: Response, asking: Who
) -> Verification:
    """Begin a verification: measure the next balls with the calibration in use.

    Get it again until its state is `passed` or `failed`. 409 while another verification or a calibration is open, or
    when the rig cannot see drops (`held`, `disarming`, `stopping`). On live cameras everything that falls until the
    verdict has the kind `ball`. A failed verification puts the rig *out of specification*; it keeps measuring.
    """
    control = context.control
    verification = await control.part(Calibrations).verify(wanted, control.part(AcquisitionStatus).state)
    await context.store.note_change(
        asking, "verification begun", verification.id, after=_audited(verification)
    )
    response.headers["Location"] = f"{BASE}/verifications/{verification.id}"
    return verification


VERIFYING = (WESTERN_ELECTRIC[0], NELSON_RUN)
"""Rules of the chart of verifications."""


@verifying.get("/chart", response_model=ChartDocument, dependencies=READABLE)
async def verification_chart(
    context: Context,
    diameter_mm: Annotated[float, Query(gt=0, le=100, description="Of the ball")] = 15.0,
) -> dict[str, Any]:
    """Get the control chart of the verifications with a ball: centre, limits, and which are out of control."""
    series = context.part(Calibrations).verifications.series(diameter_mm)
    points = [(each, summary) for each in series if (summary := each.summary) is not None]
    errors_mm = [summary.error_mm for _, summary in points]
    baseline = baseline_of(errors_mm, centre=0.0)
    reach_mm = None if baseline is None else SIGMAS * baseline.sd
    found = () if baseline is None else control_chart(errors_mm, baseline, rules=VERIFYING).violations
    broken = {(each.place, each.rule) for each in found}
    return {
        "diameter_mm": diameter_mm,
        "centre_mm": 0.0,
        "lower_mm": None if reach_mm is None else -reach_mm,
        "upper_mm": reach_mm,
        "points": [
            {
                "verification": each.id,
                "at": each.changed_at,
                "state": each.state,
                "error_mm": summary.error_mm,
                "is_beyond_limits": (number, RuleName.BEYOND_LIMITS) in broken,
                "is_shifted": (number, RuleName.RUN) in broken,
            }
            for number, (each, summary) in enumerate(points)
        ],
    }


@verifying.get("/{verification}", dependencies=READABLE)
async def verification(context: Context, verification: VerificationName) -> Verification:
    """Get a verification."""
    known = context.part(Calibrations).verifications.find(verification)
    return existing(known, "verification", verification)


@verifying.post("/{verification}/cancel", dependencies=OPERABLE)
async def cancel_verification(context: Context, verification: VerificationName, asking: Who) -> Verification:
    """Cancel a verification: it ends without a verdict. One that has ended stays as it is."""
    known = context.part(Calibrations).verifications
    before = existing(known.find(verification), "verification", verification)
    after = existing(
        await known.cancel(verification, message(Code.CANCELLED_ON_REQUEST)), "verification", verification
    )
    await context.store.note_change(
        asking, "verification cancelled", verification, before=_audited(before), after=_audited(after)
    )
    return after


@verifying.post("/{verification}/void", dependencies=CONFIGURABLE)
async def void_verification(
    context: Context, verification: VerificationName, wanted: VoidVerificationRequest, asking: Who
) -> Verification:
    """Declare a verification void: its verdict counts no more, for health and results the one before does."""
    known = context.part(Calibrations).verifications
    before = existing(known.find(verification), "verification", verification)
    after = existing(await known.void(verification, wanted.reason), "verification", verification)
    await context.store.note_change(
        asking, "verification voided", verification, before=_audited(before), after=_audited(after)
    )
    return after


def _audited(verification: Verification) -> dict[str, Any]:
    """Return the facts about a verification that the audit keeps: all but its balls."""
    return {name: value for name, value in asdict(verification).items() if name != "balls"}


ROUTERS = (router, verifying)
