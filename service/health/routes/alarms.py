"""Alarms: conditions that need an operator, with the remedy; acknowledged and shelved by people."""

from dataclasses import asdict, dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query
from pydantic import BaseModel, ConfigDict, Field

from service.base.language import Language
from service.base.schema import adds_to
from service.health.alarms.alarm import ANNOUNCED, Alarm, AlarmState
from service.health.alarms.alarms import Alarms
from service.health.alarms.machine import MAX_SHELVED_S
from service.health.alarms.rules import Rules
from service.health.alarms.table import history
from service.web.auth import OPERABLE, READABLE, Who
from service.web.context import Context
from service.web.feeds import MAX_SEQ
from service.web.problems import existing

router = APIRouter(prefix="/alarms", tags=["alarms"])

Number = Annotated[int, Path(ge=1, le=MAX_SEQ, description="`id` of the alarm")]
Words = Annotated[Language, Query(description="Of `cause` and `action`")]
MAX_SHELVED_MINUTES = MAX_SHELVED_S / 60


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmDocument(Alarm):
    """An alarm, from its first rise to its end, with what it means and what to do."""

    __pydantic_config__ = adds_to(Alarm)

    cause: str
    """What the alarm means."""
    action: str
    """What to do."""


class AlarmsDocument(BaseModel):
    """All alarms that have not ended, the most urgent first."""

    items: list[AlarmDocument] = Field(description="Unacknowledged, acknowledged and returned ones")
    shelved: list[AlarmDocument] = Field(description="Put aside by an operator for a time")
    suppressed: list[AlarmDocument] = Field(description="Caused by another alarm, which is the one to act on")


class AlarmHistory(BaseModel):
    """Alarms, newest first."""

    items: list[AlarmDocument] = Field(description="Newest first")
    next_before: int | None = Field(description="Pass as `before` for the next page; null on the last")


class ShelveRequest(BaseModel):
    """For how long an alarm is put aside, and why."""

    model_config = ConfigDict(extra="forbid")

    minutes: Annotated[float, Field(gt=0, le=MAX_SHELVED_MINUTES, description="A day at most")]
    reason: Annotated[str, Field(min_length=1, max_length=2000, description="Why it can wait")]


@router.get("", response_model=AlarmsDocument, dependencies=READABLE)
async def alarms(context: Context, language: Words = Language.ENGLISH) -> dict[str, Any]:
    """List the alarms: those that have not ended, each with its cause and what to do."""
    known = context.part(Alarms)
    lists = {"items": ANNOUNCED, "shelved": (AlarmState.SHELVED,), "suppressed": (AlarmState.SUPPRESSED,)}
    return {
        name: [_document(alarm, known.rules, language) for alarm in known.within(*states)]
        for name, states in lists.items()
    }


@router.get("/history", response_model=AlarmHistory, dependencies=READABLE)
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


@router.post("/{alarm}/acknowledge", response_model=AlarmDocument, dependencies=OPERABLE)
async def acknowledge_alarm(
    context: Context, alarm: Number, asking: Who, language: Words = Language.ENGLISH
) -> dict[str, Any]:
    """Acknowledge an alarm; one whose cause is gone ends by that. Repeating it changes nothing.

    409 `alarm-conflict` for one that is shelved or suppressed, 404 for one that has ended.
    """
    return _found(context, alarm, await context.part(Alarms).acknowledge(alarm, asking), language)


@router.post("/{alarm}/shelve", response_model=AlarmDocument, dependencies=OPERABLE)
async def shelve_alarm(
    context: Context, alarm: Number, wanted: ShelveRequest, asking: Who, language: Words = Language.ENGLISH
) -> dict[str, Any]:
    """Shelve an alarm: put it aside for a time, a day at most; if its cause is there afterwards it is raised again."""
    shelved = await context.part(Alarms).shelve(alarm, wanted.minutes, asking, wanted.reason)
    return _found(context, alarm, shelved, language)


@router.post("/{alarm}/unshelve", response_model=AlarmDocument, dependencies=OPERABLE)
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
    return asdict(alarm) | {"cause": words[0], "action": words[1]}
