"""The payload of Sparkplug B, byte by byte as the specification's schema says, and what hostile commands are to it."""

import json
import math
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.wire import fields_of

from service.bridge.mqtt.payload import MAX_COMMAND_BYTES, DataType, Metric, MetricSample, encode, is_set

SIZE = Metric(name="m", data_type=DataType.DOUBLE, alias=7, unit="mm")
REBIRTH = Metric(name="Node Control/Rebirth", data_type=DataType.BOOLEAN)
KINDS = {10: "int_value", 11: "long_value", 13: "double_value", 14: "boolean_value", 15: "string_value"}


def sample(value: Any, data_type: DataType) -> bytes:
    metric = Metric(name="m", data_type=data_type, alias=7)
    ((_, found),) = [
        each
        for each in fields_of(encode([MetricSample(metric=metric, value=value, at_ms=1000)], 1000, 5))
        if each[0] == 2
    ]
    assert isinstance(found, bytes)
    return found


def test_data_has_the_bytes_of_the_schema() -> None:
    data = encode([MetricSample(metric=SIZE, value=11.5, at_ms=1000)], 1000, 5)
    # timestamp = 1: 1000; metrics = 2: alias = 2: 7, timestamp = 3: 1000, double_value = 13: 11.5; seq = 3: 5
    assert data == bytes.fromhex("08e807 120e 1007 18e807 690000000000002740 1805")


def test_a_birth_has_name_type_and_unit_as_well() -> None:
    birth = encode([MetricSample(metric=SIZE, value=11.5, at_ms=1000)], 1000, 0, is_birth=True)
    # name = 1, alias = 2, timestamp = 3, datatype = 4: 10, properties = 9; in these keys = 1,
    # values = 2: type = 1: 12, string_value = 8
    properties = "4a11 0a07 656e67556e6974 1206 080c 42026d6d"
    assert birth == bytes.fromhex(f"08e807 1226 0a016d 1007 18e807 200a {properties} 690000000000002740 1800")


def test_what_is_unknown_is_null_and_has_no_value() -> None:
    data = encode([MetricSample(metric=SIZE, value=None, at_ms=1000, is_historical=True)], 1000, 255)
    # is_historical = 5, is_null = 7
    assert data == bytes.fromhex("08e807 1209 1007 18e807 2801 3801 18ff01")


def test_a_death_has_its_number_by_name_and_neither_sequence_nor_time() -> None:
    number = Metric(name="bdSeq", data_type=DataType.INT64)
    assert encode([MetricSample(metric=number, value=3)], None, None) == bytes.fromhex(
        "120b 0a056264536571 2004 5803"
    )


@pytest.mark.parametrize(
    ("value", "data_type", "told"),
    [
        (True, DataType.BOOLEAN, "7001"),
        (False, DataType.BOOLEAN, "7000"),
        (0, DataType.INT64, "5800"),
        (-1, DataType.INT64, "58ffffffffffffffffff01"),
        (3, DataType.DOUBLE, "690000000000000840"),
        ("°", DataType.STRING, "7a02c2b0"),
        (["a"], DataType.STRING, "7a055b2261225d"),
        ("\ud800", DataType.STRING, "7a013f"),
        (math.nan, DataType.DOUBLE, "3801"),
        (math.inf, DataType.DOUBLE, "3801"),
        (2**63, DataType.INT64, "3801"),
        (1.5, DataType.INT64, "3801"),
        (True, DataType.INT64, "3801"),
        (True, DataType.DOUBLE, "3801"),
        (1, DataType.BOOLEAN, "3801"),
        (1, DataType.STRING, "3801"),
        ("1", DataType.DOUBLE, "3801"),
    ],
)  # fmt: skip
def test_each_value_in_its_type_and_null_where_it_is_none_of_it(
    value: Any, data_type: DataType, told: str
) -> None:
    assert sample(value, data_type) == bytes.fromhex("1007 18e807") + bytes.fromhex(told)


@given(
    st.one_of(
        st.tuples(st.just(DataType.DOUBLE), st.floats(allow_nan=False, allow_infinity=False)),
        st.tuples(st.just(DataType.INT64), st.integers(-(2**63), 2**63 - 1)),
        st.tuples(st.just(DataType.BOOLEAN), st.booleans()),
        st.tuples(st.just(DataType.STRING), st.text()),
    )
)
def test_a_value_comes_back_from_the_wire(typed: tuple[DataType, Any]) -> None:
    data_type, value = typed
    number, told = fields_of(sample(value, data_type))[-1]
    match KINDS[number]:
        case "long_value":
            told = told - 2**64 if told >= 2**63 else told
        case "boolean_value":
            told = bool(told)
        case "string_value":
            told, value = told.decode(), value.encode(errors="replace").decode()
    assert told == value


def test_lists_are_json() -> None:
    assert json.loads(fields_of(sample([{"a": 1}], DataType.STRING))[-1][1]) == [{"a": 1}]


def test_a_rebirth_is_understood_however_it_was_encoded() -> None:
    told = encode([MetricSample(metric=REBIRTH, value=True, at_ms=1)], 1, None)
    assert is_set(told, REBIRTH.name)
    assert is_set(bytes.fromhex("12180a144e6f646520436f6e74726f6c2f526562697274687001"), REBIRTH.name)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        encode([MetricSample(metric=REBIRTH, value=False, at_ms=1)], 1, 0),
        encode(
            [MetricSample(metric=Metric(name="Node Control/Reboot", data_type=DataType.BOOLEAN), value=True)],
            1,
            0,
        ),
        encode(
            [MetricSample(metric=Metric(name=REBIRTH.name, data_type=DataType.STRING), value="true")], 1, 0
        ),
    ],
)
def test_nothing_else_is_a_rebirth(content: bytes) -> None:
    assert not is_set(content, REBIRTH.name)


@pytest.mark.parametrize(
    "content", [b"\xff" * 30, b"{}", b"\x12\xff\xff\xff\xff\x0f", bytes(MAX_COMMAND_BYTES + 1)]
)
def test_what_is_no_payload_is_an_error_of_one_kind(content: bytes) -> None:
    with pytest.raises(ValueError, match=r"is no Sparkplug B payload|bytes"):
        is_set(content, REBIRTH.name)


@given(st.binary(max_size=200))
def test_no_bytes_at_all_are_another_error(content: bytes) -> None:
    with suppress(ValueError):
        assert is_set(content, REBIRTH.name) in (True, False)
