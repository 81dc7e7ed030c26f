"""Made-up triggers and outcomes, and how they come into a store."""

from collections.abc import Mapping
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any

from pipeline.frames import BundleKind, Trigger
from service.results.fields import LossReason, Result
from service.results.record import result_of
from service.store import Store, writes


def trigger(sequence: int, kind: BundleKind = BundleKind.PARTICLE) -> Trigger:
    """Return the trigger of stone number `sequence`, a minute after the one before."""
    utc = (
        datetime(2026, 3, 1, tzinfo=timezone(timedelta(hours=1))) + timedelta(minutes=sequence)
    ).isoformat()
    return Trigger(sequence=sequence, received_ns=0, device_ns=0, utc=utc, kind=kind)


def result(**fields: Any) -> Result:
    """Return a result with these fields; the store fills in what it knows of the fall."""
    fall = {"bundle": "", "sequence": 0, "kind": "particle", "captured_at": ""}
    return result_of({**fall, "outcome": "measured", **fields})


def measured(**fields: Any) -> Result:
    """Return a measured result with the fields that store and REST interface read."""
    made = {
        "outcome": "measured",
        "quality": "good",
        "views": ["c01", "c02"],
        "dropped_views": {"c03": "residual"},
        "sieve_size_mm": 20.0,
        "min_box_mm": [30.0, 20.0, 10.0],
        "calibration_id": "0123",
        "is_simulated": True,
    }
    return result(**{**made, **fields})


def rejected(reason: str) -> Result:
    return result(outcome="rejected", reason=reason)


async def add(
    store: Store,
    session: int,
    sequence: int,
    record: Result,
    files: Mapping[str, Path] | None = None,
) -> int:
    """Store a trigger and its outcome; return the `seq`."""
    await store.record_triggers(session, {f"{sequence:08d}": trigger(sequence)})
    return await store.finish(session, f"{sequence:08d}", record, files)


async def lose_open(store: Store, reason: LossReason, detail: str, **which: Any) -> int:
    """Lose the triggers that earlier sessions left open; return of how many stones."""
    return await store.write(writes.lose_open, store.particles_dir, store.session, reason, detail, **which)
