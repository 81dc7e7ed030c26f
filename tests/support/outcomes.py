"""Made-up triggers and outcomes, and how they come into a store."""

from collections.abc import Mapping
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from pipeline.frames import BundleKind, Trigger
from service.store import Store


def trigger(sequence: int, kind: BundleKind = BundleKind.PARTICLE) -> Trigger:
    """Return the trigger of stone number `sequence`, a minute after the one before."""
    utc = (
        datetime(2026, 3, 1, tzinfo=timezone(timedelta(hours=1))) + timedelta(minutes=sequence)
    ).isoformat()
    return Trigger(sequence=sequence, received_ns=0, device_ns=0, utc=utc, kind=kind)


def measured(**fields: Any) -> dict[str, Any]:
    """Return the fields of a measured record that store and REST interface read."""
    return {
        "outcome": "measured",
        "reason": None,
        "quality": "good",
        "views": ["c01", "c02"],
        "dropped_views": {"c03": "residual"},
        "sieve_size_mm": 20.0,
        "min_box_mm": [30.0, 20.0, 10.0],
        "calibration_id": "0123",
        "is_simulated": True,
        **fields,
    }


def rejected(reason: str) -> dict[str, Any]:
    return {"outcome": "rejected", "reason": reason, "quality": None, "views": [], "dropped_views": {}}


async def add(
    store: Store,
    session: int,
    sequence: int,
    record: Mapping[str, Any],
    files: Mapping[str, Path] | None = None,
) -> int:
    """Store a trigger and its outcome; return the `seq`."""
    await store.record_triggers(session, {f"{sequence:08d}": trigger(sequence)})
    return await store.finish(session, f"{sequence:08d}", record, files)
