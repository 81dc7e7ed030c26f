"""Payload of Sparkplug B 3.0 in Protocol Buffers: metrics with type, time, unit and null, and what a command says.

The message is defined here, with the field numbers of section 6.4.1 of the specification (Google Protocol Buffer
Schema). Members that we neither send nor obey (data sets, templates, extensions) are unknown fields to it.
"""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

MAX_COMMAND_BYTES = 64 * 1024
"""A longer command is not looked at: a rebirth request has some 40 bytes."""
UNIT_KEY = "engUnit"
"""Property of a metric that has its unit, as Ignition names it; the specification names none."""
FIELDS = {
    "Payload": "timestamp:uint64=1 metrics:*Metric=2 seq:uint64=3",
    "Metric": "name:string=1 alias:uint64=2 timestamp:uint64=3 datatype:uint32=4 is_historical:bool=5 is_null:bool=7"
    " properties:PropertySet=9 int_value:uint32=10 long_value:uint64=11 double_value:double=13 boolean_value:bool=14"
    " string_value:string=15",
    "PropertySet": "keys:*string=1 values:*PropertyValue=2",
    "PropertyValue": "type:uint32=1 is_null:bool=2 string_value:string=8",
}
"""Messages by name; `name:type=number`, `*` before the type of what is repeated."""


class DataType(IntEnum):
    """Type of a metric, by the numbers of section 6.4.16 of the specification."""

    INT64 = 4
    DOUBLE = 10
    BOOLEAN = 11
    STRING = 12


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """A metric as a birth defines it."""

    name: str
    data_type: DataType
    alias: int | None = None
    """Number that stands for the name in data; None: it always goes by its name."""
    unit: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricSample:
    """Value of a metric at a time; None is null."""

    metric: Metric
    value: Any
    at_ms: int | None = None
    """Since 1970, UTC; None in a death alone, which is written before its time."""
    is_historical: bool = False
    """True for what was held back while broker or host was away."""


def encode(
    samples: Iterable[MetricSample], at_ms: int | None, seq: int | None, *, is_birth: bool = False
) -> bytes:
    """Return a payload; without `seq` that of a node's death, in a birth with names, types and units.

    A value that its type cannot hold (a double that is no number, an integer beyond 64 bits) is null.
    """
    payload = _PAYLOAD()
    if at_ms is not None:
        payload.timestamp = at_ms
    if seq is not None:
        payload.seq = seq
    for sample in samples:
        _add(payload.metrics.add(), sample, is_birth)
    return bytes(payload.SerializeToString(deterministic=True))


def is_set(content: bytes, name: str) -> bool:
    """True when a command sets the metric of this name to true; raises `ValueError` if it is no payload."""
    if len(content) > MAX_COMMAND_BYTES:
        raise ValueError(f"has {len(content)} bytes")
    try:
        payload = _PAYLOAD.FromString(content)
    except (DecodeError, UnicodeDecodeError) as err:
        raise ValueError("is no Sparkplug B payload") from err
    return any(metric.name == name and metric.boolean_value for metric in payload.metrics)


def _add(told: Any, sample: MetricSample, is_birth: bool) -> None:
    metric = sample.metric
    if is_birth or metric.alias is None:
        told.name = metric.name
        told.datatype = metric.data_type
    if metric.alias is not None:
        told.alias = metric.alias
    if sample.at_ms is not None:
        told.timestamp = sample.at_ms
    if sample.is_historical:
        told.is_historical = True
    if is_birth and metric.unit is not None:
        told.properties.keys.append(UNIT_KEY)
        told.properties.values.add(type=DataType.STRING, string_value=metric.unit)
    value = _fitting(sample.value, metric.data_type)
    match value:
        case None:
            told.is_null = True
        case bool():
            told.boolean_value = value
        case int():
            told.long_value = value % 2**64  # negative ones as two's complement
        case float():
            told.double_value = value
        case _:
            told.string_value = value


def _fitting(value: Any, data_type: DataType) -> bool | int | float | str | None:
    """Return the value in its type, None if there is none that says the same."""
    match data_type, value:
        case DataType.BOOLEAN, bool():
            return value
        case DataType.INT64, int() if not isinstance(value, bool) and -(2**63) <= value < 2**63:
            return value
        case DataType.DOUBLE, int() | float() if not isinstance(value, bool) and math.isfinite(value):
            return float(value)
        case DataType.STRING, str():
            return value.encode(errors="replace").decode()  # lone surrogates, which JSON may have
        case DataType.STRING, list() | tuple() | dict():
            return json.dumps(value, ensure_ascii=True)
    return None


def _message_class() -> Any:
    """Build the class of `Payload` from `FIELDS`, in a pool of its own: other definitions may be loaded beside it."""
    file = descriptor_pb2.FileDescriptorProto(name="stonefall/sparkplug_b.proto", package="stonefall")
    for name, fields in FIELDS.items():
        message = file.message_type.add(name=name)
        for field in fields.split():
            label, _, rest = field.partition(":")
            kind, _, number = rest.partition("=")
            is_repeated, kind = kind.startswith("*"), kind.removeprefix("*")
            added = message.field.add(name=label, number=int(number))
            added.label = added.LABEL_REPEATED if is_repeated else added.LABEL_OPTIONAL
            if kind in FIELDS:
                added.type, added.type_name = added.TYPE_MESSAGE, f".stonefall.{kind}"
            else:
                added.type = getattr(added, f"TYPE_{kind.upper()}")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("stonefall.Payload"))


_PAYLOAD = _message_class()
