"""Health, acquisition, cameras and accounting over REST."""

from importlib.metadata import version

import cv2
import httpx
import numpy as np
import pytest
from support.outcomes import add, measured, rejected, trigger
from support.rest import SICK_HEALTH, FakeControl

from service.base.status import TRANSITIONS, AcquisitionState, AcquisitionTarget, ConflictError, next_state
from service.health.routes import HealthDocument
from service.results.version import ALGORITHM_VERSION
from service.store import Store
from service.web.version import API_VERSION


async def test_live_does_not_ask_the_daemon(client: httpx.AsyncClient, control: FakeControl) -> None:
    control.condition = SICK_HEALTH
    answer = await client.get("/health/live")
    assert (answer.status_code, answer.json()) == (200, {"status": "pass"})


async def test_ready_or_why_not(client: httpx.AsyncClient, control: FakeControl) -> None:
    assert (await client.get("/health/ready")).json() == {"ready": True}
    control.condition = SICK_HEALTH
    answer = await client.get("/health/ready")
    assert (answer.status_code, answer.headers["Retry-After"]) == (503, "5")
    assert answer.json()["type"] == "urn:stonefall:problem:not-ready"
    assert answer.json()["reasons"] == ["camera c02 is lost"]


async def test_health_in_detail(client: httpx.AsyncClient, control: FakeControl, store: Store) -> None:
    good = (await client.get("/health")).json()
    assert (good["status"], good["ne107"], good["instance_id"]) == ("pass", "good", store.instance_id)
    assert good["checks"]["camera:c01"] == {
        "status": "pass",
        "observed_value": 0.2,
        "observed_unit": "s",
        "detail": None,
    }
    control.condition = SICK_HEALTH
    answer = await client.get("/health")
    sick = HealthDocument.model_validate(answer.json())
    assert (answer.status_code, sick.status, sick.ready, sick.ne107) == (200, "fail", False, "failure")
    assert sick.checks["camera:c02"].detail == "does not answer"


async def test_health_names_release_interface_and_algorithm_apart(client: httpx.AsyncClient) -> None:
    health = (await client.get("/health")).json()
    named = [health[name] for name in ("release", "api_version", "algorithm_version")]
    assert named == [version("stonefall"), API_VERSION, ALGORITHM_VERSION]
    assert health["version"] == API_VERSION  # of clients that know no other


async def test_arm_and_disarm(client: httpx.AsyncClient, control: FakeControl) -> None:
    rig = (await client.get("/acquisition")).json()
    assert (rig["state"], rig["cameras"], rig["activity"]) == ("disarmed", 3, "idle")
    for state in ("armed", "armed", "disarmed"):
        answer = await client.put("/acquisition", json={"state": state})
        assert (answer.status_code, answer.json()["state"]) == (200, state)
    control.state = AcquisitionState.DISARMING
    answer = await client.put("/acquisition", json={"state": "armed"})
    assert (answer.status_code, answer.json()["type"]) == (409, "urn:stonefall:problem:transition-conflict")
    assert (answer.json()["current"], answer.json()["target"]) == ("disarming", "armed")


@pytest.mark.parametrize("body", [{"state": "held"}, {"state": None}, {}, {"state": "armed", "for_s": 5}, []])
async def test_only_two_states_can_be_asked_for(client: httpx.AsyncClient, body: object) -> None:
    assert (await client.put("/acquisition", json=body)).status_code == 422


def test_transitions_lead_to_what_was_asked_for() -> None:
    leads_to = {
        AcquisitionTarget.ARMED: {AcquisitionState.ARMING, AcquisitionState.ARMED, AcquisitionState.HELD},
        AcquisitionTarget.DISARMED: {AcquisitionState.DISARMING, AcquisitionState.DISARMED},
    }
    for (current, target), state in TRANSITIONS.items():
        assert state in leads_to[target]
        assert next_state(state, target) == state  # asking again changes nothing
        assert next_state(current, target) == state
    with pytest.raises(ConflictError, match="stopping"):
        next_state(AcquisitionState.STOPPING, AcquisitionTarget.DISARMED)


