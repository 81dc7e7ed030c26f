"""Issued reports are signed, and the instrument checks them: what it signed itself is genuine, all else is not."""

import asyncio
from base64 import b64encode
from collections.abc import AsyncIterator
from contextlib import suppress

import httpx
import pytest
from support.eventually import PATIENCE_S
from support.lots import opened, put_product, stone
from support.outcomes import add
from support.rest import FakeControl, assert_problem

from service.base.language import Language
from service.calibration.verification_limits import VerificationParameters
from service.daemon.lot_files import issued_reports, lot_files
from service.delivery.file_drop import LotFiles
from service.delivery.settings import FileDropSettings
from service.lots.plant import PlantSettings
from service.lots.yardsticks import Request
from service.reports.lot_reports import ReportRequest, RigStanding
from service.reports.signatures import KEY_FILE, instrument_key, known_fingerprints
from service.store import Store


@pytest.fixture
async def issuing(client: httpx.AsyncClient, store: Store) -> AsyncIterator[None]:
    async def make(lot: str, settings: FileDropSettings) -> LotFiles | None:
        rig = RigStanding(verification=None, is_overdue=False, plant=PlantSettings(instrument_serial="SF-1"))
        wanted = ReportRequest(figures=Request(), language=Language.ENGLISH, rig=rig)
        return await asyncio.to_thread(
            lot_files, store.path, store.particles_dir, lot, wanted, settings.formats
        )

    await put_product(client)
    task = asyncio.create_task(issued_reports(store).run(make))
    yield
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


async def issued(client: httpx.AsyncClient, store: Store, session: int, lot: str, number: int) -> bytes:
    """Return the report that was issued for a lot of one stone."""
    await opened(client, lot=lot)
    await add(store, session, number, stone(10.0))
    closed = (await client.post(f"/lots/{lot}/close?wait_s={PATIENCE_S:g}", json={})).json()
    return (await client.get(closed["completion"]["report"].removeprefix("/api/v1"))).content


async def verified(client: httpx.AsyncClient, content: bytes) -> dict[str, object]:
    answer = await client.post("/reports/verify", json={"pdf": b64encode(content).decode()})
    assert answer.status_code == 200, answer.text
    return dict(answer.json())


@pytest.mark.usefixtures("issuing")
async def test_an_issued_report_is_genuine_until_a_byte_is_changed(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    report = await issued(client, store, session, "L1", 1)
    key = (await client.get("/instrument/key")).json()
    found = await verified(client, report)
    assert (found["state"], found["fingerprint"]) == ("genuine", key["fingerprint"])
    statement = found["statement"]
    assert isinstance(statement, dict)
    assert {name: statement[name] for name in ("instrument", "lot", "revision", "public_key")} == {
        "instrument": "SF-1",
        "lot": "L1",
        "revision": 1,
        "public_key": key["public_key"],
    }
    changed = await verified(client, report.replace(b"endobj", b"endobk", 1))
    assert (changed["state"], changed["statement"]) == ("changed", None)
    made_now = (await client.get("/lots/L1/report.pdf")).content
    assert (await verified(client, made_now))["state"] == "not_signed"


@pytest.mark.usefixtures("issuing")
async def test_reports_of_a_former_key_stay_genuine(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    first = await issued(client, store, session, "L1", 1)
    former = (await client.get("/instrument/key")).json()
    (store.dir / KEY_FILE).unlink()
    instrument_key(store.dir)
    second = await issued(client, store, session, "L2", 2)
    key = (await client.get("/instrument/key")).json()
    assert (key["former"], former["former"]) == ([former["fingerprint"]], [])
    assert known_fingerprints(store.dir) == {key["fingerprint"], former["fingerprint"]}
    for report, by in ((first, former), (second, key)):
        found = await verified(client, report)
        assert (found["state"], found["fingerprint"]) == ("genuine", by["fingerprint"])
    entries = (await client.get("/audit")).json()["items"]
    noted = [each["after"] for each in entries if each["action"] == "reports signed by a new key"]
    assert noted == [{"public_key": each["public_key"]} for each in (former, key)]


async def test_a_large_report_can_be_checked_but_none_beyond_the_limit(client: httpx.AsyncClient) -> None:
    found = await verified(client, b"%PDF-" + b'"[{' * 200_000)
    assert found["state"] == "not_signed"
    for pdf, status, kind in (
        ("A" * 2_000_000, 413, "content-too-large"),
        ("A", 422, "invalid-request"),
        ("", 422, "invalid-request"),
    ):
        assert_problem(await client.post("/reports/verify", json={"pdf": pdf}), status, kind)


async def test_a_damaged_key_is_named(client: httpx.AsyncClient, store: Store) -> None:
    (store.dir / KEY_FILE).write_text("no key")
    answer = await client.get("/instrument/key")
    assert answer.status_code == 503, answer.text


async def test_a_verification_is_overdue_only_where_one_is_asked_for(
    client: httpx.AsyncClient, control: FakeControl
) -> None:
    await put_product(client)
    await opened(client)
    assert control.calibrations is not None
    said = []
    for every_h in (0.0, 24.0):
        control.calibrations.verifications.use(VerificationParameters(every_h=every_h))
        said.append("The verification is overdue" in (await client.get("/lots/L1/report.html")).text)
    assert said == [False, True]
