"""The edge node by the rules of Sparkplug B 3.0: numbers, births, deaths, aliases, nulls, what is historical."""

from dataclasses import fields, replace
from typing import Any, get_type_hints

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.plants import ANSWERS, result
from support.wire import fields_of

from pipeline.gradation.estimates import Estimate, State
from service.bridge.mqtt.connection import MqttMessage
from service.bridge.mqtt.payload import DataType
from service.bridge.mqtt.settings import SparkplugSettings
from service.bridge.mqtt.sparkplug import METRICS, RESULT_TYPES, STATE_TYPES, Node, host_state, values_of
from service.bridge.plant_state import PlantAlarm, PlantState
from service.results.fields import LEAN, Result

PLACE = SparkplugSettings(group="plant", node="crusher", device="rig-1")
ALARM = PlantAlarm(
    id=3, check="gate", priority="high", state="unacknowledged", detail="dark", raised_at="2026-08-15T09:00:00Z",
    acknowledged_by=None, cause="c", action="a",
)  # fmt: skip


def decoded(message: MqttMessage) -> dict[str, Any]:
    """Return time, sequence and metrics of a message, each metric as its fields by number."""
    found = fields_of(message.payload)
    plain = {number: value for number, value in found if number != 2}
    return {
        "at": plain.get(1),
        "seq": plain.get(3),
        "metrics": [dict(fields_of(m)) for n, m in found if n == 2],
    }


def by_alias(message: MqttMessage) -> dict[str, dict[int, Any]]:
    names = {metric.alias: name for name, metric in METRICS.items()}
    return {names[metric[2]]: metric for metric in decoded(message)["metrics"]}


def test_births_come_in_order_with_all_metrics_that_there_will_be() -> None:
    node = Node(PLACE, 7)
    of_node, of_device = node.births(ANSWERS, 1000, None)
    assert (of_node.topic, of_device.topic) == (
        "spBv1.0/plant/NBIRTH/crusher",
        "spBv1.0/plant/DBIRTH/crusher/rig-1",
    )
    assert [decoded(each)["seq"] for each in (of_node, of_device)] == [0, 1]
    assert all(each.qos == 0 and not each.is_retained for each in (of_node, of_device))
    number, rebirth = decoded(of_node)["metrics"]
    assert number == {1: b"bdSeq", 3: 1000, 4: 4, 11: 7}
    assert rebirth == {
        1: b"Node Control/Rebirth",
        3: 1000,
        4: 11,
        14: 0,
    }  # no alias: one that knows none may ask
    metrics = decoded(of_device)["metrics"]
    assert [metric[1].decode() for metric in metrics] == list(METRICS)
    assert len({metric[2] for metric in metrics}) == len(metrics)  # aliases
    assert all({3, 4} <= metric.keys() for metric in metrics)  # time and type
    assert [metric[4] for metric in metrics] == [metric.data_type for metric in METRICS.values()]


def test_units_are_properties_of_the_metrics() -> None:
    _, of_device = Node(PLACE, 0).births(ANSWERS, 1000, None)
    units = {}
    for metric in decoded(of_device)["metrics"]:
        if 9 in metric:
            ((_, key), (_, value)) = fields_of(metric[9])
            assert key == b"engUnit"
            units[metric[1].decode()] = dict(fields_of(value))[8].decode()
    assert units["result/sieve_size_mm"] == units["d50_mm/value"] == "mm"
    assert units["result/volume_mm3"] == "mm³"
    assert units["flakiness_percent/low"] == "%"
    assert "result/seq" not in units


def test_the_death_is_the_will_and_has_the_number_of_its_birth() -> None:
    death = Node(PLACE, 255).death()
    assert (death.topic, death.qos, death.is_retained) == ("spBv1.0/plant/NDEATH/crusher", 1, False)
    assert decoded(death) == {"at": None, "seq": None, "metrics": [{1: b"bdSeq", 4: 4, 11: 255}]}


def test_what_is_unknown_is_null_in_the_birth() -> None:
    metrics = by_alias(Node(PLACE, 0).births(ANSWERS, 1000, None)[1])
    for name in ("lot", "verdict", "d50_mm/value", "result/seq", "result/mass_g", "n_stones"):
        assert metrics[name][7] == 1, name
        assert not metrics[name].keys() & {10, 11, 12, 13, 14, 15}, name
    assert metrics["ready"][14] == 1


def test_a_change_is_told_alone_and_once_by_its_alias() -> None:
    node = Node(PLACE, 0)
    node.births(ANSWERS, 1000, None)
    d50_mm = Estimate(state=State.MEASURED, value=11.2, low=11.0, high=11.4)
    later = replace(ANSWERS, lot="L#1/+", d50_mm=d50_mm, alarms=(ALARM,), at="2026-08-15T10:00:01Z")
    (told,) = node.changes(later, 2000)
    assert told.topic == "spBv1.0/plant/DDATA/crusher/rig-1"
    metrics = by_alias(told)
    assert metrics.keys() == {"lot", "d50_mm/value", "d50_mm/low", "d50_mm/high", "alarms"}
    assert metrics["lot"][15] == b"L#1/+"
    assert metrics["d50_mm/value"][13] == 11.2
    assert b'"check": "gate"' in metrics["alarms"][15]
    assert all(1 not in metric and 4 not in metric for metric in metrics.values())  # neither name nor type
    assert metrics["lot"][3] == 1786788001000
    assert node.changes(later, 3000) == []


