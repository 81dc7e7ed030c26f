"""The plain JSON topics: what is unknown is null, names never break a topic, and any reader takes the JSON."""

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.client import topic_matches_sub
from support.plants import ANSWERS, result

from pipeline.gradation.estimates import Estimate, State
from service.bridge.mqtt.topics import (
    MAX_PAYLOAD_BYTES,
    STATES,
    alarm_topic,
    payload,
    result_message,
    retained,
    retained_message,
    status_message,
)
from service.bridge.plant_state import PlantAlarm, PlantState

ALARM = PlantAlarm(
    id=3, check="camera:c01", priority="high", state="unacknowledged", detail="dark", raised_at="2026-08-15T09:00:00Z",
    acknowledged_by=None, cause="c", action="a",
)  # fmt: skip
NAMES = st.text(max_size=300) | st.sampled_from(["a/b", "#", "+", "\0", "$SYS/x", "\ud800", "ü" * 200, ""])


def strict(content: bytes) -> Any:
    """Read JSON as strict readers do."""

    def refuse(word: str) -> None:
        raise AssertionError(word)

    return json.loads(content.decode("utf-8"), parse_constant=refuse)


def test_figures_have_unit_interval_and_state_as_in_rest() -> None:
    d50_mm = Estimate(state=State.MEASURED, value=11.2, low=11.0, high=11.4)
    told = retained(replace(ANSWERS, lot="L-1", d50_mm=d50_mm), [])["verdict"]
    assert (told["lot"], told["verdict"], told["flakiness_percent"]) == ("L-1", None, None)
    assert {name: told["d50_mm"][name] for name in ("state", "value", "low", "high")} == {
        "state": "measured", "value": 11.2, "low": 11.0, "high": 11.4,
    }  # fmt: skip


def test_every_document_says_whether_it_is_production() -> None:
    for topic, told in retained(replace(ANSWERS, alarms=(ALARM,)), ["gate"]).items():
        assert (told["is_simulated"], told["is_replay"]) == (True, False), topic


def test_nothing_is_known_while_the_daemon_does_not_answer() -> None:
    for topic, told in retained(PlantState(trouble="no answer"), ["gate"]).items():
        known = {name: value for name, value in told.items() if value is not None}
        if topic == "state":
            assert known == {"daemon_answers": False, "trouble": "no answer"}
        else:
            assert known == ({"check": "gate"} if topic == "alarms/gate" else {}), topic


def test_an_alarm_that_is_over_is_normal_and_another_is_as_rest_has_it() -> None:
    told = retained(replace(ANSWERS, alarms=(ALARM,)), ["gate", "camera:c01"])
    assert told["alarms/gate"]["state"] == "normal"
    assert told["alarms/gate"]["id"] is None
    assert told["alarms/camera:c01"]["state"] == "unacknowledged"
    assert told["alarms/camera:c01"]["priority"] == "high"


def test_an_acknowledged_alarm_names_who() -> None:
    alarm = replace(ALARM, state="acknowledged", acknowledged_by="mes")
    told = retained(replace(ANSWERS, alarms=(alarm,)), [])["alarms/camera:c01"]
    assert (told["state"], told["acknowledged_by"]) == ("acknowledged", "mes")


@given(NAMES)
def test_no_name_of_a_lot_gets_into_a_topic(name: str) -> None:
    state = replace(ANSWERS, lot=name, product_title=name)
    assert set(retained(state, [])) == set(STATES)
    message = retained_message("stonefall/line-1", "lot", retained(state, [])["lot"], state.at)
    assert message.topic == "stonefall/line-1/lot"
    assert message.is_retained
    assert strict(message.payload)["lot"] == name.encode(errors="replace").decode()


@given(NAMES)
def test_an_alarm_is_one_level_whatever_its_name_has(name: str) -> None:
    topic = alarm_topic(name)
    assert topic.startswith("alarms/")
    assert topic.isascii()
    assert not set("#+\0 $") & set(topic)
    assert topic.count("/") == 1
    assert topic_matches_sub("alarms/+", topic)
    assert len(topic) < 65_536 // 10


@pytest.mark.parametrize("value", [math.nan, math.inf, [1, {"a": -math.inf}]])
def test_a_number_that_is_none_is_null(value: Any) -> None:
    assert strict(payload({"value": value}))["value"] in (None, [1, {"a": None}])


def test_what_is_too_long_is_told_by_its_identity() -> None:
    told = result_message("p", result(7, detail="x" * MAX_PAYLOAD_BYTES))
    assert len(told.payload) < 1000
    assert strict(told.payload) == {
        "seq": 7, "id": "one-00000007", "revision": 1, "kind": "particle", "outcome": "measured",
        "is_simulated": True, "is_replay": False, "is_shortened": True,
    }  # fmt: skip


def test_a_result_is_as_the_feed_has_it_once_and_not_retained() -> None:
    told = result_message("p", result(7))
    assert (told.topic, told.qos, told.is_retained) == ("p/results", 1, False)
    assert strict(told.payload) == result(7)


def test_the_status_is_retained() -> None:
    assert status_message("p", "offline").is_retained
    assert strict(status_message("p", "offline").payload) == {"status": "offline"}
