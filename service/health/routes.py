"""Routes of health: liveness, readiness for stones, every check; alarms, acknowledged and shelved by people."""

from dataclasses import asdict, fields
from importlib.metadata import version
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query
from pydantic import BaseModel, Field

from service.base.language import Language
from service.base.messages import CodedFinding, in_language
from service.base.schema import RequestBody, served
from service.base.status import CheckStatus, Health, HealthCheck, Ne107
from service.health.alarms.alarm import ANNOUNCED, Alarm, AlarmState
from service.health.alarms.alarms import Alarms, history
from service.health.alarms.machine import MAX_SHELVED_S
from service.health.alarms.rules import Rules
from service.results.version import ALGORITHM_VERSION
from service.web.auth import OPERABLE, READABLE, Who
from service.web.context import Context
from service.web.feeds import MAX_SEQ
from service.web.problems import Problem, existing
from service.web.version import API_VERSION

router = APIRouter(prefix="/health", tags=["health"])

OVERALL_STATUS = {Ne107.GOOD: CheckStatus.PASS, Ne107.FAILURE: CheckStatus.FAIL}
"""Status of the whole device; a warning in all other states."""


class HealthDocument(BaseModel):
    """Health in detail, modelled on the expired Internet draft health+json."""

    status: CheckStatus = Field(
        description="In the words of health+json: `pass` for NE 107 good, `fail` for failure, else `warn`"
    )
    ne107: Ne107 = Field(description="Device state in the terms of NAMUR NE 107")
    gate_ne107: Ne107 = Field(description="The light gate alone; each camera has its own in `/cameras`")
    rig_ne107: Ne107 = Field(description="Geometry and optics of the rig: is all as it was calibrated")
    ready: bool = Field(description="Whether the next stone will be measured")
    reasons: list[str] = Field(description="Why it is not ready, or not `good`; empty when it is both")
    findings: list[CodedFinding] = Field(description="What the reasons say, as codes with their parameters")
    version: str = Field(description="As `api_version`, which says of what")
    release: str = Field(description="Version of the installed package")
    api_version: str = Field(description="Version of this interface, by semver")
    algorithm_version: str = Field(
        description="Version of the algorithm, as new results name it; raised whenever results may change"
    )
    instance_id: str = Field(description="Identity of the history of results, as in `/results`")
    checks: dict[str, HealthCheck] = Field(
        description="By name, such as `gate`, `cameras`, `camera:c01`, `calibration`, `disk`"
    )


class Live(BaseModel):
    """The process answers."""

    status: Literal["pass"] = Field(default="pass", description="Always `pass`: the process answers")


class Ready(BaseModel):
    """Stones can be measured."""

    ready: bool = Field(
        default=True, description="Always true; otherwise the answer is the problem `not-ready`"
    )


@router.get("/live", response_model=Live)
async def live() -> Live:
    """Check that the process answers; asks no other part and needs no key."""
    return Live()


@router.get("/ready", response_model=Ready)
async def ready(context: Context) -> Ready:
    """Check that stones can be measured: 200, otherwise 503 with the reasons. Needs no key."""
    health = context.part(Health)
    if not health.ready:
        detail = "; ".join(health.reasons) or "no reason given"
        raise Problem(503, "not-ready", detail, reasons=list(health.reasons))
    return Ready()


@router.get("", response_model=HealthDocument, dependencies=READABLE)
async def health(context: Context) -> dict[str, Any]:
    """Get the health: every check of cameras, gate, queue, workers, calibration, store, disk and more; always 200."""
    state = context.part(Health)
    return {
        **{each.name: getattr(state, each.name) for each in fields(state)},
        "status": OVERALL_STATUS.get(state.ne107, CheckStatus.WARN),
        "version": API_VERSION,
        "release": version("stonefall"),
        "api_version": API_VERSION,
        "algorithm_version": ALGORITHM_VERSION,
        "instance_id": context.store.instance_id,
    }


alarming = APIRouter(prefix="/alarms", tags=["alarms"])

Number = Annotated[int, Path(ge=1, le=MAX_SEQ, description="`id` of the alarm")]
Words = Annotated[Language, Query(description="Of `cause`, `action` and `said`")]
MAX_SHELVED_MINUTES = MAX_SHELVED_S / 60


@served
class AlarmDocument(Alarm):
    """An alarm, from its first rise to its end, with what it means and what to do."""

    cause: str
    """What the alarm means."""
    action: str
    """What to do."""
    said: str | None
    """What the check says, in the language that was asked for; `detail` is in English."""


