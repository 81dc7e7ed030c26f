"""A daemon that a bridge can follow, as far as documents go, and a plant that looks at it."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

from support.eventually import PATIENCE_S
from support.fake_feed import FakeFeed

from service.bridge.plant import Plant
from service.bridge.plant_state import PlantState


def estimate(value: float | None) -> dict[str, Any]:
    """Return a figure as REST has it."""
    return {
        "state": "not_measured" if value is None else "measured",
        "value": value,
        "low": None,
        "high": None,
    }


def alarm(number: int, acknowledged_by: str | None = None) -> dict[str, Any]:
    """Return an alarm as `/alarms` has it."""
    return {
        "id": number,
        "check": "gate",
        "priority": "urgent",
        "state": "unacknowledged" if acknowledged_by is None else "acknowledged",
        "detail": "the gate does not answer",
        "raised_at": "2026-01-01T00:00:00.000Z",
        "acknowledged_by": acknowledged_by,
        "cause": "no stone is seen",
        "action": "look at the gate",
        "occurrences": 1,
    }


def overview(**instead: Any) -> dict[str, Any]:
    """Return an overview of a plant where all is well: an armed rig, and an open lot that conforms."""
    return {
        "at": "2026-01-01T00:00:00.000Z",
        "instance_id": "aaaaaaaa",
        "rig": "quarry, line 2",
        "is_simulated": False,
        "is_replay": False,
        "acquisition": {"state": "armed", "trouble": None, "activity": "measuring"},
        "ne107": "good",
        "gate_ne107": "good",
        "rig_ne107": "good",
        "ready": True,
        "reasons": [],
        "lot": {
            "lot": "L-7",
            "product": "basalt-8-16",
            "title": "Basalt 8/16",
            "opened_at": "2026-01-01T00:00:00.000Z",
            "n_stones": 70_000,
        },
        "last_lot": {
            "lot": "L-6",
            "product": "basalt-8-16",
            "closed_at": "",
            "completion": {"verdict": "conforms"},
        },
        "figures": {
            "lot": "L-7",
            "verdict": "conforms",
            "is_partial": False,
            "d50_mm": estimate(11.234),
            "flakiness_percent": estimate(8.04),
            "shape_percent": estimate(None),
            "measured": 69_000,
        },
        "stones_per_min": 240,
        "accounting": {
            "triggers": 100_000,
            "measured": 99_000,
            "rejected": 900,
            "lost": 99,
            "in_progress": 1,
        },
        "calibration_id": "c-1",
        "alarms": {"items": []},
        "cameras": [{"id": "c01", "ne107": "good"}],
        "last_seq": 99_999,
        "last_event": 12,
        **instead,
    }


def tell(feed: FakeFeed, *alarms: dict[str, Any], **instead: Any) -> None:
    """Have a daemon show this overview, and these alarms."""
    feed.documents["/overview"] = overview(alarms={"items": list(alarms)}, **instead)
    feed.documents["/alarms"] = {"items": list(alarms), "shelved": [], "suppressed": []}


@asynccontextmanager
async def kept_plant(url: str, folder: Path, key_file: Path | None = None) -> AsyncIterator[Plant]:
    """Provide a plant that looks at the daemon at an address."""
    plant = Plant(url, key_file, folder, "bridge")
    keeping = asyncio.create_task(plant.keep())
    try:
        yield plant
    finally:
        keeping.cancel()
        with suppress(asyncio.CancelledError):
            await keeping


async def state_when(plant: Plant, is_so: Callable[[PlantState], bool]) -> PlantState:
    """Return the first state that is so."""
    async with asyncio.timeout(PATIENCE_S):
        async for state in plant.states():
            if is_so(state):
                return state
    raise AssertionError("the states ended")
