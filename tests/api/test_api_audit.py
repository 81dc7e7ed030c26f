"""Every write over REST is in the audit: who, what, before, after."""

import csv
import hashlib
import json
import sqlite3
from contextlib import closing
from io import StringIO
from pathlib import Path
from typing import Any

import httpx
import pytest
from support.calibration_desk import a_drop, solve
from support.outcomes import add, measured, result
from support.recordings import make_bundle
from support.remeasuring import AgainPool, add_old
from support.rest import FakeControl, app_of, client_of

from service.base.status import AcquisitionState, CheckStatus, HealthCheck
from service.daemon.rest.app import build_routes
from service.health.alarms.alarms import Alarms
from service.store import Store
from service.store.audit import COLUMNS, note
from service.web.routes.audit import PAGE
from service.web.settings import ApiKey, ApiSettings, Scope
from service.web.version import BASE

READING = {"get"}
NOT_NOTED = {
    ("POST", "/reports/verify"): "it changes nothing: a file is too large for an address",
    ("POST", "/session/pairing"): "a screen asks for a code, which opens nothing",
    ("POST", "/tables"): "it changes nothing: a file is read back as the table in it",
    ("PUT", "/consumers/{name}/cursor"): "a reader parks its own place after every page",
    ("POST", "/particles/{particle_id}/revisions/orders"): "a folder on tmpfs; what comes of it is noted",
}
"""Routes that write and leave no entry, each with the reason."""
KEY = ApiKey(name="boss", sha256=hashlib.sha256(b"token").hexdigest(), scopes=tuple(Scope))
PRODUCT = {"title": "8/16 basalt", "density_kg_m3": 2700, "lower_mm": 8, "upper_mm": 16}
BALL = {"ball_diameters_mm": [10.0]}


def stone(size_mm: float) -> dict[str, Any]:
    names = ("sieve_size_mm", "length_mm", "width_mm", "thickness_mm", "max_feret_mm", "min_feret_mm")
    sds = {"volume_sd_percent": 0.5, "surface_sd_mm": 0.02}
    return measured(volume_mm3=0.6 * size_mm**3, **dict.fromkeys(names, size_mm), **sds)


class Writing:
    """A client that notes which routes it has written to, and looks for the entry of each write."""

    def __init__(self, client: httpx.AsyncClient) -> None:
        self._client = client
        self.written: set[tuple[str, str]] = set()

    async def __call__(
        self, method: str, path: str, body: Any, action: str, subject: str, **names: str
    ) -> dict[str, Any]:
        """Write, and return the entry that this has left."""
        known = (await self.entries())[-1:]
        answer = await self._client.request(method, path.format(**names), json=body)
        assert answer.status_code < 300, answer.text
        new = await self.entries(after=known[0]["entry"] if known else 0)
        assert [(each["who"], each["action"], each["subject"]) for each in new] == [
            ("key boss", action, subject)
        ]
        self.written.add((method, path))
        return dict(new[0])

    async def entries(self, after: int = 0) -> list[dict[str, Any]]:
        return list((await self._client.get(f"/audit?after={after}&limit=1000")).json()["items"])


