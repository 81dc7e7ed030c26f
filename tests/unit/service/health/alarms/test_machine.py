"""The states of alarms by hand, and whatever checks and people do."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.base.status import CheckStatus, HealthCheck
from service.health.alarms.alarm import ACTIVE, ANNOUNCED, Alarm, AlarmState
from service.health.alarms.machine import MAX_SHELVED_S, AlarmConflictError, AlarmMachine, Change
from service.health.alarms.rules import Priority, Rule, Rules
from service.store.events import EventType

AT = "2026-11-21T04:00:00.000Z"
WORDS = {"en": "look", "de": "schauen"}
PASS, WARN, FAIL = CheckStatus.PASS, CheckStatus.WARN, CheckStatus.FAIL
PARENT = Rule(fail=Priority.URGENT, on_delay_s=2, off_delay_s=5, cause=WORDS, action=WORDS)
CHILD = replace(
    PARENT, warn=Priority.LOW, fail=Priority.MEDIUM, on_delay_s=10, off_delay_s=10, parents=("cameras",)
)
RULES = Rules({"cameras": PARENT, "camera": CHILD, "disk": replace(CHILD, parents=())}, {"archive": "no"})
RAISED, CLEARED = EventType.ALARM_RAISED, EventType.ALARM_CLEARED
ACKNOWLEDGED, SHELVED = EventType.ALARM_ACKNOWLEDGED, EventType.ALARM_SHELVED


class Bench:
    """A machine whose time and checks a test sets."""

    def __init__(self, machine: AlarmMachine | None = None) -> None:
        self.machine = machine or AlarmMachine(RULES)
        self.now_s = 1000.0
        self.checks: dict[str, HealthCheck] = {}
        self.changes: list[Change] = []

    def set(self, name: str, status: CheckStatus, detail: str | None = None) -> None:
        self.checks[name] = HealthCheck(status=status, detail=detail)

    def after(self, seconds: float, step_s: float = 1.0) -> None:
        """Let time pass, looking at the checks every second."""
        end_s = self.now_s + seconds
        self.look()
        while self.now_s < end_s:
            self.now_s = min(self.now_s + step_s, end_s)
            self.look()

    def look(self) -> None:
        self.changes += self.machine.update(self.checks, self.now_s, AT)

    def keep(self, change: Change | None) -> None:
        if change is not None:
            self.changes.append(change)

    def acknowledge(self, number: int) -> None:
        self.keep(self.machine.acknowledge(number, "anna", AT))

    def shelve(self, number: int, minutes: float) -> None:
        ends_s = self.now_s + 60 * minutes
        self.keep(self.machine.shelve(number, "anna", "known", ends_s=ends_s, until=AT, at=AT))

    @property
    def states(self) -> dict[str, AlarmState]:
        return {alarm.check: alarm.state for alarm in self.machine.alarms}

    @property
    def events(self) -> list[tuple[str, EventType]]:
        return [(change.alarm.check, change.event) for change in self.changes if change.event]

    @property
    def only(self) -> Alarm:
        (alarm,) = self.machine.alarms
        return alarm


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_raised_acknowledged_and_gone(bench: Bench):
    bench.set("disk", FAIL, "0.1 GB free")
    bench.after(9)
    assert not bench.machine.alarms
    bench.after(1)
    assert (bench.only.state, bench.only.priority, bench.only.detail) == (
        AlarmState.UNACKNOWLEDGED,
        Priority.MEDIUM,
        "0.1 GB free",
    )
    bench.acknowledge(1)
    bench.acknowledge(1)
    assert (bench.only.state, bench.only.acknowledged_by) == (AlarmState.ACKNOWLEDGED, "anna")
    bench.set("disk", PASS)
    bench.after(9)
    assert bench.states
    bench.after(1)
    assert not bench.states
    assert [event for _, event in bench.events] == [RAISED, ACKNOWLEDGED, CLEARED]
    ended = bench.changes[-1].alarm
    assert (ended.state, ended.ended_at, ended.id) == (AlarmState.NORMAL, AT, 1)
    assert bench.machine.acknowledge(1, "anna", AT) is None


def test_what_nobody_has_seen_stays_until_somebody_has(bench: Bench):
    bench.set("disk", FAIL)
    bench.after(10)
    bench.set("disk", PASS)
    bench.after(3600, step_s=60)
    assert bench.only.state is AlarmState.RETURNED
    bench.set("disk", FAIL)
    bench.after(10)
    assert (bench.only.state, bench.only.occurrences, bench.only.id) == (AlarmState.UNACKNOWLEDGED, 2, 1)
    bench.set("disk", PASS)
    bench.after(10)
    bench.acknowledge(1)
    assert not bench.states
    assert [event for _, event in bench.events] == [RAISED, CLEARED, RAISED, CLEARED, ACKNOWLEDGED]


def test_chattering_below_the_delays_is_nothing(bench: Bench):
    for _ in range(100):
        bench.set("disk", FAIL)
        bench.after(9)
        bench.set("disk", PASS)
        bench.after(9)
    assert not bench.changes
    bench.set("disk", FAIL)
    bench.after(10)
    for _ in range(100):
        bench.set("disk", PASS)
        bench.after(9)
        bench.set("disk", FAIL)
        bench.after(9)
    assert bench.events == [("disk", RAISED)]


def test_what_becomes_worse_calls_again_and_what_becomes_better_does_not(bench: Bench):
    bench.set("disk", WARN)
    bench.after(10)
    bench.acknowledge(1)
    bench.set("disk", FAIL)
    bench.after(0)
    assert (bench.only.state, bench.only.priority) == (AlarmState.UNACKNOWLEDGED, Priority.MEDIUM)
    assert (bench.only.acknowledged_by, bench.only.acknowledged_at) == (None, None)
    bench.acknowledge(1)
    bench.set("disk", WARN)
    bench.after(60)
    assert (bench.only.state, bench.only.priority) == (AlarmState.ACKNOWLEDGED, Priority.MEDIUM)
    assert [event for _, event in bench.events] == [RAISED, ACKNOWLEDGED, RAISED, ACKNOWLEDGED]


def test_a_dead_switch_is_one_alarm_and_not_sixteen(bench: Bench):
    cameras = [f"camera:c{number:02d}" for number in range(1, 17)]
    for camera in cameras:  # one after the other is found to be silent
        bench.set(camera, FAIL)
        bench.after(0.3)
    bench.set("cameras", FAIL, "all 16 cameras are gone: look at the switch")
    bench.after(600)
    assert bench.events == [("cameras", RAISED)]
    assert bench.states == {"cameras": AlarmState.UNACKNOWLEDGED} | dict.fromkeys(
        cameras, AlarmState.SUPPRESSED
    )
    bench.set("cameras", PASS)
    for camera in cameras[1:]:
        bench.set(camera, PASS)
    bench.after(5)
    assert bench.states["camera:c01"] is AlarmState.SUPPRESSED
    bench.after(10)
    assert bench.events[1:] == [("cameras", CLEARED), ("camera:c01", RAISED)]
    assert bench.states == {"cameras": AlarmState.RETURNED, "camera:c01": AlarmState.UNACKNOWLEDGED}


def test_a_parent_that_comes_later_takes_over_and_a_lesser_one_does_not(bench: Bench):
    bench.set("camera:c01", FAIL)
    bench.after(10)
    bench.set("cameras", FAIL)
    bench.after(2)
    assert bench.events == [("camera:c01", RAISED), ("camera:c01", CLEARED), ("cameras", RAISED)]
    lesser = replace(PARENT, fail=Priority.LOW)
    bench = Bench(AlarmMachine(replace(RULES, by_check={**RULES.by_check, "cameras": lesser})))
    bench.set("cameras", FAIL)
    bench.set("camera:c01", FAIL)
    bench.after(10)
    assert set(bench.states.values()) == {AlarmState.UNACKNOWLEDGED}


@pytest.mark.parametrize("is_there", [True, False])
def test_a_shelf_ends(bench: Bench, is_there: bool):
    bench.set("disk", FAIL)
    bench.after(10)
    bench.shelve(1, minutes=5)
    with pytest.raises(AlarmConflictError, match="alarm 1 is shelved"):
        bench.acknowledge(1)
    bench.after(100)
    if not is_there:
        bench.set("disk", PASS)
    bench.after(199)
    assert bench.only.state is AlarmState.SHELVED
    bench.after(1)
    assert bench.events[-1] == ("disk", RAISED if is_there else CLEARED)
    assert bench.states == ({"disk": AlarmState.UNACKNOWLEDGED} if is_there else {})


def test_a_shelf_can_be_ended(bench: Bench):
    bench.set("disk", FAIL)
    bench.after(10)
    with pytest.raises(AlarmConflictError, match="not shelved"):
        bench.machine.unshelve(1, bench.now_s)
    bench.shelve(1, minutes=5)
    assert bench.machine.unshelve(1, bench.now_s) is not None
    bench.after(0)
    assert [event for _, event in bench.events] == [RAISED, SHELVED, RAISED]
    assert bench.machine.unshelve(7, bench.now_s) is None


def test_a_restart_goes_on_with_all_of_them(bench: Bench):
    bench.set("disk", FAIL)
    bench.set("camera:c01", WARN)
    bench.set("camera:c02", FAIL)
    bench.after(10)
    bench.acknowledge(next(alarm.id for alarm in bench.machine.alarms if alarm.check == "disk"))
    (low,) = (alarm for alarm in bench.machine.alarms if alarm.priority is Priority.LOW)
    bench.shelve(low.id, minutes=1)
    again = Bench(AlarmMachine(RULES, bench.machine.alarms, next_id=4))
    again.machine.resume_shelf("camera:c01", again.now_s + 30)
    again.checks = bench.checks
    again.after(29)
    assert not again.changes
    assert again.states == bench.states
    again.after(1)
    assert again.events == [("camera:c01", RAISED)]
    again.checks = {}
    again.after(20)
    assert [alarm.state for alarm in again.machine.alarms] == [AlarmState.RETURNED] * 2


def test_an_alarm_of_a_check_without_rule_ends(bench: Bench):
    bench.set("disk", FAIL)
    bench.set("archive", WARN)
    bench.set("unheard-of", FAIL)
    bench.after(10)
    assert set(bench.states) == {"disk"}
    later = Bench(AlarmMachine(Rules({}, {}), bench.machine.alarms, next_id=2))
    later.after(0)
    assert not later.states
    assert later.changes[0].alarm.state is AlarmState.NORMAL


CHECK_NAMES = ("cameras", "camera:c01", "camera:c02", "disk")
STEPS = st.one_of(
    st.tuples(st.just("set"), st.sampled_from(CHECK_NAMES), st.sampled_from(list(CheckStatus))),
    st.tuples(st.just("wait"), st.sampled_from([0.0, 1.0, 3.0, 7.0, 15.0, 90.0]), st.none()),
    st.tuples(st.just("acknowledge"), st.integers(0, 3), st.none()),
    st.tuples(st.just("shelve"), st.integers(0, 3), st.sampled_from([0.1, 1.0])),
    st.tuples(st.just("unshelve"), st.integers(0, 3), st.none()),
    st.tuples(st.just("restart"), st.none(), st.none()),
)


@given(st.lists(STEPS, max_size=60))
def test_whatever_happens_no_alarm_is_lost_or_doubled(steps: list[tuple[str, object, object]]):
    bench = Bench()
    for what, first, second in steps:
        alarms = bench.machine.alarms
        chosen = alarms[first % len(alarms)] if isinstance(first, int) and alarms else None
        match what:
            case "set":
                bench.set(first, second)  # type: ignore[arg-type]
                bench.after(0)
            case "wait":
                bench.after(first)  # type: ignore[arg-type]
            case "acknowledge" if chosen is not None and chosen.state in ANNOUNCED:
                bench.acknowledge(chosen.id)
            case "acknowledge" if chosen is not None:
                with pytest.raises(AlarmConflictError):
                    bench.acknowledge(chosen.id)
            case "shelve" if chosen is not None:
                bench.shelve(chosen.id, second)  # type: ignore[arg-type]
            case "unshelve" if chosen is not None and chosen.state is AlarmState.SHELVED:
                bench.machine.unshelve(chosen.id, bench.now_s)
                bench.after(0)
            case "restart":
                n_ids = 1 + max((change.alarm.id for change in bench.changes), default=0)
                bench.machine = AlarmMachine(RULES, alarms, next_id=n_ids)
                for alarm in alarms:
                    if alarm.state is AlarmState.SHELVED:
                        bench.machine.resume_shelf(alarm.check, bench.now_s + 6)
        require_order(bench)
    # in the end everything that is wrong is there, and all else is gone once it has been seen
    bench.after(2 * MAX_SHELVED_S, step_s=1800)
    bench.after(60)
    bad = {name for name, check in bench.checks.items() if RULES.of(name).priority(check.status)}  # type: ignore[union-attr]
    shown = {alarm.check for alarm in bench.machine.alarms if alarm.state in (*ACTIVE, AlarmState.SUPPRESSED)}
    assert shown == bad
    for alarm in bench.machine.alarms:
        is_child = bool(RULES.of(alarm.check).parents)  # type: ignore[union-attr]
        if alarm.state in ANNOUNCED:
            bench.acknowledge(alarm.id)
            assert not (is_child and "cameras" in bad)
    assert {alarm.check for alarm in bench.machine.alarms} == bad
    require_order(bench)


def require_order(bench: Bench) -> None:
    """Fail unless each alarm has one life, and its events make sense."""
    assert len(bench.states) == len(bench.machine.alarms)
    lives: dict[int, list[Change]] = {}
    for change in bench.changes:
        lives.setdefault(change.alarm.id, []).append(change)
    assert sorted(lives) == list(range(1, len(lives) + 1))
    unended: dict[str, int] = {}
    for number, changes in lives.items():
        (check,) = {change.alarm.check for change in changes}
        states = [change.alarm.state for change in changes]
        assert AlarmState.NORMAL not in states[:-1]
        if states[-1] is not AlarmState.NORMAL:
            assert check not in unended
            unended[check] = number
        is_raised = False
        for change in changes:
            match change.event:
                case EventType.ALARM_RAISED:
                    assert change.alarm.state is AlarmState.UNACKNOWLEDGED
                    is_raised = True
                case EventType.ALARM_ACKNOWLEDGED:
                    assert is_raised
                    assert change.alarm.acknowledged_by == "anna"
    assert unended == {alarm.check: alarm.id for alarm in bench.machine.alarms}
