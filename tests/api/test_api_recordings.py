"""Recordings over REST, with the daemon's own recorder on a folder."""

from hashlib import sha256
from pathlib import Path

import httpx
import pytest
from support.recordings import SOURCE, make_bundle
from support.rest import FakeControl, app_of, client_of

from service.recording.recordings import Recordings, RecordingsSettings
from service.store import Store
from service.web.settings import ApiKey, ApiSettings


async def test_record_and_stop(client: httpx.AsyncClient, control: FakeControl) -> None:
    control.recordings.offer(make_bundle(1))
    answer = await client.post("/recordings", json={"name": "test-1", "count": 10, "pre_trigger": 1})
    assert (answer.status_code, answer.headers["Location"]) == (201, "/api/v1/recordings/test-1")
    assert (answer.json()["state"], answer.json()["ended_by"]) == ("recording", None)

    busy = await client.post("/recordings", json={"name": "test-2", "duration_s": 5})
    assert (busy.status_code, busy.json()["type"]) == (409, "urn:stonefall:problem:recording-running")

    control.recordings.offer(make_bundle(2))
    stopped = await client.post("/recordings/test-1/stop")
    assert stopped.status_code == 200
    document = stopped.json()
    assert (document["state"], document["ended_by"], document["bundles"]) == ("complete", "stop", 2)
    assert document["made_by"]["pre_trigger"] == 1
    assert document["bytes"] > 0
    assert (await client.post("/recordings/test-1/stop")).json() == document
    assert (await client.get("/recordings/test-1")).json() == document
    assert (await client.get("/recordings")).json() == {"items": [document]}

    taken = await client.post("/recordings", json={"name": "test-1", "count": 1})
    assert (taken.status_code, taken.json()["type"]) == (409, "urn:stonefall:problem:recording-exists")


async def test_no_room(store: Store, tmp_path: Path) -> None:
    control = FakeControl(Recordings(tmp_path / "full", SOURCE, RecordingsSettings(reserve_gb=100_000.0), {}))
    async with client_of(app_of(store, control, ApiSettings())) as client:
        answer = await client.post("/recordings", json={"name": "large", "count": 1})
        assert (answer.status_code, answer.json()["type"]) == (507, "urn:stonefall:problem:no-room")
        assert "make room" in answer.json()["detail"]


@pytest.mark.parametrize(
    "body",
    [
        {"name": "endless"},
        {"count": 1},
        {"name": "../up", "count": 1},
        {"name": ".hidden", "count": 1},
        {"name": "a/b", "count": 1},
        {"name": "newline\n", "count": 1},
        {"name": "a", "count": 0},
        {"name": "a", "count": True},
        {"name": "a", "duration_s": True},
        {"name": "a", "count": 1, "pre_trigger": True},
        {"name": "a", "duration_s": 0},
        {"name": "a", "duration_s": 1e9},
        {"name": "a", "count": 1, "pre_trigger": -1},
        {"name": "a", "count": 1, "kind": "ball"},
    ],
)
async def test_wrong_requests(client: httpx.AsyncClient, body: object) -> None:
    assert (await client.post("/recordings", json=body)).status_code == 422
    assert (await client.get("/recordings")).json() == {"items": []}


async def test_unknown_ones(client: httpx.AsyncClient) -> None:
    for answer in (await client.get("/recordings/r9"), await client.post("/recordings/r9/stop")):
        assert (answer.status_code, answer.json()["type"]) == (404, "urn:stonefall:problem:unknown-recording")
    assert (await client.get("/recordings/..%2Fstate")).status_code in (404, 422)


async def test_reading_is_not_recording(store: Store, control: FakeControl) -> None:
    keys = (ApiKey(name="reader", sha256=sha256(b"token").hexdigest()),)
    async with client_of(app_of(store, control, ApiSettings(keys=keys))) as client:
        headers = {"Authorization": "Bearer token"}
        assert (await client.get("/recordings", headers=headers)).status_code == 200
        for path in ("/recordings", "/recordings/r1/stop"):
            answer = await client.post(path, json={"name": "r1", "count": 1}, headers=headers)
            assert answer.status_code == 403