async def write_everything(
    write: Writing, control: FakeControl, store: Store, session: int, tmp_path: Path
) -> None:
    assert control.recordings is not None
    assert control.calibrations is not None
    desk = control.calibrations
    armed = await write("PUT", "/acquisition", {"state": "armed"}, "acquisition armed", "rig")
    assert (armed["before"], armed["after"]) == ({"state": "disarmed"}, {"state": "armed"})

    control.recordings.offer(make_bundle(1))
    body = {"name": "r1", "count": 9, "pre_trigger": 1}
    started = await write("POST", "/recordings", body, "recording started", "r1")
    assert (started["before"], started["after"]["count"]) == (None, 9)
    stopped = await write("POST", "/recordings/{name}/stop", None, "recording stopped", "r1", name="r1")
    assert (stopped["before"]["state"], stopped["after"]["state"]) == ("recording", "complete")
    deleted = await write("DELETE", "/recordings/{name}", None, "recording deleted", "r1", name="r1")
    assert (deleted["before"]["bundles"], deleted["after"]) == (1, None)

    await write("PUT", "/products/{product}", PRODUCT, "product", "basalt", product="basalt")
    limits = {"limits": {"d50_mm": {"centre": 11.2, "sd": 0.2}}}
    await write("PUT", "/products/{product}/control", limits, "control limits", "basalt", product="basalt")
    lot = {"lot": "L1", "product": "basalt"}
    await write("POST", "/lots", lot, "lot opened", "L1")
    for sequence in range(1, 30):
        await add(store, session, sequence, stone(8.0 + sequence / 4))
    sieving = {"retained_g": {"12.5": 40.0, "10": 30.0}, "pan_g": 30.0}
    await write("POST", "/lots/{lot}/sieving", sieving, "sieving", "L1", lot="L1")
    history = {"table": "Lot;Sieve mm;g\nL1;12.5;40\nL1;10;30\nL1;pan;30"}
    await write("POST", "/sievings", history, "sieving", "L1")
    study = {"form": "factor"}
    await write("POST", "/products/{product}/correlations", study, "correlation", "basalt", product="basalt")
    studies = "/products/{product}/correlations/{version}/"
    of = {"product": "basalt", "version": "1"}
    await store.write(
        lambda connection: connection.execute("UPDATE correlations SET obstacles = '[]'") and None
    )
    taken = await write("POST", f"{studies}accept", None, "correlation accepted", "basalt", **of)
    assert (taken["before"]["state"], taken["after"]["accepted_by"]) == ("draft", "key boss")
    why = {"reason": "new screens"}
    taken = await write("POST", f"{studies}withdraw", why, "correlation withdrawn", "basalt", **of)
    assert (taken["before"]["state"], taken["after"]["reason"]) == ("accepted", "new screens")
    path, why = "/lots/{lot}/sieving/{sieving}/void", {"reason": "another portion"}
    voided = await write("POST", path, why, "sieving voided", "L1", lot="L1", sieving="1")
    assert (voided["before"]["voided_at"], voided["after"]["void_reason"]) == (None, "another portion")
    times = {"since": "2026-01-01T00:00:00Z", "until": "2026-01-02T00:00:00Z"}
    await write("POST", "/lots/{lot}/assign", times, "stones assigned", "L1", lot="L1")
    await write("POST", "/lots/{lot}/close", {}, "lot closed", "L1", lot="L1")
    await write("POST", "/lots/{lot}/void", {"reason": "wrong belt"}, "lot voided", "L1", lot="L1")

    liner = {"kind": "liner", "text": "turned"}
    assert (await write("POST", "/diary", liner, "diary noted", "1"))["after"]["who"] == "key boss"
    await write("POST", "/events", {"kind": "gap", "value": 25}, "diary noted", "2")

    pin = {"is_pinned": True, "reason": "dispute"}
    pinned = await write("PUT", "/particles/{particle_id}/pin", pin, "particle pinned", "1", particle_id="1")
    assert (pinned["before"], pinned["after"]) == (None, {"reason": "dispute"})

    name = await add_old(store, session, 30, tmp_path, desk.rig_file.calibration_id)
    route = "/particles/{particle_id}/revisions"
    again = await write("POST", route, {}, "particle remeasured", name, particle_id=name)
    assert (again["before"]["seq"], again["after"]["revision"]) == (30, 2)

    opened = await write("POST", "/calibrations", BALL, "calibration opened", "0002")
    assert opened["after"]["state"] == "collecting"
    acts = "/calibrations/{calibration}/"
    solving = await write("POST", f"{acts}solve", None, "calibration solving", "0002", calibration="0002")
    assert (solving["before"]["state"], solving["after"]["state"]) == ("collecting", "solving")
    await solve(desk, "0002")
    await write("POST", f"{acts}accept", {"by": "Ann"}, "calibration accepted", "0002", calibration="0002")
    used = await write("POST", f"{acts}activate", None, "calibration activated", "0002", calibration="0002")
    assert (used["before"]["id"], used["after"]["id"]) == ("0001", "0002")
    await write("POST", "/calibrations", BALL, "calibration opened", "0003")
    await solve(desk, "0003")
    await write("POST", f"{acts}reject", None, "calibration rejected", "0003", calibration="0003")
    await write("POST", "/calibrations", BALL, "calibration opened", "0004")
    await write("POST", f"{acts}cancel", None, "calibration cancelled", "0004", calibration="0004")

    verify = "/verifications/{verification}/"
    await write("POST", "/verifications", {"count": 2}, "verification begun", "0001")
    await write("POST", f"{verify}cancel", None, "verification cancelled", "0001", verification="0001")
    await write("POST", "/verifications", {"count": 2}, "verification begun", "0002")
    for _ in range(2):
        assert desk.collector is not None
        ball = result(equivalent_diameter_mm=15.0, calibration_id=desk.rig_file.calibration_id)
        await desk.collector.add(a_drop(), ball, None)
    why = {"reason": "another ball"}
    void = await write("POST", f"{verify}void", why, "verification voided", "0002", verification="0002")
    assert (void["before"]["state"], void["after"]["state"]) == ("passed", "void")


