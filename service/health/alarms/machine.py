"""The states of all alarms: checks, requests and time in; changed alarms and events out.

    none --> unacknowledged <--> acknowledged --> none         `<--`: it became more urgent
                  |    ^
                  v    |  its cause is gone, and comes back
               returned --> none                               when it is acknowledged

From each of them to `shelved`, by request and for a time, and to `suppressed`, while a parent is active; from there
back to unacknowledged if the cause is there, else it ends. At most one alarm of a check has not ended.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from http import HTTPStatus
from typing import Any

from service.base.errors import ProblemError, ProblemKind
from service.base.messages import CodedFinding
from service.base.status import HealthCheck
from service.health.alarms.alarm import ACTIVE, ANNOUNCED, Alarm, AlarmState
from service.health.alarms.rules import Priority, Rule, Rules
from service.store.events import EventType

MAX_SHELVED_S = 24 * 3600.0


class AlarmConflictError(ProblemError):
    """The alarm's state does not allow what was asked for."""

    kinds = (ProblemKind("alarm-conflict", HTTPStatus.CONFLICT, "The alarm does not allow this now"),)


@dataclass(frozen=True, slots=True)
class Change:
    """An alarm as it is now, and what happened to it; without event if there is nothing to report."""

    alarm: Alarm
    event: EventType | None


@dataclass(slots=True)
class _Watched:
    """State of a check, its beginning, and whether it has lasted for the rule's delay."""

    rule: Rule
    is_active: bool = False
    is_bad: bool = False
    since_s: float = float("-inf")
    free_since_s: float | None = None  # of parents that suppress it
    priority: Priority | None = None
    detail: str | None = None
    findings: tuple[CodedFinding, ...] = ()

    def look(self, check: HealthCheck | None, now_s: float) -> None:
        self.priority = None if check is None else self.rule.priority(check.status)
        self.detail, self.findings = (None, ()) if check is None else (check.detail, check.findings)
        is_bad = self.priority is not None
        if is_bad != self.is_bad:
            self.is_bad, self.since_s = is_bad, now_s
        delay_s = self.rule.on_delay_s if is_bad else self.rule.off_delay_s
        if now_s - self.since_s >= delay_s:
            self.is_active = is_bad