class AlarmsDocument(BaseModel):
    """All alarms that have not ended, the most urgent first."""

    items: list[AlarmDocument] = Field(description="Unacknowledged, acknowledged and returned ones")
    shelved: list[AlarmDocument] = Field(description="Put aside by an operator for a time")
    suppressed: list[AlarmDocument] = Field(description="Caused by another alarm, which is the one to act on")


class AlarmHistory(BaseModel):
    """Alarms, newest first."""

    items: list[AlarmDocument] = Field(description="Newest first")
    next_before: int | None = Field(description="Pass as `before` for the next page; null on the last")


class ShelveRequest(RequestBody):
    """For how long an alarm is put aside, and why."""

    minutes: Annotated[float, Field(gt=0, le=MAX_SHELVED_MINUTES, description="A day at most")]
    reason: Annotated[str, Field(min_length=1, max_length=2000, description="Why it can wait")]


@alarming.get("", response_model=AlarmsDocument, dependencies=READABLE)
async def alarms(context: Context, language: Words = Language.ENGLISH) -> dict[str, Any]:
    """List the alarms: those that have not ended, each with its cause and what to do."""
    known = context.part(Alarms)
    lists = {"items": ANNOUNCED, "shelved": (AlarmState.SHELVED,), "suppressed": (AlarmState.SUPPRESSED,)}
    return {
        name: [_document(alarm, known.rules, language) for alarm in known.within(*states)]
        for name, states in lists.items()
    }


@alarming.get("/history", response_model=AlarmHistory, dependencies=READABLE)
async def alarm_history(
    context: Context,
    check: Annotated[str | None, Query(max_length=100, description="Of this check alone")] = None,
    before: Annotated[int, Query(ge=1, le=MAX_SEQ, description="`next_before` of the page before")] = MAX_SEQ,
    limit: Annotated[int, Query(ge=1, le=1000, description="Alarms of a page, at most")] = 100,
    language: Words = Language.ENGLISH,
) -> dict[str, Any]:
    """List the history of alarms, newest first; those that have not ended are in it."""
    found = await context.store.read(history, check, before, limit + 1)
    rules = context.part(Alarms).rules
    return {
        "items": [_document(alarm, rules, language) for alarm in found[:limit]],
        "next_before": found[limit - 1].id if len(found) > limit else None,
    }


@alarming.post("/{alarm}/acknowledge", response_model=AlarmDocument, dependencies=OPERABLE)
async def acknowledge_alarm(
    context: Context, alarm: Number, asking: Who, language: Words = Language.ENGLISH
) -> dict[str, Any]:
    """Acknowledge an alarm; one whose cause is gone ends by that. Repeating it changes nothing.

    409 `alarm-conflict` for one that is shelved or suppressed, 404 for one that has ended.
    """
    return _found(context, alarm, await context.part(Alarms).acknowledge(alarm, asking), language)


@alarming.post("/{alarm}/shelve", response_model=AlarmDocument, dependencies=OPERABLE)
async def shelve_alarm(
    context: Context, alarm: Number, wanted: ShelveRequest, asking: Who, language: Words = Language.ENGLISH
) -> dict[str, Any]:
    """Shelve an alarm: put it aside for a time, a day at most; if its cause is there afterwards it is raised again."""
    shelved = await context.part(Alarms).shelve(alarm, wanted.minutes, asking, wanted.reason)
    return _found(context, alarm, shelved, language)


@alarming.post("/{alarm}/unshelve", response_model=AlarmDocument, dependencies=OPERABLE)
async def unshelve_alarm(
    context: Context, alarm: Number, asking: Who, language: Words = Language.ENGLISH
) -> dict[str, Any]:
    """Unshelve an alarm before its time; 409 `alarm-conflict` for one that is not shelved."""
    return _found(context, alarm, await context.part(Alarms).unshelve(alarm, asking), language)


def _found(context: Context, number: int, alarm: Alarm | None, language: Language) -> dict[str, Any]:
    found = existing(alarm, "alarm", f"{number} that has not ended")
    return _document(found, context.part(Alarms).rules, language)


def _document(alarm: Alarm, rules: Rules, language: Language) -> dict[str, Any]:
    rule = rules.of(alarm.check)
    words = ("", "") if rule is None else (rule.cause[language], rule.action[language])
    said = alarm.detail
    if language is not Language.ENGLISH and alarm.findings:
        said = in_language(alarm.findings, language)
    return asdict(alarm) | {"cause": words[0], "action": words[1], "said": said}


ROUTERS = (router, alarming)
