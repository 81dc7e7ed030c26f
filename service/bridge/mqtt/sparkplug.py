"""The bridge as an edge node of Sparkplug B 3.0, the rig as its device: births, deaths, data, and their numbers.

Rules by their section of the specification: 5.4 births of a node and the number `bdSeq` of its death, 5.6 those of a
device, 6.4.5 the number `seq` of a message, 6.4.6 aliases and nulls.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from datetime import datetime
from itertools import chain, count
from types import MappingProxyType
from typing import Any

from service.base.units import unit_of
from service.bridge.mqtt.connection import MqttMessage
from service.bridge.mqtt.payload import DataType, Metric, MetricSample, encode, is_set
from service.bridge.mqtt.settings import SparkplugSettings
from service.bridge.plant_state import PlantState

NAMESPACE = "spBv1.0"
N_NUMBERS = 256
"""`seq` and `bdSeq` run from 0 to 255, and again from 0."""
BD_SEQ = Metric(name="bdSeq", data_type=DataType.INT64)
REBIRTH = Metric(name="Node Control/Rebirth", data_type=DataType.BOOLEAN)
BOOLEAN, INT64, DOUBLE, STRING = DataType.BOOLEAN, DataType.INT64, DataType.DOUBLE, DataType.STRING
STATE_TYPES = {
    "ready": BOOLEAN, "ne107": STRING, "components": STRING, "reasons": STRING,
    "acquisition": STRING, "activity": STRING, "calibration_id": STRING, "instance_id": STRING, "rig": STRING,
    "is_simulated": BOOLEAN, "is_replay": BOOLEAN,
    "stones_per_min": INT64, "triggers": INT64, "measured": INT64, "rejected": INT64, "lost": INT64,
    "lot": STRING, "product": STRING, "product_title": STRING, "opened_at": STRING, "n_stones": INT64,
    "verdict": STRING, "is_partial": BOOLEAN, "last_lot": STRING, "last_verdict": STRING, "alarms": STRING,
    **{
        f"{name}/{part}": DOUBLE
        for name in ("d50_mm", "flakiness_percent", "shape_percent")
        for part in ("value", "low", "high")
    },
}  # fmt: skip
"""Metrics of the plant's state: fields of `PlantState`, as in REST; those with several parts are JSON."""
RESULT_TYPES = {
    "seq": INT64, "id": STRING, "revision": INT64, "revises": INT64, "kind": STRING, "n_stones": INT64,
    "captured_at": STRING, "recorded_at": STRING, "outcome": STRING, "reason": STRING, "quality": STRING,
    "lot": STRING, "calibration_id": STRING, "verification": STRING, "is_simulated": BOOLEAN, "is_replay": BOOLEAN,
    "volume_mm3": DOUBLE, "volume_sd_percent": DOUBLE, "surface_sd_mm": DOUBLE,
    "length_mm": DOUBLE, "width_mm": DOUBLE, "thickness_mm": DOUBLE, "max_feret_mm": DOUBLE, "min_feret_mm": DOUBLE,
    "sieve_size_mm": DOUBLE, "equivalent_diameter_mm": DOUBLE, "mass_g": DOUBLE,
}  # fmt: skip
"""Metrics of the newest result, below `result/`: fields of the feed."""


def _metrics() -> Iterator[Metric]:
    alias = count(1)
    for name, data_type in chain(
        STATE_TYPES.items(), ((f"result/{name}", kind) for name, kind in RESULT_TYPES.items())
    ):
        units = filter(None, map(unit_of, reversed(name.split("/"))))
        yield Metric(name=name, data_type=data_type, alias=next(alias), unit=next(units, None))


METRICS: Mapping[str, Metric] = MappingProxyType({metric.name: metric for metric in _metrics()})
"""Metrics of the device by name."""