class AlarmMachine:
    """All alarms that have not ended. Time is an argument: `now_s` is monotonic, `at` the same as RFC 3339."""

    def __init__(self, rules: Rules, alarms: Iterable[Alarm] = (), *, next_id: int = 1) -> None:
        """Go on with the alarms of an earlier run; the shelved ones of these are given to `resume_shelf`."""
        self._rules = rules
        self._next_id = next_id
        self._alarms = {alarm.check: alarm for alarm in alarms}
        self._shelf_ends_s: dict[str, float] = {}
        self._watched: dict[str, _Watched] = {}
        for alarm in self._alarms.values():
            watched = self._watch(alarm.check)
            if watched is not None and alarm.state in (*ACTIVE, AlarmState.SUPPRESSED):
                watched.is_active = watched.is_bad = True

    @property
    def alarms(self) -> list[Alarm]:
        """Return all that have not ended, the most urgent first, of these the newest."""
        newest_first = sorted(self._alarms.values(), key=lambda alarm: -alarm.id)
        return sorted(newest_first, key=lambda alarm: alarm.priority.rank)

    def resume_shelf(self, check: str, ends_s: float) -> None:
        """Set the end of the shelving of an alarm of an earlier run."""
        self._shelf_ends_s[check] = ends_s

    def update(self, checks: Mapping[str, HealthCheck], now_s: float, at: str) -> list[Change]:
        """Update the alarms by the present checks; one that is missing counts as passed."""
        for name in checks:
            self._watch(name)
        for name, watched in self._watched.items():
            watched.look(checks.get(name), now_s)
        unknown = [alarm for check, alarm in self._alarms.items() if check not in self._watched]
        changes = [
            self._keep(_ended(alarm, at)) for alarm in unknown
        ]  # an older version had a rule for these
        for name, watched in self._watched.items():
            is_suppressed = self._is_suppressed(watched)
            if is_suppressed or watched.free_since_s is None:
                watched.free_since_s = now_s
            before = self._alarms.get(name)
            change = self._next(name, watched, before, is_suppressed=is_suppressed, now_s=now_s, at=at)
            if change is not None:
                changes.append(self._keep(change))
            elif before is not None and before.state in ACTIVE and watched.priority is not None:
                self._alarms[name] = replace(before, detail=watched.detail, findings=watched.findings)
        return changes

    def acknowledge(self, number: int, who: str, at: str) -> Change | None:
        """Acknowledge an alarm; None if there is none of this number or it was acknowledged.

        Raises `AlarmConflictError` if it is shelved or suppressed.
        """
        alarm = self.find(number)
        if alarm is None or alarm.state is AlarmState.ACKNOWLEDGED:
            return None
        if alarm.state not in ANNOUNCED:
            raise AlarmConflictError(f"alarm {number} is {alarm.state}: there is nothing to acknowledge")
        is_over = alarm.state is AlarmState.RETURNED
        state = AlarmState.NORMAL if is_over else AlarmState.ACKNOWLEDGED
        seen = {"acknowledged_at": at, "acknowledged_by": who, "ended_at": at if is_over else None}
        return self._keep(_changed(alarm, state, EventType.ALARM_ACKNOWLEDGED, at, **seen))

    def shelve(
        self, number: int, who: str, reason: str, *, ends_s: float, until: str, at: str
    ) -> Change | None:
        """Put an alarm aside until `ends_s`, which is the time `until`; None if there is none of this number."""
        alarm = self.find(number)
        if alarm is None:
            return None
        self._shelf_ends_s[alarm.check] = ends_s
        shelf = {"shelved_until": until, "shelved_by": who, "shelf_reason": reason}
        return self._keep(_changed(alarm, AlarmState.SHELVED, EventType.ALARM_SHELVED, at, **shelf))

    def unshelve(self, number: int, now_s: float) -> Alarm | None:
        """Unshelve an alarm with the next `update` and return it; raise `AlarmConflictError` if it is not shelved."""
        if (alarm := self.find(number)) is not None:
            if alarm.state is not AlarmState.SHELVED:
                raise AlarmConflictError(f"alarm {number} is {alarm.state}, not shelved")
            self._shelf_ends_s[alarm.check] = now_s
        return alarm

    def find(self, number: int) -> Alarm | None:
        """Return the alarm of this number that has not ended, None if there is none."""
        return next((alarm for alarm in self._alarms.values() if alarm.id == number), None)

    def _watch(self, check: str) -> _Watched | None:
        rule = self._rules.of(check)
        return None if rule is None else self._watched.setdefault(check, _Watched(rule))

    def _is_suppressed(self, watched: _Watched) -> bool:
        """True when a parent that is at least as urgent is active."""
        own = watched.priority
        for name in watched.rule.parents:
            parent = self._watched.get(name)
            if parent is not None and (parent.is_bad or parent.is_active):
                known = self._alarms.get(name)
                priority = parent.priority or (None if known is None else known.priority)
                if own is None or priority is None or priority.rank <= own.rank:
                    return True
        return False

    def _next(
        self, name: str, watched: _Watched, alarm: Alarm | None, *, is_suppressed: bool, now_s: float, at: str
    ) -> Change | None:
        """Return the transition of an alarm, None if nothing changes."""
        is_active, priority = watched.is_active, watched.priority
        if alarm is None:
            if not is_active or priority is None:
                return None
            alarm = Alarm(
                id=self._next_id,
                check=name,
                state=AlarmState.SUPPRESSED if is_suppressed else AlarmState.UNACKNOWLEDGED,
                priority=priority,
                detail=watched.detail,
                findings=watched.findings,
                raised_at=at,
                changed_at=at,
            )
            self._next_id += 1
            return Change(alarm, None if is_suppressed else EventType.ALARM_RAISED)
        match alarm.state:
            case AlarmState.UNACKNOWLEDGED | AlarmState.ACKNOWLEDGED if is_suppressed:
                return _changed(alarm, AlarmState.SUPPRESSED, EventType.ALARM_CLEARED, at)
            case AlarmState.UNACKNOWLEDGED if not is_active:
                return _changed(alarm, AlarmState.RETURNED, EventType.ALARM_CLEARED, at, cleared_at=at)
            case AlarmState.ACKNOWLEDGED if not is_active:
                return _ended(alarm, at, EventType.ALARM_CLEARED)
            case AlarmState.UNACKNOWLEDGED | AlarmState.ACKNOWLEDGED:
                if priority is not None and priority.rank < alarm.priority.rank:
                    return _raised(alarm, watched, at)
            case AlarmState.RETURNED if is_active:
                if is_suppressed:
                    return _changed(alarm, AlarmState.SUPPRESSED, None, at)
                return _raised(alarm, watched, at, occurrences=alarm.occurrences + 1)
            case AlarmState.SUPPRESSED if not is_suppressed:
                if not is_active:
                    return _ended(alarm, at)
                if now_s - (watched.free_since_s or now_s) >= watched.rule.on_delay_s:
                    return _raised(alarm, watched, at)
            case AlarmState.SHELVED if now_s >= self._shelf_ends_s.get(name, now_s):
                if not is_active:
                    return _ended(alarm, at, EventType.ALARM_CLEARED)
                if is_suppressed:
                    return _changed(alarm, AlarmState.SUPPRESSED, EventType.ALARM_CLEARED, at)
                return _raised(alarm, watched, at)
        return None

    def _keep(self, change: Change) -> Change:
        alarm = change.alarm
        if alarm.state is not AlarmState.SHELVED:
            self._shelf_ends_s.pop(alarm.check, None)
        if alarm.state is AlarmState.NORMAL:
            del self._alarms[alarm.check]
        else:
            self._alarms[alarm.check] = alarm
        return change


def _changed(alarm: Alarm, state: AlarmState, event: EventType | None, at: str, **more: Any) -> Change:
    return Change(replace(alarm, **{"state": state, "changed_at": at, "shelved_until": None, **more}), event)


def _raised(alarm: Alarm, watched: _Watched, at: str, **more: Any) -> Change:
    """Re-raise as unacknowledged and clear the acknowledgement."""
    known = [alarm.priority] if watched.priority is None else [alarm.priority, watched.priority]
    return _changed(
        alarm,
        AlarmState.UNACKNOWLEDGED,
        EventType.ALARM_RAISED,
        at,
        priority=min(known, key=lambda each: each.rank),
        detail=watched.detail or alarm.detail,
        findings=watched.findings or alarm.findings,
        acknowledged_at=None,
        acknowledged_by=None,
        **more,
    )


def _ended(alarm: Alarm, at: str, event: EventType | None = None) -> Change:
    return _changed(alarm, AlarmState.NORMAL, event, at, cleared_at=at, ended_at=at)