async def write_alarms(write: Writing, alarms: Alarms) -> None:
    failed = HealthCheck(status=CheckStatus.FAIL, detail="no camera exposes")
    alarms.update({"trigger_line": failed})  # an alarm at once
    number, line = {"alarm": "1"}, "trigger_line"
    known = await write("POST", "/alarms/{alarm}/acknowledge", None, "alarm acknowledged", line, **number)
    assert (known["before"]["state"], known["after"]["state"]) == ("unacknowledged", "acknowledged")
    body = {"minutes": 60, "reason": "spare part is ordered"}
    await write("POST", "/alarms/{alarm}/shelve", body, "alarm shelved", line, **number)
    back = await write("POST", "/alarms/{alarm}/unshelve", None, "alarm unshelved", line, **number)
    assert (back["before"]["state"], back["after"]["state"]) == ("shelved", "unacknowledged")


async def write_webhooks(write: Writing) -> None:
    path, mes = "/webhooks/{webhook}/", {"webhook": "mes"}
    tested = await write("POST", f"{path}test", None, "webhook tested", "mes", **mes)
    assert (tested["before"], tested["after"]["status"]) == (None, 204)
    await write("POST", f"{path}enable", None, "webhook enabled", "mes", **mes)
    again = await write("POST", f"{path}replay", {"after": 1}, "webhook replayed", "mes", **mes)
    assert (again["before"]["after"], again["after"]["after"]) == (0, 1)
    await write("POST", f"{path}resend", {"event": 1}, "webhook event sent again", "mes", **mes)

    url = "http://127.0.0.1:9/hook/hidden"
    made, erp = "/webhooks/{webhook}", {"webhook": "erp"}
    defined = await write("PUT", made, {"url": url}, "webhook defined", "erp", **erp)
    assert "hidden" not in json.dumps(defined)
    await write("PUT", f"{made}/secret", {}, "webhook secret rotated", "erp", **erp)
    await write("DELETE", f"{made}/secret", None, "webhook rotation ended", "erp", **erp)
    await write("DELETE", made, None, "webhook removed", "erp", **erp)


async def write_by_browser(write: Writing, client: httpx.AsyncClient) -> None:
    """Sign in, have a camera's lamp blink with the cookie, and sign out; the key itself looks for the last entry."""
    begun = (await client.post("/session/pairing")).json()
    wall = {"name": "silo-2", "role": "display"}
    confirm = "/pairings/{code}/confirm"
    await write("POST", confirm, wall, "screen paired", "silo-2", code=begun["code"])
    n_entries = len(await write.entries())
    assert (await client.post("/session/pairing/claim", json={"secret": begun["secret"]})).json()[
        "is_signed_in"
    ]
    client.cookies.clear()
    (claimed,) = (await write.entries())[n_entries:]
    assert (claimed["who"], claimed["action"]) == ("key silo-2", "session begun")
    write.written.add(("POST", "/session/pairing/claim"))
    await write("POST", "/session", {"token": "token"}, "session begun", "boss")
    key = client.headers.pop("Authorization")
    client.headers["Origin"] = "http://127.0.0.1:8080"
    path = "/cameras/{camera}/identify"
    await write("POST", path, {"seconds": 5}, "camera identified", "c02", camera="c02")
    assert (await client.delete("/session")).status_code == 204
    client.headers["Authorization"] = key
    last = (await write.entries())[-1]
    assert (last["who"], last["action"], last["subject"]) == ("key boss", "session ended", "boss")
    write.written.add(("DELETE", "/session"))