def test_a_result_has_all_its_metrics_at_the_time_of_its_exposure() -> None:
    node = Node(PLACE, 0)
    node.births(ANSWERS, 1000, None)
    metrics = by_alias(node.result(result(5, recorded_at="2026-08-15T10:00:02Z"), 2000))
    assert metrics.keys() == {f"result/{name}" for name in RESULT_TYPES}
    assert metrics["result/seq"][11] == 5
    assert metrics["result/sieve_size_mm"][13] == 11.5
    assert metrics["result/mass_g"][7] == 1  # unknown, not 0
    assert {metric[3] for metric in metrics.values()} == {1786787940000}
    assert not any(5 in metric for metric in metrics.values())


def test_what_was_stored_before_the_birth_is_historical() -> None:
    node = Node(PLACE, 0)
    node.births(ANSWERS, 1000, None)
    metrics = by_alias(node.result(result(5, recorded_at="2026-08-15T09:59:59Z"), 2000))
    assert all(metric[5] == 1 for metric in metrics.values())


def test_a_rebirth_has_the_same_number_and_the_last_result() -> None:
    node = Node(PLACE, 9)
    node.births(ANSWERS, 1000, None)
    node.result(result(5), 2000)
    again, of_device = node.births(ANSWERS, 3000, result(5))
    assert decoded(again)["metrics"][0][11] == 9
    assert decoded(again)["seq"] == 0
    assert by_alias(of_device)["result/seq"][11] == 5


def test_the_device_is_not_born_while_the_daemon_does_not_answer() -> None:
    node = Node(PLACE, 0)
    assert [each.topic.split("/")[2] for each in node.births(PlantState(), 1000, None)] == ["NBIRTH"]
    assert not node.is_device_alive
    assert node.device_birth(ANSWERS, 2000, None).topic.endswith("DBIRTH/crusher/rig-1")
    assert node.is_device_alive
    death = node.device_death(3000)
    assert decoded(death) == {"at": 3000, "seq": 2, "metrics": []}
    assert not node.is_device_alive


@given(st.lists(st.sampled_from(["result", "change", "silence", "rebirth"]), max_size=600))
def test_each_message_has_the_next_number_and_a_birth_of_the_node_begins_anew(deeds: list[str]) -> None:
    node, stones = Node(PLACE, 0), 0
    sent = node.births(ANSWERS, 1000, None)
    for deed in deeds:
        match deed:
            case "result":
                sent.append(node.result(result(1), 1000))
            case "change":
                stones += 1
                sent += node.changes(replace(ANSWERS, n_stones=stones), 1000)
            case "silence":
                sent += [node.device_death(1000), node.device_birth(ANSWERS, 1000, None)]
            case "rebirth":
                sent += node.births(ANSWERS, 1000, None)
    expected = -1
    for message in sent:
        expected = 0 if "/NBIRTH/" in message.topic else (expected + 1) % 256
        assert decoded(message)["seq"] == expected


def test_the_number_of_a_message_goes_round() -> None:
    node = Node(PLACE, 0)
    node.births(ANSWERS, 1000, None)  # 0 and 1
    assert [decoded(node.result(result(1), 1))["seq"] for _ in range(256)][-3:] == [255, 0, 1]


def test_metrics_are_the_fields_of_the_state_in_their_types() -> None:
    hints = get_type_hints(PlantState)
    told = {name.partition("/")[0] for name in STATE_TYPES}
    assert {each.name for each in fields(PlantState)} - told == {
        "daemon_answers", "trouble",  # the device is dead then
        "at",  # the time of each metric
        "last_seq", "last_event",  # of who follows the feeds himself
    }  # fmt: skip
    for name, data_type in STATE_TYPES.items():
        hint = str(hints[name.partition("/")[0]])
        if "/" in name:
            assert "Estimate" in hint
            assert data_type is DataType.DOUBLE
        else:
            number = (
                DataType.BOOLEAN if "bool" in hint else DataType.INT64 if "int" in hint else DataType.STRING
            )
            assert data_type is number, name


def test_metrics_of_a_result_are_lean_fields_of_the_feed_in_their_types() -> None:
    kinds = {"integer": DataType.INT64, "number": DataType.DOUBLE, "boolean": DataType.BOOLEAN}
    properties = Result.model_json_schema()["properties"]
    lean = {name for name, field in Result.model_fields.items() if LEAN in field.metadata}
    for name, data_type in RESULT_TYPES.items():
        parts = properties[name].get("anyOf", [properties[name]])
        kind = next(part.get("type", "string") for part in parts if part.get("type") != "null")
        assert data_type is kinds.get(kind, DataType.STRING), name
    always = {"seq", "id", "revision", "kind", "outcome", "is_simulated", "is_replay"}
    assert lean | always == set(RESULT_TYPES) | {"time_is_doubtful"}


def test_values_are_all_of_the_metrics() -> None:
    assert values_of(ANSWERS).keys() == STATE_TYPES.keys()


@pytest.mark.parametrize(
    "content",
    [b"", b"OFFLINE", b"[]", b'{"online": 1, "timestamp": 1}', b'{"online": true}', b"\xff", b"[" * 100_000,
     b'{"online": true, "timestamp": "now"}'],
)  # fmt: skip
def test_a_host_that_says_nothing_of_itself_is_an_error_of_one_kind(content: bytes) -> None:
    with pytest.raises(ValueError, match=r"is no JSON|has no online"):
        host_state(content)


def test_a_host_says_that_it_is_online_and_when() -> None:
    assert host_state(b'{"online": true, "timestamp": 1668114759262}') == (True, 1668114759262)
