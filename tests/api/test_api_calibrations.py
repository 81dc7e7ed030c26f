"""Calibrations and verifications over REST, with the daemon's own on a folder and a made-up solver."""

import asyncio
from hashlib import sha256
from pathlib import Path

import httpx
import pytest
from support.calibration_desk import CONFIGURED, a_drop, open_desk, other_rig
from support.outcomes import result
from support.rest import FakeControl, app_of, client_of

from pipeline.rig.document import rig_from_document
from service.base.status import AcquisitionState
from service.calibration.verifications import VerificationState
from service.store import Store
from service.web.settings import ApiKey, ApiSettings, Scope

BALL = {"ball_diameters_mm": [10.0], "by": "an engineer", "note": "after the new lens"}
CONFLICT = "urn:stonefall:problem:calibration-conflict"


async def test_from_the_first_drop_to_the_roll_back(client: httpx.AsyncClient, control: FakeControl) -> None:
    begun = await client.post("/calibrations", json=BALL)
    assert (begun.status_code, begun.headers["Location"]) == (201, "/api/v1/calibrations/0002")
    assert begun.json()["state"] == "collecting"
    assert (begun.json()["by"], begun.json()["note"]) == ("an engineer", "after the new lens")
    assert control.calibrations is not None
    assert control.calibrations.collector is not None
    await control.calibrations.collector.add(a_drop(), result(), None)
    collecting = (await client.get("/calibrations/0002")).json()
    assert [drop["views"] for drop in collecting["drops"]] == [["c01"]]
    assert collecting["residuals_before_px"] == {"c01": 2.0}
    assert not collecting["coverage"]["is_sufficient"]
    assert "more drops" in collecting["coverage"]["missing"]
    assert (await client.get("/calibrations/0002/rig.json")).status_code == 404

    assert (await client.post("/calibrations/0002/solve")).status_code == 202
    task = asyncio.create_task(control.calibrations.run())
    while (now := (await client.get("/calibrations/0002")).json())["state"] == "solving":  # noqa: ASYNC110 - a client polls
        await asyncio.sleep(0.001)
    task.cancel()
    await asyncio.wait([task])
    assert (now["state"], now["report"]) == ("solved", {"residuals_after_px": {}})

    accepted = await client.post("/calibrations/0002/accept", json={"by": "the boss"})
    assert (accepted.status_code, accepted.json()["is_active"]) == (200, False)
    active = (await client.post("/calibrations/0002/activate", json={"by": "the boss"})).json()
    assert (active["is_active"], active["calibration_id"]) == (True, other_rig().calibration_id)
    document = (await client.get("/calibrations/0002/rig.json")).json()
    assert rig_from_document(document).calibration_id == active["calibration_id"]
    assert (await client.post("/calibrations/0001/activate")).json()["is_active"]
    known = (await client.get("/calibrations")).json()
    assert [item["id"] for item in known["items"]] == ["0002", "0001"]
    assert known["active"]["calibration_id"] == CONFIGURED.calibration_id
    assert [(each["id"], each["by"]) for each in known["activations"]] == [
        ("0001", None),
        ("0002", "the boss"),
        ("0001", "configuration"),
    ]


async def test_conflicts_say_what_is_possible(client: httpx.AsyncClient, control: FakeControl) -> None:
    control.state = AcquisitionState.HELD
    for path, body in (("/calibrations", BALL), ("/verifications", {})):
        answer = await client.post(path, json=body)
        assert (answer.status_code, answer.json()["type"]) == (409, CONFLICT)
        assert "acquisition is held" in answer.json()["detail"]
    control.state = AcquisitionState.ARMED
    await client.post("/calibrations", json=BALL)
    for path, body in (
        ("/calibrations", BALL),
        ("/verifications", {}),
        ("/calibrations/0002/accept", {}),
        ("/calibrations/0002/activate", {}),
        ("/calibrations/0001/solve", {}),
    ):
        answer = await client.post(path, json=body)
        assert (answer.status_code, answer.json()["type"]) == (409, CONFLICT)
    assert answer.json()["state"] == "accepted"
    assert (await client.post("/calibrations/0002/cancel")).json()["state"] == "cancelled"
    assert (await client.post("/calibrations/0002/cancel")).status_code == 200


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/calibrations", {}),
        ("/calibrations", {"ball_diameters_mm": []}),
        ("/calibrations", {"ball_diameters_mm": [10.0, 11.0]}),
        ("/calibrations", {"ball_diameters_mm": [10.0, 15.0, 20.0]}),
        ("/calibrations", {"ball_diameters_mm": [-1.0]}),
        ("/calibrations", {"ball_diameters_mm": [True]}),
        ("/calibrations", {"ball_diameters_mm": [10.0], "method": "stones"}),
        ("/calibrations", {"ball_diameters_mm": [10.0], "method": "nominal"}),
        ("/calibrations", {"ball_diameters_mm": [10.0], "more": 1}),
        ("/calibrations/0001/activate", {"by": ""}),
        ("/verifications", {"count": 1}),
        ("/verifications", {"count": True}),
        ("/verifications", {"count": "5"}),
        ("/verifications", {"diameter_mm": 0}),
        ("/verifications", {"diameter_mm": 45.1}),
        ("/verifications", {"diameter_mm": 49}),
        ("/verifications", {"diameter_mm": True}),
    ],
)
async def test_wrong_requests(client: httpx.AsyncClient, path: str, body: object) -> None:
    answer = await client.post(path, json=body)
    assert (answer.status_code, answer.json()["type"]) == (422, "urn:stonefall:problem:invalid-request")


