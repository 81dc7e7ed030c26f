"""The plain JSON topics: what is published where, each document with the names, units and nulls of REST."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, fields
from typing import Any
from urllib.parse import quote

from pipeline.gradation.estimates import Estimate
from service.bridge.mqtt.connection import MqttMessage
from service.bridge.plant_state import PlantAlarm, PlantState

STATUS, RESULTS, GAPS, ALARMS = "status", "results", "gaps", "alarms"
MAX_PAYLOAD_BYTES = 64 * 1024
"""A document that would be larger is only its `ALWAYS`, with `is_shortened`."""
ALWAYS = ("seq", "id", "revision", "kind", "outcome", "check", "state", "is_simulated", "is_replay")
MAX_CHECK_CHARS = 100

Document = Mapping[str, Any]


STATES: Mapping[str, tuple[str, ...]] = {
    "state": (
        "rig", "acquisition", "activity", "stones_per_min", "triggers", "measured", "rejected", "lost", "last_seq",
        "instance_id", "calibration_id", "daemon_answers", "trouble",
    ),
    "health": ("ready", "ne107", "components", "reasons"),
    "lot": ("lot", "product", "product_title", "opened_at", "n_stones", "last_lot", "last_verdict"),
    "verdict": ("lot", "verdict", "is_partial", "d50_mm", "flakiness_percent", "shape_percent"),
}  # fmt: skip
"""Retained topics, and the fields of `PlantState` in each."""
OF_IMAGES = ("is_simulated", "is_replay")
"""Fields in every document: what is not production must never be taken for it."""
KNOWN_IN_SILENCE = ("daemon_answers", "trouble", "check")
"""What is known while the daemon does not answer; all else is null then."""
NO_ALARM: Document = {**dict.fromkeys(each.name for each in fields(PlantAlarm)), "state": "normal"}


def retained(now: PlantState, checks: Iterable[str]) -> dict[str, Document]:
    """Return all retained documents by topic; `checks` are those of earlier alarms, over unless they are in `now`."""
    present = {each.name: _unfolded(getattr(now, each.name)) for each in fields(now)}
    documents: dict[str, Document] = {
        topic: {name: present[name] for name in names} for topic, names in STATES.items()
    }
    for check in checks:
        documents[alarm_topic(check)] = {**NO_ALARM, "check": check}
    for alarm in now.alarms:
        documents[alarm_topic(alarm.check)] = asdict(alarm)
    of_images = {name: present[name] for name in OF_IMAGES}
    return {topic: _known(now, {**document, **of_images}) for topic, document in documents.items()}


def _unfolded(value: Any) -> Any:
    return asdict(value) if isinstance(value, Estimate) else value


def alarm_topic(check: str) -> str:
    """Return the topic of the alarms of a check: one level, whatever its name has in it."""
    return f"{ALARMS}/{quote(check[:MAX_CHECK_CHARS], safe=':', errors='replace')}"


def retained_message(prefix: str, topic: str, document: Document, at: str | None) -> MqttMessage:
    """Return the message of a retained document, with the moment that it is of."""
    return MqttMessage(topic=f"{prefix}/{topic}", payload=payload({**document, "at": at}), is_retained=True)


def status_message(prefix: str, status: str) -> MqttMessage:
    """Return the retained status of the bridge itself: `online`, or as its will `offline`."""
    return MqttMessage(topic=f"{prefix}/{STATUS}", payload=payload({"status": status}), is_retained=True)


def result_message(prefix: str, result: Document) -> MqttMessage:
    """Return the message of one result, as it is in the feed."""
    return MqttMessage(topic=f"{prefix}/{RESULTS}", payload=payload(result))


def gap_message(prefix: str, gap: Document) -> MqttMessage:
    """Return the message of a gap: results that were removed before they were read."""
    return MqttMessage(topic=f"{prefix}/{GAPS}", payload=payload(gap))


def payload(document: Document) -> bytes:
    """Return a document as JSON in UTF-8 that any reader takes: finite numbers, no half characters, not too long."""
    content = _json(document)
    if len(content) > MAX_PAYLOAD_BYTES:
        content = _json(
            {name: document[name] for name in ALWAYS if name in document} | {"is_shortened": True}
        )
    return content


def _json(document: Document) -> bytes:
    text = json.dumps(_plain(document), ensure_ascii=False, allow_nan=False)
    return text.encode(errors="replace")  # a lone surrogate is no UTF-8


def _plain(value: Any) -> Any:
    match value:
        case float() if not math.isfinite(value):
            return None
        case dict():
            return {name: _plain(each) for name, each in value.items()}
        case list() | tuple():
            return [_plain(each) for each in value]
    return value


def _known(now: PlantState, document: Document) -> Document:
    """Return the document with null for all that is not known while the daemon does not answer."""
    if now.daemon_answers:
        return document
    return {name: value if name in KNOWN_IN_SILENCE else None for name, value in document.items()}
