import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import httpx
import pytest
from support.calibration_desk import open_desk
from support.recordings import SOURCE
from support.rest import FakeControl, app_of, client_of

from service.alarms.alarms import Alarms, open_alarms
from service.api.settings import ApiSettings
from service.recording.recordings import RecordingsSettings, open_recordings
from service.store import Store
from service.store.event_log import EventLog


@pytest.fixture
def control(tmp_path: Path) -> FakeControl:
    settings = RecordingsSettings(reserve_gb=0.0)
    return FakeControl(
        open_recordings(tmp_path / "recordings", SOURCE, settings, {"command": "test"}),
        calibrations=open_desk(tmp_path / "desk"),
    )


@pytest.fixture
async def alarms(store: Store, control: FakeControl) -> Alarms:
    control.alarms = await open_alarms(store, EventLog(store))
    return control.alarms


@pytest.fixture
async def client(store: Store, control: FakeControl) -> AsyncIterator[httpx.AsyncClient]:
    async with client_of(app_of(store, control, ApiSettings())) as client:
        yield client


@pytest.fixture
def waiting(store: Store, monkeypatch: pytest.MonkeyPatch) -> asyncio.Event:
    """Return an event that is set once a long poll waits for results."""
    event = asyncio.Event()
    wait_beyond = store.wait_beyond

    async def observed(seq: int) -> None:
        event.set()
        await wait_beyond(seq)

    monkeypatch.setattr(store, "wait_beyond", observed)
    return event
