"""Results as events `ResultReady` (OPC 40100-1, 7.10), as variables of the newest, and as JSON for who missed some."""

import json
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

from asyncua.common.event_objects import BaseEvent
from asyncua.ua import ObjectIds as Ids
from asyncua.ua import VariantType as Type

from service.bridge.opcua.nodes import ROOT, Shown
from service.bridge.opcua.space import Space, node_id

EVENT_TYPE = "ResultReadyEventType"
SEVERITY = 100

LEAN: Mapping[str, tuple[Type, str | None, str]] = {
    "kind": (Type.String, None, "particle or ball"),
    "outcome": (Type.String, None, "measured, rejected or lost"),
    "reason": (Type.String, None, "Why rejected or lost, one word"),
    "quality": (Type.String, None, "good, reduced or degraded: how far from the truth it may be"),
    "n_stones": (Type.UInt64, None, "Stones that it is of: 1, but for a loss of many together"),
    "captured_at": (Type.DateTime, None, "When the stone was exposed"),
    "recorded_at": (Type.DateTime, None, "When the outcome became durable"),
    "time_is_doubtful": (Type.Boolean, None, "True when the host's clock was not set"),
    "sieve_size_mm": (Type.Double, "mm", "Smallest square aperture that it passes"),
    "volume_mm3": (Type.Double, "mm3", "Volume"),
    "volume_sd_percent": (Type.Double, "percent", "Standard deviation of the volume"),
    "surface_sd_mm": (Type.Double, "mm", "Standard deviation of the surface"),
    "length_mm": (Type.Double, "mm", "Greatest dimension"),
    "width_mm": (Type.Double, "mm", "Greatest dimension at right angles to the length"),
    "thickness_mm": (Type.Double, "mm", "Dimension at right angles to both"),
    "max_feret_mm": (Type.Double, "mm", "Greatest distance of parallel tangent planes"),
    "min_feret_mm": (Type.Double, "mm", "Least distance of parallel tangent planes"),
    "equivalent_diameter_mm": (Type.Double, "mm", "Diameter of the sphere of equal volume"),
    "mass_g": (Type.Double, "g", "Mass; unknown without a density"),
    "calibration_id": (Type.String, None, "Calibration that was measured with"),
    "verification": (Type.String, None, "What the last balls said of the rig"),
    "revises": (Type.UInt64, None, "seq of the result that this one takes the place of"),
    "is_simulated": (Type.Boolean, None, "True when the images are synthetic"),
    "is_replay": (Type.Boolean, None, "True when no stone fell"),
    "lot": (Type.String, None, "Lot that it is in"),
    "seq": (Type.UInt64, None, "Place in the history, without gaps"),
    "id": (Type.String, None, "Of the stone; a correction has the same"),
    "revision": (Type.UInt32, None, "1, or higher: a correction"),
}
"""The fields of a result that REST calls `lean`, by their names there: type, unit, meaning."""

STATES = {"measured": 1, "lost": 3, "rejected": 4}
"""ResultState of OPC 40100-1: completed, aborted, failed."""
VISION: Mapping[str, Type] = {
    "ResultId": Type.String,
    "IsPartial": Type.Boolean,
    "IsSimulated": Type.Boolean,
    "ResultState": Type.Int32,
    "MeasId": Type.String,
    "PartId": Type.String,
    "JobId": Type.String,
    "InternalConfigurationId": Type.String,
    "CreationTime": Type.DateTime,
    "ResultContent": Type.String,
    "HistoryId": Type.String,
}
"""Fields of the event by the names of OPC 40100-1; `HistoryId` is ours."""


def latest() -> Iterator[Shown]:
    """Yield the variables of the newest result; the outlet writes their values."""
    for name, (kind, unit, meaning) in LEAN.items():
        data_type = Ids.UtcTime if kind is Type.DateTime else kind.value
        yield Shown(f"ResultManagement.LatestResult.{name}", data_type, meaning, lambda _: None, unit)


POSITION = (
    Shown(
        "ResultManagement.HistoryId",
        Ids.String,
        "History of results; another one begins anew",
        lambda _: None,
    ),
    Shown(
        "ResultManagement.Cursor", Ids.UInt64, "seq of the last result that was sent as event", lambda _: None
    ),
)


async def add_result_type(space: Space) -> None:
    """Add the type of the event."""
    fields = {**VISION, **{name: kind for name, (kind, _, _) in LEAN.items()}}
    await space.add_event_type(EVENT_TYPE, "A stone has its outcome", fields, Ids.BaseEventType)
    source = node_id(f"{ROOT}.ResultManagement")
    await space.refer(source, node_id(EVENT_TYPE), Ids.GeneratesEvent)


def lean_value(result: Mapping[str, Any], name: str) -> object:
    """Return a field of a result as OPC UA has it."""
    value = result.get(name)
    if value is not None and LEAN[name][0] is Type.DateTime:
        return datetime.fromisoformat(value).astimezone(UTC)
    return value


def result_event(result: Mapping[str, Any], history_id: str) -> BaseEvent:
    """Return the event of a result; fields that are not known are null."""
    event = BaseEvent(message=f"stone {result['id']}: {result['outcome']}", severity=SEVERITY)
    event.EventType = node_id(EVENT_TYPE)
    event.SourceNode = node_id(f"{ROOT}.ResultManagement")
    event.SourceName = "ResultManagement"
    vision = {
        "ResultId": result["id"],
        "IsPartial": False,
        "IsSimulated": bool(result["is_simulated"] or result["is_replay"]),
        "ResultState": STATES.get(result["outcome"], 0),
        "MeasId": str(result["seq"]),
        "PartId": result["id"],
        "JobId": result.get("lot"),
        "InternalConfigurationId": result.get("calibration_id"),
        "CreationTime": lean_value(result, "recorded_at"),
        "ResultContent": json.dumps(result),
        "HistoryId": history_id,
    }
    for name, kind in VISION.items():
        event.add_property(name, vision[name], kind)
    for name, (kind, _, _) in LEAN.items():
        event.add_property(name, lean_value(result, name), kind)
    return event