async def test_unknown_ones(client: httpx.AsyncClient) -> None:
    for action in ("solve", "accept", "reject", "cancel", "activate"):
        answer = await client.post(f"/calibrations/0099/{action}")
        assert (answer.status_code, answer.json()["type"]) == (
            404,
            "urn:stonefall:problem:unknown-calibration",
        )
    assert (await client.get("/calibrations/0099")).status_code == 404
    for answer in (await client.get("/verifications/0099"), await client.post("/verifications/0099/cancel")):
        assert (answer.status_code, answer.json()["type"]) == (
            404,
            "urn:stonefall:problem:unknown-verification",
        )
    assert (await client.get("/calibrations/..%2F0001")).status_code in (404, 422)


async def test_a_verification_and_its_verdict(client: httpx.AsyncClient, control: FakeControl) -> None:
    begun = await client.post("/verifications", json={"diameter_mm": 15.0, "count": 2})
    assert (begun.status_code, begun.headers["Location"]) == (201, "/api/v1/verifications/0001")
    assert (begun.json()["state"], begun.json()["summary"]) == ("collecting", None)
    assert control.calibrations is not None
    for _ in range(2):
        assert control.calibrations.collector is not None
        record = result(equivalent_diameter_mm=15.2, calibration_id=CONFIGURED.calibration_id)
        await control.calibrations.collector.add(a_drop(), record, None)
    verdict = (await client.get("/verifications/0001")).json()
    assert verdict["state"] == VerificationState.FAILED
    assert verdict["summary"]["error_mm"] == pytest.approx(0.2)
    assert (await client.get("/verifications")).json()["items"] == [verdict]
    assert (await client.post("/verifications/0001/cancel")).json() == verdict
    assert "verification 0001 failed" in str(control.calibrations.facts().trouble)
    chart = (await client.get("/verifications/chart?diameter_mm=15")).json()
    assert (chart["lower_mm"], [point["verification"] for point in chart["points"]]) == (None, ["0001"])
    assert chart["points"][0]["error_mm"] == verdict["summary"]["error_mm"]
    voided = await client.post("/verifications/0001/void", json={"reason": "another ball"})
    assert voided.json()["state"] == "void"
    assert control.calibrations.facts().trouble is None
    assert (await client.get("/verifications/chart")).json()["points"] == []


async def test_who_may_do_what(store: Store, tmp_path: Path) -> None:
    keys = tuple(
        ApiKey(name=scope, sha256=sha256(scope.encode()).hexdigest(), scopes=(Scope.READ, scope))
        for scope in (Scope.READ, Scope.OPERATE)
    )
    control = FakeControl(calibrations=open_desk(tmp_path))
    async with client_of(app_of(store, control, ApiSettings(keys=keys))) as client:
        reader, operator = ({"Authorization": f"Bearer {scope}"} for scope in (Scope.READ, Scope.OPERATE))
        assert (await client.get("/calibrations")).status_code == 401
        assert (await client.get("/calibrations/0001", headers=reader)).status_code == 200
        assert (await client.post("/calibrations", json=BALL, headers=reader)).status_code == 403
        assert (await client.post("/verifications", json={}, headers=reader)).status_code == 403
        assert (await client.post("/calibrations", json=BALL, headers=operator)).status_code == 201
        for action in ("accept", "activate"):
            answer = await client.post(f"/calibrations/0002/{action}", headers=operator)
            assert (answer.status_code, answer.json()["detail"][-11:]) == (403, "'configure'")
        assert (await client.post("/calibrations/0002/cancel", headers=operator)).status_code == 200