async def test_cameras(client: httpx.AsyncClient, control: FakeControl) -> None:
    cameras = (await client.get("/cameras")).json()["items"]
    assert [camera["id"] for camera in cameras] == ["c01", "c02", "c03"]
    assert (await client.get("/cameras/c02")).json() == cameras[1]
    assert cameras[1]["frames"] == 7
    for path in ("/cameras/c99", "/cameras/c99/snapshot.png"):
        assert (await client.get(path)).json()["type"] == "urn:stonefall:problem:unknown-camera"

    none_yet = await client.get("/cameras/c02/snapshot.png")
    assert (none_yet.status_code, none_yet.json()["type"]) == (404, "urn:stonefall:problem:not-kept")
    control.images["c02"] = np.arange(48, dtype=np.uint8).reshape(6, 8)
    answer = await client.get("/cameras/c02/snapshot.png")
    assert (answer.headers["Content-Type"], answer.headers["Cache-Control"]) == ("image/png", "no-store")
    image = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(image, control.images["c02"])


async def test_all_cameras_in_one_picture(client: httpx.AsyncClient, control: FakeControl) -> None:
    control.images["c02"] = np.full((480, 640), 250, np.uint8)
    answer = await client.get("/cameras/contact-sheet.jpg")
    assert (answer.headers["Content-Type"], answer.headers["Cache-Control"]) == ("image/jpeg", "no-store")
    sheet = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_UNCHANGED)
    assert sheet.shape == (240, 4 * 320)  # as all cameras, and as four a row
    greys = [np.median(sheet[:, left : left + 320]) for left in range(0, 4 * 320, 320)]
    np.testing.assert_allclose(greys, [128, 250, 128, 128], atol=3)
    control.images["c03"] = control.images["c02"]
    again = await client.get("/cameras/contact-sheet.jpg")
    assert again.content == answer.content  # made once for all who ask at about the same time


async def test_accounting(client: httpx.AsyncClient, store: Store, session: int) -> None:
    await add(store, session, 1, measured())
    await add(store, session, 2, rejected("clipped"))
    latest = await store.begin_session({"is_replay": True})
    await store.record_triggers(latest, {"open": trigger(3)})
    assert (await client.get("/accounting")).json() == {
        "session": None,
        "triggers": 3,
        "measured": 1,
        "rejected": 1,
        "lost": 0,
        "in_progress": 1,
        "is_balanced": True,
        "backgrounds": 0,
        "by_reason": {"clipped": 1},
        "by_quality": {"good": 1},
    }
    current = (await client.get("/accounting?session=current")).json()
    assert (current["session"], current["triggers"], current["measured"]) == (latest, 1, 0)
    assert (await client.get(f"/accounting?session={session}")).json()["triggers"] == 2
    assert (await client.get("/accounting?session=last")).status_code == 422


async def test_a_camera_shows_itself(client: httpx.AsyncClient, control: FakeControl, store: Store) -> None:
    answer = await client.post("/cameras/c02/identify", json={"seconds": 5})
    assert answer.status_code == 200
    assert answer.json() == {
        "id": "c02",
        "seconds": 5,
        "serial": "SIM-c02",
        "model": "SF-1280",
        "address": "127.0.0.2",
    }
    assert control.shown == [("c02", 5)]
    (noted,) = (await client.get("/audit")).json()["items"]
    assert (noted["action"], noted["subject"]) == ("camera identified", "c02")


async def test_a_camera_that_cannot_show_itself_says_why(
    client: httpx.AsyncClient, control: FakeControl
) -> None:
    answer = await client.post("/cameras/c03/identify", json={})
    assert (answer.status_code, answer.json()["type"]) == (503, "urn:stonefall:problem:camera-unavailable")
    assert (answer.json()["detail"], answer.json()["cause"]) == ("c03: does not answer", "silent")
    control.state = AcquisitionState.ARMED
    answer = await client.post("/cameras/c02/identify", json={"seconds": 5})
    assert (answer.status_code, answer.json()["type"]) == (409, "urn:stonefall:problem:not-disarmed")
    assert answer.json()["current"] == "armed"
    assert (await client.post("/cameras/c99/identify", json={})).status_code == 404
    for seconds in (0, 61, "5", True):
        assert (await client.post("/cameras/c02/identify", json={"seconds": seconds})).status_code == 422
    assert control.shown == []
