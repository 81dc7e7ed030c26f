"""A closed lot is final when its last stone has its outcome: verdict and report are said, once for each revision."""

import asyncio
import hashlib
from collections.abc import AsyncIterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from support.eventually import PATIENCE_S, soon
from support.lots import opened, put_product, stone
from support.outcomes import add, trigger
from support.rest import assert_problem

from service.base.language import Language
from service.daemon.lot_files import FilesFailedError, issued_reports, lot_files
from service.delivery.file_drop import LotFiles
from service.delivery.settings import FileDropSettings
from service.health.alarms.rules import load_rules
from service.lots.lots import close_lot, find_lot, note_revised, uncompleted_lots, void_lot
from service.lots.yardsticks import Request
from service.reports import lot_reports
from service.reports.lot_reports import ReportRequest, RigStanding
from service.store import Store
from service.store.events import EventType, events_after

PATIENT = f"wait_s={PATIENCE_S:g}"


class Issuing:
    """Makes reports in a thread, as the daemon has them made in its reading process."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self.is_failing = False

    async def make(self, lot: str, settings: FileDropSettings) -> LotFiles | None:
        if self.is_failing:
            raise FilesFailedError("ValueError: a figure is no number")
        rig = RigStanding(verification=None, is_overdue=False)
        wanted = ReportRequest(figures=Request(), language=Language.ENGLISH, rig=rig)
        store = self.store
        return await asyncio.to_thread(
            lot_files, store.path, store.particles_dir, lot, wanted, settings.formats
        )


@pytest.fixture
async def issuing(client: httpx.AsyncClient, store: Store) -> AsyncIterator[Issuing]:
    await put_product(client)
    issuing = Issuing(store)
    task = asyncio.create_task(issued_reports(store).run(issuing.make))
    yield issuing
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


async def completions(store: Store) -> list[dict[str, Any]]:
    found = await store.read(events_after, 0, 1000, [EventType.LOT_COMPLETED])
    return [each["data"]["completion"] for each in found.items]


@pytest.mark.usefixtures("issuing")
async def test_a_lot_is_closing_until_its_last_stone_has_an_outcome(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await opened(client)
    await add(store, session, 1, stone(10.0))
    await store.record_triggers(session, {"00000002": trigger(2)})
    at_once = (await client.post("/lots/L1/close", json={})).json()
    assert (at_once["state"], at_once["n_stones"], at_once["in_progress"]) == ("closing", 1, 1)
    assert at_once["completion"] is None
    listed = [(await client.get(f"/lots?state={state}")).json()["items"] for state in ("closing", "closed")]
    assert [len(each) for each in listed] == [1, 0]
    patient = asyncio.create_task(client.post(f"/lots/L1/close?{PATIENT}", json={}))
    await store.finish(session, "00000002", stone(12.0))
    final = (await patient).json()
    assert (final["state"], final["n_stones"], final["in_progress"]) == ("closed", 2, 0)
    said = final["completion"]
    assert (said["revision"], said["measured"], said["verdict"]) == (1, 2, "insufficient")
    assert await completions(store) == [said]


@pytest.mark.usefixtures("issuing")
async def test_the_issued_report_stays_as_it_is_and_is_what_the_event_says(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await opened(client)
    await add(store, session, 1, stone(10.0))
    said = (await client.post(f"/lots/L1/close?{PATIENT}", json={})).json()["completion"]
    answer = await client.get(said["report"].removeprefix("/api/v1"))
    assert answer.headers["Content-Type"] == "application/pdf"
    assert hashlib.sha256(answer.content).hexdigest() == said["report_sha256"]
    times = {"since": "2000-01-01T00:00:00Z", "until": "2100-01-01T00:00:00Z"}
    await store.record_triggers(session, {"00000002": trigger(2)})  # in no lot
    await store.finish(session, "00000002", stone(12.0))
    await client.post("/lots/L1/assign", json=times)
    anew = (await client.post(f"/lots/L1/close?{PATIENT}", json={})).json()
    assert (anew["revision"], anew["completion"]["revision"], anew["completion"]["measured"]) == (2, 2, 2)
    assert [each["revision"] for each in await completions(store)] == [1, 2]
    again = await client.get(said["report"].removeprefix("/api/v1"))
    assert again.content == answer.content
    for wrong in ("pdf?revision=3", "csv?revision=1"):
        assert_problem(await client.get(f"/lots/L1/report.{wrong}"), 404, "unknown-report")


@pytest.mark.parametrize("n_lots", [5, pytest.param(100, marks=pytest.mark.full)])
async def test_what_the_close_says_is_what_the_lot_has_for_good(
    client: httpx.AsyncClient,
    store: Store,
    session: int,
    issuing: Issuing,
    monkeypatch: pytest.MonkeyPatch,
    n_lots: int,
) -> None:
    """Stones fall and are measured while one lot after the other is closed; only the drawing of the PDF is left out."""
    renderers = {**lot_reports.RENDERERS, lot_reports.ReportFormat.PDF: lot_reports.render_csv}
    monkeypatch.setattr("service.daemon.lot_files.RENDERERS", renderers)
    rng, measuring = np.random.default_rng(40), set[asyncio.Task[object]]()

    async def measured_later(number: int, delay_s: float) -> None:
        await asyncio.sleep(delay_s)
        await store.finish(session, f"{number:08d}", stone(8 + number % 20))

    async def falling() -> None:
        number = 0
        while True:
            number += 1
            await store.record_triggers(session, {f"{number:08d}": trigger(number)})
            measuring.add(asyncio.create_task(measured_later(number, rng.uniform(0, 0.05))))
            await asyncio.sleep(0.01)

    fall, said = asyncio.create_task(falling()), {}
    for number in range(n_lots):
        await opened(client, lot=f"L{number}")
        await asyncio.sleep(rng.uniform(0.01, 0.04))
        said[f"L{number}"] = (await client.post(f"/lots/L{number}/close?{PATIENT}", json={})).json()
    fall.cancel()
    await asyncio.gather(*measuring)
    for lot, at_close in said.items():
        figures = (await client.get(f"/lots/{lot}/gradation")).json()
        assert figures["lot"] == at_close
        assert figures["measured"] == at_close["n_stones"] == at_close["completion"]["measured"]
        assert (figures["verdict"], figures["lot"]["revision"]) == (at_close["completion"]["verdict"], 1)
    assert sum(each["n_stones"] for each in said.values()) > n_lots


async def test_what_cannot_be_issued_is_told_and_made_up_for(
    client: httpx.AsyncClient, store: Store, session: int
) -> None:
    await put_product(client)
    await opened(client)
    await add(store, session, 1, stone(10.0))
    await store.write(close_lot, "L1", None, "test")
    issuing, reports = Issuing(store), issued_reports(store)
    reports._retry_s = 0.01  # half a minute in the daemon
    issuing.is_failing = True
    task = asyncio.create_task(reports.run(issuing.make))
    await soon(lambda: reports.trouble == "lot L1: ValueError: a figure is no number")
    assert set(reports.checks()) == {"issued_reports"} <= set(load_rules().by_check)
    issuing.is_failing = False
    await soon(lambda: reports.trouble is None)
    task.cancel()
    assert len(await completions(store)) == 1


async def test_a_lot_that_is_measured_again_is_completed_when_it_rests(
    client: httpx.AsyncClient, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    await put_product(client)
    await opened(client)
    await store.write(close_lot, "L1", None, "test")
    await store.write(note_revised, "L1")
    monkeypatch.setattr("service.lots.lots.REST_S", 86_400.0)
    assert await store.read(uncompleted_lots) == {"L1": False}
    monkeypatch.setattr("service.lots.lots.REST_S", -1.0)
    assert await store.read(uncompleted_lots) == {"L1": True}


async def test_a_void_lot_is_never_completed(client: httpx.AsyncClient, store: Store) -> None:
    await put_product(client)
    await opened(client)
    await store.write(close_lot, "L1", None, "test")
    assert await store.read(uncompleted_lots) == {"L1": True}
    await store.write(void_lot, "L1", "wet", "test")
    assert await store.read(uncompleted_lots) == {}
    lot = await store.read(find_lot, "L1")
    assert lot is not None
    assert (lot.state, lot.completion) == ("void", None)


def test_reports_are_kept_beside_the_results(store: Store, tmp_path: Path) -> None:
    issued_reports(store)
    assert (store.dir / lot_reports.ISSUED).is_dir()