class Node:
    """One session of the edge node: from a CONNECT, whose will is its death, to the end of the connection."""

    def __init__(self, settings: SparkplugSettings, bd_seq: int) -> None:
        self._settings, self._bd_seq = settings, bd_seq
        self._seq = 0
        self._values: dict[str, Any] = {}  # of the device, as they were told last
        self._born_ms: int | None = None
        self.is_device_alive = False
        """True between a birth of the device and its death; only then there may be data."""

    @property
    def command_topic(self) -> str:
        """Topic on which a rebirth is asked for."""
        return self._topic("NCMD")

    def death(self) -> MqttMessage:
        """Return the node's death, which is the will of its connection."""
        samples = [MetricSample(metric=BD_SEQ, value=self._bd_seq)]
        return MqttMessage(topic=self._topic("NDEATH"), payload=encode(samples, None, None))

    def births(self, now: PlantState, at_ms: int, last_result: Mapping[str, Any] | None) -> list[MqttMessage]:
        """Return the births of the node and, while the daemon answers, of the device."""
        self._seq = 0
        samples = [
            MetricSample(metric=BD_SEQ, value=self._bd_seq, at_ms=at_ms),
            MetricSample(metric=REBIRTH, value=False, at_ms=at_ms),
        ]
        self.is_device_alive = False
        node = self._message("NBIRTH", samples, at_ms, is_birth=True)
        return [node, *([self.device_birth(now, at_ms, last_result)] if now.daemon_answers else [])]

    def device_birth(self, now: PlantState, at_ms: int, last_result: Mapping[str, Any] | None) -> MqttMessage:
        """Return the birth of the device, with each metric that there will be, and its present value."""
        self.is_device_alive, self._born_ms = True, milliseconds(now.at, at_ms)
        self._values = values_of(now)
        samples = _samples(self._values, self._born_ms) + _result_samples(last_result or {}, self._born_ms)
        return self._message("DBIRTH", samples, at_ms, is_birth=True)

    def device_death(self, at_ms: int) -> MqttMessage:
        """Return the death of the device: the daemon does not answer."""
        self.is_device_alive = False
        return self._message("DDEATH", [], at_ms)

    def changes(self, now: PlantState, at_ms: int) -> list[MqttMessage]:
        """Return the data of what has changed since it was told last; none if nothing has."""
        values = values_of(now)
        changed = {name: value for name, value in values.items() if value != self._values[name]}
        self._values = values
        samples = _samples(changed, milliseconds(now.at, at_ms))
        return [self._message("DDATA", samples, at_ms)] if samples else []

    def result(self, result: Mapping[str, Any], at_ms: int) -> MqttMessage:
        """Return the data of one result, all its metrics at the time it was captured.

        Historical is what had become durable before the device was born, by the daemon's clock.
        """
        recorded_ms = milliseconds(result.get("recorded_at"), at_ms)
        is_historical = self._born_ms is not None and recorded_ms < self._born_ms
        return self._message(
            "DDATA", _result_samples(result, recorded_ms, is_historical=is_historical), at_ms
        )

    def asks_rebirth(self, content: bytes) -> bool:
        """True when a command asks for a rebirth; raises `ValueError` if it is no command at all."""
        return is_set(content, REBIRTH.name)

    def _message(
        self, verb: str, samples: list[MetricSample], at_ms: int, *, is_birth: bool = False
    ) -> MqttMessage:
        content = encode(samples, at_ms, self._seq, is_birth=is_birth)
        self._seq = (self._seq + 1) % N_NUMBERS
        return MqttMessage(topic=self._topic(verb), payload=content, qos=0)

    def _topic(self, verb: str) -> str:
        place = self._settings
        device = [place.device] if verb.startswith("D") else []
        return "/".join([NAMESPACE, place.group, verb, place.node, *device])


def values_of(now: PlantState) -> dict[str, Any]:
    """Return the values of the state's metrics by name; None for what is not known."""
    return {name: _at(now, name) for name in STATE_TYPES}


def host_state(content: bytes) -> tuple[bool, int]:
    """Parse the STATE of a host, online and time stamp (6.4.27); raise `ValueError` if it is none."""
    try:
        told = json.loads(content)
    except (ValueError, RecursionError) as err:
        raise ValueError("is no JSON") from err
    match told:
        case {"online": bool(is_online), "timestamp": int(timestamp)}:
            return is_online, timestamp
    raise ValueError("has no online and timestamp")


def state_topic(host: str) -> str:
    """Return the topic on which a host application says whether it is there."""
    return f"{NAMESPACE}/STATE/{host}"


def milliseconds(time: Any, otherwise: int) -> int:
    """Return a time (RFC 3339) in milliseconds since 1970; `otherwise` where there is none."""
    try:
        return max(round(datetime.fromisoformat(time).timestamp() * 1000), 0)
    except (TypeError, ValueError, OverflowError):
        return otherwise


def _samples(values: Mapping[str, Any], at_ms: int, *, is_historical: bool = False) -> list[MetricSample]:
    return [
        MetricSample(metric=METRICS[name], value=value, at_ms=at_ms, is_historical=is_historical)
        for name, value in values.items()
    ]


def _result_samples(
    result: Mapping[str, Any], otherwise_ms: int, *, is_historical: bool = False
) -> list[MetricSample]:
    values = {f"result/{name}": result.get(name) for name in RESULT_TYPES}
    return _samples(
        values, milliseconds(result.get("captured_at"), otherwise_ms), is_historical=is_historical
    )


def _at(now: PlantState, path: str) -> Any:
    value: Any = now
    for name in path.split("/"):
        value = None if value is None else getattr(value, name)
    return [asdict(each) for each in value] if path == "alarms" else value
