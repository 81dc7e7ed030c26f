"""The overview says what the other resources say, is made once for all who look, and only while somebody does."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.eventually import PATIENCE_S
from support.outcomes import add, measured, rejected, result, trigger
from support.rest import FakeControl, app_of, client_of, particle_files
from support.sent_events import Stream, opened
from support.served import Served, served_by

from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from service.base.errors import StoreError
from service.base.status import AcquisitionState, CheckStatus, HealthCheck
from service.bridge.plant_state import alarms_of, state_of
from service.daemon.overview import overviews
from service.daemon.overview.overview_rows import Rows, overview_rows
from service.health.alarms.alarms import Alarms
from service.lots.lots import LotDefinition, close_lot, complete_lot, open_lot
from service.lots.outcome import LotCompletion
from service.lots.products import ProductDefinition, save_product
from service.store import Store
from service.store.keys import create_key, revoke_key
from service.store.schema import read
from service.web import connections
from service.web.settings import Scope

NOW = datetime.now(UTC).replace(hour=12)
LENGTHS = dict.fromkeys(
    ("sieve_size_mm", "max_feret_mm", "min_feret_mm", "length_mm", "width_mm", "thickness_mm"), 10.0
)
STONE = measured(**LENGTHS, volume_mm3=500.0, volume_sd_percent=0.5, surface_sd_mm=0.02, zingg_class="equant")
LOST = result(outcome="lost", reason="queue_full")
DECISION = {"FI": "flakiness_decision", "SI": "shape_decision"}
PRODUCT = ProductDefinition(
    title="8/16 basalt",
    density_kg_m3=2850.0,
    lower_mm=8.0,
    upper_mm=16.0,
    specification="GC85-20",
    flakiness_category="FI20",
)


@pytest.fixture(autouse=True)
def _is_impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(overviews, "LEAST_S", 0.01)
    monkeypatch.setattr(overviews, "MOST_S", 0.02)
    monkeypatch.setattr(overviews, "FIGURES_S", 0.01)


@pytest.fixture
async def client(store: Store, control: FakeControl, alarms: Alarms) -> AsyncIterator[httpx.AsyncClient]:
    async with client_of(app_of(store, control)) as client:
        yield client


@pytest.fixture
async def served(store: Store, control: FakeControl, alarms: Alarms) -> AsyncIterator[Served]:
    async with served_by(app_of(store, control)) as served:
        yield served
        store.release_waiters()


async def add_at(store: Store, session: int, sequence: int, time: datetime) -> None:
    """Store a stone that fell at a time."""
    fallen = replace(trigger(sequence), utc=rfc3339(time))
    await store.record_triggers(session, {f"{sequence:08d}": fallen})
    await store.finish(session, f"{sequence:08d}", STONE)


async def overview_of(client: httpx.AsyncClient) -> dict[str, Any]:
    await asyncio.sleep(overviews.MOST_S)  # the last one is old enough
    answer = await client.get("/overview")
    assert answer.status_code == 200
    assert answer.headers["Cache-Control"] == "no-store"
    document: dict[str, Any] = answer.json()
    return document


async def looked_at(stream: Stream) -> dict[str, Any]:
    event = await stream.next()
    assert event is not None
    assert (event.event, event.id) == ("overview", None)
    return event.data


async def test_it_says_what_the_other_resources_say(
    client: httpx.AsyncClient,
    store: Store,
    session: int,
    control: FakeControl,
    alarms: Alarms,
    tmp_path: Path,
) -> None:
    files = await asyncio.to_thread(particle_files, tmp_path)
    for sequence, record in enumerate((STONE, rejected("empty"), LOST, STONE)):
        await add(store, session, sequence, record, files if sequence == 0 else None)
    alarms.update({"trigger_line": HealthCheck(status=CheckStatus.FAIL, detail="no image")})  # at once
    control.state = AcquisitionState.ARMED
    control.delays.latest_s.extend([0.2] * 99 + [3.0])
    found = await overview_of(client)
    accounting = (await client.get("/accounting")).json()
    assert found["accounting"] == {name: accounting[name] for name in found["accounting"]}
    assert found["accounting"]["triggers"] == 4
    assert found["today"] == {**dict.fromkeys(found["today"], 0), "in_progress": 0}  # these fell in March
    assert found["stones_per_min"] == 4  # though they fell in March: so do the stones of a replay
    health = control.condition
    for name in ("ne107", "gate_ne107", "rig_ne107", "ready"):
        assert found[name] == getattr(health, name)
    assert found["reasons"] == list(health.reasons)
    cameras = (await client.get("/cameras")).json()["items"]
    assert [(each["id"], each["state"]) for each in found["cameras"]] == [
        (each["id"], each["state"]) for each in cameras
    ]
    listed = (await client.get("/alarms")).json()["items"]
    assert [(each["id"], each["subject"], each["detail"]) for each in found["alarms"]["items"]] == [
        (each["id"], each["check"], each["detail"]) for each in listed
    ]
    assert found["alarms"]["unacknowledged"] == len(listed) > 0
    assert found["alarms"]["urgent"] == sum(each["priority"] == "urgent" for each in listed)
    particles = (await client.get("/particles")).json()["items"]
    assert [each["id"] for each in found["newest"]] == [each["id"] for each in particles]
    assert [each["outcome"] for each in found["newest"]] == ["measured", "lost", "rejected", "measured"]
    assert [each["has_mesh"] for each in found["newest"]] == [False, False, False, True]
    assert found["acquisition"] == {"state": "armed", "trouble": None, "activity": "idle"}
    assert found["latency"] == {"median_ms": 200.0, "p99_ms": pytest.approx(228.0)}
    assert found["queue"] == {"waiting": 3, "max": 16}
    assert (found["last_seq"], found["last_event"]) == (4, store.last_event)
    assert found["verification"] == {"verdict": "never", "age_h": None}


async def test_stones_of_today_and_results_of_the_last_minute_are_counted(store: Store, session: int) -> None:
    times = (NOW - timedelta(days=1), NOW.replace(hour=0, minute=0), NOW - timedelta(seconds=59), NOW)
    known = Rows()
    for sequence, time in enumerate(times):
        await add_at(store, session, sequence, time)
        known = read(store.path, overview_rows, session, NOW, True, known)
        assert known == read(store.path, overview_rows, session, NOW, True, Rows()), (
            "step by step, or at once"
        )
    assert known.accounting_today.measured == 3
    assert known.accounting.measured == 4
    tomorrow = read(store.path, overview_rows, session, NOW + timedelta(days=1), True, known)
    assert tomorrow.accounting_today.measured == 0
    for later, n in (timedelta(0), 4), (timedelta(minutes=1, seconds=1), 0):
        now = datetime.now().astimezone() + later
        assert read(store.path, overview_rows, session, now, True, Rows()).stones_per_min == n


async def test_it_says_whether_images_are_synthetic_or_played(store: Store) -> None:
    for info in ({"is_simulated": True, "is_replay": True}, {"is_replay": True}, {}):
        session = await store.begin_session(info)
        rows = read(store.path, overview_rows, session, NOW, False, Rows())
        assert (rows.is_simulated, rows.is_replay) == ("is_simulated" in info, "is_replay" in info)


@pytest.mark.full
async def test_figures_are_those_of_the_open_lot_else_of_the_last_hour(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    assert (await overview_of(client))["figures"] is None
    await store.write(save_product, "basalt-8-16", PRODUCT, "test")
    await store.write(open_lot, LotDefinition(lot="L1"), "basalt-8-16", None, "test")
    found = await overview_of(client)
    assert (found["lot"]["lot"], found["lot"]["title"], found["lot"]["n_stones"]) == ("L1", "8/16 basalt", 0)
    assert found["figures"] is None
    for sequence in range(3):
        await add(store, session, sequence, STONE)
    figures = await figures_when(client, lambda found: found is not None and found["measured"] == 3)
    gradation = (await client.get("/lots/L1/gradation")).json()
    for name in ("verdict", "is_partial", "countdown", "measured", "n_effective"):
        assert figures[name] == gradation[name], name
    judged = [(step["sieve_mm"], None, step["decision"]) for step in gradation["curve"] if step["decision"]]
    assert judged
    assert [(each["sieve_mm"], each["index"], each["decision"]) for each in figures["decisions"]] == [
        *sorted(judged, reverse=True),
        *((None, name, each) for name in ("FI", "SI") if (each := gradation[DECISION[name]])),
    ]
    assert figures["flakiness_percent"] == gradation["indices"]["flakiness_percent"]
    assert figures["shape_percent"] == gradation["indices"]["shape_percent"]
    (median,) = (each for each in gradation["quantiles"] if each["percent"] == 50)
    assert figures["d50_mm"] == median["exact_mm"]
    passing = {step["sieve_mm"]: step["passing_percent"] for step in gradation["curve"]}
    assert figures["passing"] == [
        {"end": end, "sieve_mm": sieve_mm, "percent": passing[sieve_mm]}
        for end, sieve_mm in (("lower", 8.0), ("upper", 16.0))
    ]
    assert found["last_lot"] is None
    await add(store, session, 4, rejected("empty"))  # which changes no curve
    await overview_of(client)
    assert (await overview_of(client))["figures"]["version"] == figures["version"]
    await add(store, session, 5, STONE.model_copy(update={"sieve_size_mm": 12.0, "volume_mm3": 900.0}))
    changed = await figures_when(client, lambda found: found["measured"] == 4)
    assert changed["version"] != figures["version"]
    await store.write(close_lot, "L1", None, "test")
    found = await overview_of(client)
    assert (found["lot"], found["figures"]) == (None, None)  # these stones did not fall within the last hour
    assert (found["last_lot"]["lot"], found["last_lot"]["completion"]) == ("L1", None)
    said = {
        "verdict": "conforms",
        "is_partial": False,
        "measured": 4,
        "rejected": 1,
        "lost": 0,
        "revision": 1,
    }
    completion = LotCompletion(**said, at=utc_now(), report="/r", report_sha256="0" * 64)
    await store.write(complete_lot, "L1", completion, {})
    assert (await overview_of(client))["last_lot"]["completion"]["verdict"] == "conforms"
    await add_at(store, session, 6, datetime.now(UTC))
    assert (await figures_when(client, lambda found: found is not None))["lot"] is None


async def figures_when(client: httpx.AsyncClient, is_so: Any) -> dict[str, Any]:
    """Return the figures as soon as they are so."""
    async with asyncio.timeout(PATIENCE_S):
        while not is_so(figures := (await overview_of(client))["figures"]):
            pass
    found: dict[str, Any] = figures
    return found


async def test_a_stream_sends_it_at_once_and_whenever_it_is_another_one(
    served: Served, store: Store, session: int
) -> None:
    stream = await opened(served, "/overview/stream")
    head = (await stream.head()).lower()
    assert "content-type: text/event-stream" in head
    assert "cache-control: no-cache" in head
    assert (await looked_at(stream))["last_seq"] == 0
    for sequence in range(1, 4):
        await add(store, session, sequence, STONE)
        while (found := await looked_at(stream))["last_seq"] < sequence:
            pass
        assert len(found["newest"]) == found["accounting"]["measured"] == sequence


async def test_one_that_does_not_change_comes_again(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(overviews, "REPEAT_S", 0.3)
    stream = await opened(served, "/overview/stream")
    await stream.head()
    first, second, third = [await looked_at(stream) for _ in range(3)]
    between = datetime.fromisoformat(third["at"]) - datetime.fromisoformat(second["at"])
    assert between >= timedelta(seconds=0.25)
    assert {**first, "at": None} == {**third, "at": None}


@pytest.mark.full
async def test_all_who_look_share_one_and_nobody_else_has_it_made(
    served: Served, store: Store, session: int, control: FakeControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(overviews, "LEAST_S", 0.4)
    monkeypatch.setattr(overviews, "MOST_S", 0.5)
    n_made = 0
    facts = control.facts

    def counted() -> Any:
        nonlocal n_made
        n_made += 1
        return facts()

    monkeypatch.setattr(control, "facts", counted)
    streams = [await opened(served, "/overview/stream") for _ in range(20)]
    for stream in streams:
        await stream.head()
        await looked_at(stream)
    await add(store, session, 1, STONE)
    for stream in streams:
        while (await looked_at(stream))["last_seq"] != 1:
            pass
    assert n_made <= 8
    for stream in streams:
        stream.client.writer.close()
    await served.until(lambda: not served.connections)
    await asyncio.sleep(2 * overviews.MOST_S)  # what was begun is ended
    n_made = 0
    await asyncio.sleep(3 * overviews.MOST_S)
    assert n_made == 0


async def test_streams_end_with_the_daemon_and_with_the_key(
    store: Store, session: int, control: FakeControl, alarms: Alarms
) -> None:
    _, token = create_key(store.dir, "wall", (Scope.READ,), None, "root")
    _, other = create_key(store.dir, "office", (Scope.READ,), None, "root")
    async with served_by(app_of(store, control)) as served:
        assert (await (await opened(served, "/overview/stream")).head()).startswith("HTTP/1.1 401")
        wall, office = [
            await opened(served, "/overview/stream", f"Authorization: Bearer {each}\r\n")
            for each in (token, other)
        ]
        for stream in (wall, office):
            await stream.head()
            await looked_at(stream)
        revoke_key(store.dir, "wall", "root")
        await add(store, session, 1, STONE)
        while (event := await wall.next()) is not None and event.event == "overview":
            pass
        assert event is not None
        assert (event.event, event.data["status"]) == ("problem", 401)
        assert await wall.next() is None
        store.release_waiters()
        while await office.next() is not None:
            pass


async def test_streams_leave_connections_to_everything_else(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "max_connections", lambda: 8)
    held = [await opened(served, "/overview/stream") for _ in range(2)]
    for stream in held:
        assert (await stream.head()).startswith("HTTP/1.1 200")
    assert (await (await opened(served, "/overview/stream")).head()).startswith("HTTP/1.1 503")


async def test_while_the_store_cannot_be_read_it_goes_on_with_what_was_read(
    client: httpx.AsyncClient, store: Store, session: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    await add(store, session, 1, STONE)
    before = await overview_of(client)

    async def fail(*_: Any) -> Any:
        raise StoreError("the disk is gone")

    monkeypatch.setattr(store, "read", fail)
    after = await overview_of(client)
    assert after["at"] > before["at"]
    assert {**after, "at": None} == {**before, "at": None}


async def test_figures_of_many_stones_are_asked_for_less_often(
    store: Store, session: int, control: FakeControl, alarms: Alarms
) -> None:
    asked_s: list[float] = []

    class SlowReading:
        async def run(self, function: Any, *arguments: object) -> Any:
            asked_s.append(asyncio.get_running_loop().time())
            await asyncio.sleep(0.1)
            return await asyncio.to_thread(function, *arguments)

    async with client_of(app_of(store, control, reading=SlowReading())) as client:
        while len(asked_s) < 2:
            await overview_of(client)
    assert asked_s[1] - asked_s[0] >= 0.1 / overviews.FIGURES_SHARE


async def test_the_bridge_understands_it(
    client: httpx.AsyncClient, store: Store, session: int, alarms: Alarms
) -> None:
    """What control systems see is read from it: a field that is renamed here would be missed there."""
    alarms.update({"trigger_line": HealthCheck(status=CheckStatus.FAIL, detail="no image")})  # at once
    for lot in ("L1", "L2"):
        await store.write(save_product, "basalt-8-16", PRODUCT, "test")
        await store.write(open_lot, LotDefinition(lot=lot), "basalt-8-16", None, "test")
        await add(store, session, len(lot) + (lot == "L2"), STONE)
        if lot == "L1":
            await store.write(close_lot, lot, None, "test")
    await figures_when(client, lambda found: found is not None and found["lot"] == "L2")
    overview = await overview_of(client)
    (alarm,) = (await client.get("/alarms")).json()["items"]
    state = state_of(overview, alarms_of({"items": [alarm]}))
    assert (state.lot, state.product, state.product_title) == ("L2", "basalt-8-16", "8/16 basalt")
    assert (state.n_stones, state.measured, state.last_seq, state.last_lot) == (1, 2, 2, "L1")
    assert (state.verdict, state.acquisition) == ("insufficient", overview["acquisition"]["state"])
    assert state.d50_mm is not None
    assert state.d50_mm.value == overview["figures"]["d50_mm"]["value"]
    assert set(state.components) == {"gate", "rig", *(camera["id"] for camera in overview["cameras"])}
    assert [(each.id, each.check, each.state) for each in state.alarms] == [
        (alarm["id"], "trigger_line", "unacknowledged")
    ]