@pytest.mark.usefixtures("webhooks")
async def test_every_route_that_writes_leaves_an_entry(
    store: Store, session: int, control: FakeControl, alarms: Alarms, again: AgainPool, tmp_path: Path
) -> None:
    async with client_of(app_of(store, control, ApiSettings(keys=(KEY,)))) as client:
        client.headers["Authorization"] = "Bearer token"
        write = Writing(client)
        await write_everything(write, control, store, session, tmp_path)
        assert len(again.jobs) == 1
        await write_webhooks(write)
        await write_alarms(write, alarms)
        n_entries = len(await write.entries())
        assert (await client.put("/consumers/mes/cursor", json={"after": 1})).status_code == 200
        assert len(await write.entries()) == n_entries
        await write("DELETE", "/consumers/{name}", None, "consumer deleted", "mes", name="mes")
        control.state = AcquisitionState.DISARMED
        await write_by_browser(write, client)
    routes = {
        (method.upper(), path.removeprefix(BASE))
        for path, methods in build_routes().openapi()["paths"].items()
        for method in methods.keys() - READING
    }
    assert routes == write.written | NOT_NOTED.keys()


async def test_what_changes_nothing_and_what_is_refused_leaves_no_entry(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await add(store, session, 1, measured())
    await client.put("/acquisition", json={"state": "armed"})
    await client.put("/particles/1/pin", json={"is_pinned": True, "reason": "why"})
    before = (await client.get("/audit")).json()["items"]
    for method, path, body in (
        ("PUT", "/acquisition", {"state": "armed"}),
        ("PUT", "/acquisition", {"state": "held"}),
        ("PUT", "/particles/1/pin", {"is_pinned": True, "reason": "why"}),
        ("DELETE", "/consumers/nobody", None),
        ("DELETE", "/recordings/none", None),
        ("POST", "/recordings/none/stop", None),
        ("POST", "/calibrations/0001/accept", None),
        ("POST", "/calibrations/0001/activate", None),
        ("POST", "/calibrations/0009/cancel", None),
        ("POST", "/verifications/0009/void", {"reason": "why"}),
    ):
        await client.request(method, path, json=body)
    assert (await client.get("/audit")).json()["items"] == before
    assert [(each["who"], each["action"]) for each in before] == [
        ("this machine", "acquisition armed"),
        ("this machine", "particle pinned"),
    ]


@pytest.mark.full
async def test_the_export_is_whole_in_order_and_can_be_checked(
    client: httpx.AsyncClient, store: Store
) -> None:
    assert (await client.get("/audit.csv")).text == f"{','.join(COLUMNS)}\r\n"
    n = PAGE + 2
    for number in range(n):
        await store.write(note, "key mes", "lot opened", "＝L", after={"remark": f'"{number}", ö\r\n'})
    answer = await client.get("/audit.csv")
    assert answer.headers["Content-Type"].startswith("text/csv")
    rows = list(csv.reader(StringIO(answer.text, newline="")))
    assert (tuple(rows[0]), len(rows)) == (COLUMNS, n + 1)
    digest = ""
    for number, (entry, at, who, action, subject, before, after, kept) in enumerate(rows[1:], start=1):
        assert (int(entry), before, subject) == (number, "", "'＝L")  # no spreadsheet computes it
        row = [number, at, who, action, subject[1:], None, after]
        text = digest + json.dumps(row, ensure_ascii=False)
        digest = hashlib.sha256(text.encode()).hexdigest()
        assert kept == digest
    part = (await client.get(f"/audit.csv?after={n - 1}")).text
    assert part.startswith(f"{n},")
    assert answer.text.endswith(part)
    assert (await client.get("/audit.csv?subject=none")).text == f"{','.join(COLUMNS)}\r\n"


async def test_while_the_disk_refuses_the_rig_is_disarmed_at_once_and_noted_later(
    client: httpx.AsyncClient,
    control: FakeControl,
    store: Store,
    state_dir: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    control.state = AcquisitionState.ARMED
    with closing(sqlite3.connect(state_dir / "results.sqlite", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        answer = await client.put("/acquisition", json={"state": "disarmed"})
        assert (answer.status_code, control.state) == (200, "disarmed")
        assert store.trouble is not None
        await client.put("/acquisition", json={"state": "armed"})
        assert "the audit waits for the store: acquisition armed rig, by this machine" in caplog.text
        other.execute("ROLLBACK")
    await store.write(lambda connection: None)  # comes after them
    entries = (await client.get("/audit")).json()["items"]
    assert [entry["action"] for entry in entries] == ["acquisition disarmed", "acquisition armed"]
