"""The table of variables: units, words and states by the standards, and what is shown of what is not known."""

from dataclasses import replace
from datetime import UTC, datetime

import pytest
from asyncua import ua
from support.opcua import ARMED

from service.base.status import Ne107
from service.bridge.opcua.nodes import (
    HEALTH,
    NUMBERS,
    SHOWN,
    VERDICTS,
    VisionState,
    data_value,
    mode_state,
    vision_state,
)
from service.bridge.opcua.results import LEAN, latest, result_event
from service.bridge.opcua.space import UNITS, engineering_units
from service.bridge.plant_state import PlantState
from service.results.fields import LEAN_FIELDS

NOW = datetime(2026, 11, 28, 7, tzinfo=UTC)


def test_units_have_the_ids_of_their_codes() -> None:
    # OPC 10000-8, 5.6.3: the id is made of the characters of the code, here as the foundation lists them
    known = {"mm": 5066068, "mm3": 5066065, "percent": 20529, "g": 4674125, "per_min": 4405556}
    assert {unit: engineering_units(unit).UnitId for unit in UNITS} == known


def test_words_are_those_of_the_standards() -> None:
    assert list(HEALTH.values()) == [
        "NORMAL",
        "FAILURE",
        "CHECK_FUNCTION",
        "OFF_SPEC",
        "MAINTENANCE_REQUIRED",
    ]
    assert set(HEALTH) == set(Ne107)
    assert NUMBERS[VisionState.READY] == 6
    assert len(set(VERDICTS)) == 5


def test_paths_are_different_and_every_value_without_a_daemon_is_bad() -> None:
    paths = [shown.path for shown in (*SHOWN, *latest())]
    assert len(set(paths)) == len(paths)
    for shown in SHOWN:
        value = data_value(shown, PlantState(), NOW)
        if not shown.is_always_known:
            assert value.StatusCode.value == ua.StatusCodes.BadNoCommunication, shown.path
            assert value.Value.Value is None


def test_what_is_not_known_of_an_answering_daemon_is_never_zero() -> None:
    empty = PlantState(daemon_answers=True, trouble=None)
    zeros = {shown.path for shown in SHOWN if data_value(shown, empty, NOW).Value.Value == 0}
    assert zeros == {
        "IsSimulated", "Ready", "Lot.IsOpen", "Figures.IsPartial", "Alarms.Unacknowledged", "Alarms.Active"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "outer", "inner"),
    [
        ({}, "Operational", "ContinuousExecution"),
        ({"acquisition": "disarmed"}, "Operational", "Ready"),
        ({"acquisition": "arming"}, "Operational", "Ready"),
        ({"acquisition": "held"}, "Error", None),
        ({"ne107": Ne107.FAILURE}, "Error", None),
        ({"ne107": Ne107.OUT_OF_SPECIFICATION}, "Operational", "ContinuousExecution"),
        ({"acquisition": "stopping"}, "Halted", None),
        ({"acquisition": None}, None, None),
    ],
)
def test_the_state_machines_follow_the_rig(
    changes: dict[str, object], outer: str | None, inner: str | None
) -> None:
    state = replace(ARMED, **changes)  # type: ignore[arg-type]  # fields of a state
    assert (vision_state(state), mode_state(state)) == (outer, inner)


def test_an_event_has_all_that_rest_calls_lean() -> None:
    assert set(LEAN) == LEAN_FIELDS


def test_a_played_stone_is_simulated_whatever_its_images_are() -> None:
    record = dict.fromkeys(LEAN) | {
        "id": "a",
        "seq": 3,
        "outcome": "measured",
        "recorded_at": "2026-11-28T06:00:00Z",
    }
    event = result_event(record | {"is_simulated": False, "is_replay": True}, "h")
    assert event.IsSimulated is True
    assert result_event(record | {"is_simulated": False, "is_replay": False}, "h").IsSimulated is False
