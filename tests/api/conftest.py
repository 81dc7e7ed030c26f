import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

import httpx
import pytest
from pydantic import SecretStr
from support.calibration_desk import open_desk
from support.recordings import SOURCE
from support.remeasuring import AgainPool, remeasuring_of
from support.rest import FakeControl, app_of, client_of
from support.webhook_receiver import SECRET, Receiver

from service.daemon.diagnostics.archive import Inputs
from service.delivery.settings import WebhookEndpoint, WebhooksSettings
from service.delivery.webhooks import Webhooks, open_webhooks
from service.health.alarms.alarms import Alarms, open_alarms
from service.host.machine import HostNeeds
from service.recording.recordings import Recordings, RecordingsSettings
from service.store import Store
from service.store.event_log import EventLog
from service.store.events import EventType
from service.web.settings import ApiSettings


@pytest.fixture
def control(tmp_path: Path) -> FakeControl:
    settings = RecordingsSettings(reserve_gb=0.0)
    return FakeControl(
        Recordings(tmp_path / "recordings", SOURCE, settings, {"command": "test"}),
        calibrations=open_desk(tmp_path / "desk"),
        diagnosed=Inputs(
            store_dir=tmp_path / "state",
            calibration=tmp_path / "rig.json",
            needs=HostNeeds(
                network=None,
                gate=None,
                spool_dir=tmp_path / "spool",
                spool_bytes=0,
                store_dir=tmp_path / "state",
                min_free_bytes=0,
                workers=1,
            ),
            secrets=frozenset(),
            configuration={},
        ),
    )


@pytest.fixture
async def alarms(store: Store, control: FakeControl) -> Alarms:
    control.alarms = await open_alarms(store, EventLog(store))
    return control.alarms


@pytest.fixture
async def receiver() -> AsyncIterator[Receiver]:
    """Return the endpoint of the webhook `mes`."""
    async with Receiver() as receiver:
        yield receiver


@pytest.fixture
async def webhooks(store: Store, control: FakeControl, receiver: Receiver) -> Webhooks:
    endpoint = WebhookEndpoint(
        name="mes",
        url=f"http://127.0.0.1:{receiver.port}/hook?token=hidden",
        secrets=(SecretStr(SECRET),),
        events=(EventType.LOT_CLOSED,),
    )
    settings = WebhooksSettings(allowed_hosts=("127.0.0.1",), endpoints=(endpoint,), timeout_s=60)
    control.webhooks = await open_webhooks(store, settings)
    return control.webhooks


@pytest.fixture
def again(store: Store, control: FakeControl, tmp_path: Path) -> Iterator[AgainPool]:
    """Return the process in which the fake daemon measures stones again."""
    assert control.calibrations is not None
    pool = AgainPool()
    control.remeasuring = remeasuring_of(store, control.calibrations, pool, tmp_path)
    yield pool
    control.remeasuring.close()


@pytest.fixture
async def client(store: Store, control: FakeControl, again: AgainPool) -> AsyncIterator[httpx.AsyncClient]:
    async with client_of(app_of(store, control, ApiSettings())) as client:
        yield client


@pytest.fixture
def waiting(store: Store, monkeypatch: pytest.MonkeyPatch) -> asyncio.Event:
    """Return an event that is set once a long poll waits for results."""
    event = asyncio.Event()
    wait_while = store.wait_while

    async def observed(is_awaited: Callable[[], bool]) -> None:
        event.set()
        await wait_while(is_awaited)

    monkeypatch.setattr(store, "wait_while", observed)
    return event
