"""Calibrate the rig while the daemon runs, choose which calibration is used, and roll back."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, Field

from pipeline.calibration.coverage import Coverage
from pipeline.frames import CameraId
from service.base.schema import Name, adds_to
from service.calibration.calibrations import Calibrations
from service.calibration.drop_files import ObservedDrop
from service.calibration.files import Activation, CalibrationRecord
from service.calibration.plan import CalibrationRequest
from service.calibration.states import CalibrationAction
from service.web.auth import OPERABLE, READABLE, Who, require
from service.web.context import ApiContext, Context
from service.web.problems import Problem, existing, problem_responses
from service.web.settings import Scope
from service.web.version import BASE

router = APIRouter(prefix="/calibrations", tags=["calibrations"])

DONE = {
    CalibrationAction.SOLVE: "solving",
    CalibrationAction.ACCEPT: "accepted",
    CalibrationAction.REJECT: "rejected",
    CalibrationAction.CANCEL: "cancelled",
    CalibrationAction.ACTIVATE: "activated",
}
"""Words of the audit."""

CalibrationName = Annotated[str, Path(pattern=r"^[0-9]{4,9}$", description="`id` of a calibration")]


class Signature(BaseModel):
    """The person who decides."""

    model_config = ConfigDict(extra="forbid")

    by: Name | None = Field(default=None, description="Kept with the decision")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationSummary(CalibrationRecord):
    """One calibration. It is open until it is accepted, rejected or cancelled; an accepted one is a version."""

    __pydantic_config__ = adds_to(CalibrationRecord)

    is_active: bool
    """True if stones are measured with it now."""


class CalibrationsAnswer(BaseModel):
    """All calibrations, newest first, and the history of activations."""

    active: Activation = Field(description="The one in use, since when and by whom")
    items: list[CalibrationSummary] = Field(description="Newest first")
    activations: list[Activation] = Field(description="All of them, newest first")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationDocument(CalibrationSummary):
    """One calibration with its drops and its report."""

    __pydantic_config__ = adds_to(CalibrationSummary)

    drops: Sequence[ObservedDrop]
    """In the order in which they fell."""
    coverage: Coverage
    """How well the drops so far cover volume and images."""
    residuals_before_px: Mapping[CameraId, float]
    """Per camera, rms over the drops so far, with the calibration in use when they fell, px."""
    report: Mapping[str, Any] | None
    """Result of the solution: residuals before and after (px), drops and views left out, centres of the balls (mm),
    f-number and focus of the lenses (mm) or why they do not show, uncertainty, problems; null before it is solved."""


@router.get("", dependencies=READABLE)
async def calibrations(context: Context) -> CalibrationsAnswer:
    """List the calibrations, newest first, and the one in use."""
    known = context.part(Calibrations)
    return CalibrationsAnswer(
        active=known.activated,
        items=[_summary(context, record) for record in known.all()],
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
    record = await control.part(Calibrations).start(wanted, control.acquisition_status().state)
    await context.store.note_change(asking, "calibration opened", record.id, after=asdict(record))
    response.headers["Location"] = f"{BASE}/calibrations/{record.id}"
    return _summary(context, record)


@router.get("/{calibration}", dependencies=READABLE)
async def calibration(context: Context, calibration: CalibrationName) -> CalibrationDocument:
    """Get a calibration: its drops, their coverage and residuals, and its report."""
    details = existing(await context.part(Calibrations).find(calibration), "calibration", calibration)
    return CalibrationDocument(
        **asdict(_summary(context, details.record)),
        drops=details.drops,
        coverage=details.coverage,
        residuals_before_px=details.residuals_px,
        report=details.report and {name: value for name, value in details.report.items() if name != "rig"},
    )


@router.get(
    "/{calibration}/rig.json",
    response_class=FileResponse,
    dependencies=READABLE,
    responses={200: {"content": {"application/json": {}}}},
)
async def calibration_rig(context: Context, calibration: CalibrationName) -> FileResponse:
    """Download the rig file of a calibration, with its checksum; 404 before it is solved."""
    path = context.part(Calibrations).rig_path(calibration)
    if path is None:
        raise Problem(404, "unknown-calibration", f"there is no calibration {calibration} with a rig")
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
        record = await context.part(Calibrations).act(calibration, action, by)
        found = existing(record, "calibration", calibration)
        after = _facts(context, calibration, action)
        await context.store.note_change(
            asking, f"calibration {DONE[action]}", calibration, before=before, after=after
        )
        return _summary(context, found)


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


def _summary(context: ApiContext, record: CalibrationRecord) -> CalibrationSummary:
    is_active = record.id == context.part(Calibrations).active.id
    return CalibrationSummary(**asdict(record), is_active=is_active)
