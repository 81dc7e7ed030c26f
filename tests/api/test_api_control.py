"""Watching the product over REST: charts of its lots, their limits and causes, alarms and events."""

import json
import time
from datetime import UTC, datetime, timedelta
from functools import partial
from typing import Any
from xml.etree import ElementTree

import httpx
import pytest
from support.fallen import fall
from support.lots import opened, put_product
from support.rest import FakeControl, assert_problem

from pipeline.gradation.specification import Verdict
from service.base.language import Language
from service.base.status import AcquisitionState, AcquisitionStatus, Checks, CheckStatus
from service.daemon.lot_files import lot_files, note_issued
from service.daemon.overview import overviews
from service.daemon.product_watch import ProductWatch
from service.delivery.settings import DropFormat
from service.health.alarms.alarm import AlarmState
from service.health.alarms.alarms import Alarms
from service.lots.shifts import LotsSettings
from service.lots.yardsticks import Request
from service.reports import lot_reports
from service.reports.lot_reports import ReportRequest, RigStanding
from service.store import Store
from service.store.event_log import EventLog
from service.store.events import EventType, NewEvent, events_after

SVG = "{http://www.w3.org/2000/svg}"
CONTROL = "/products/basalt-8-16/control"
FIGURES = ["d50_mm", "passing_8_mm_percent", "passing_16_mm_percent", "flakiness_percent", "shape_percent"]
IN_CONTROL_MM, COARSE_MM = 11.0, 14.0


class Days:
    """Lots of some days, one after the other; only the drawing of their reports is left out."""

    def __init__(self, client: httpx.AsyncClient, store: Store) -> None:
        self.client, self.store = client, store
        self.n_lots, self.next_seq = 0, 1

    async def open(self, median_mm: float = IN_CONTROL_MM, n_stones: int = 300, **more: float) -> str:
        self.n_lots += 1
        lot = f"L{self.n_lots:03d}"
        assert (await opened(self.client, lot)).status_code == 201
        since = datetime.now(UTC) - timedelta(minutes=5)
        told = {"first_seq": self.next_seq, "lot": lot, "seed": self.n_lots, "median_mm": median_mm, **more}
        self.next_seq = await self.store.write(fall, since, 5.0, per_min=n_stones / 5, **told)
        return lot

    async def complete(self, median_mm: float = IN_CONTROL_MM, n_stones: int = 300, **more: float) -> str:
        lot = await self.open(median_mm, n_stones, **more)
        await self.client.post(f"/lots/{lot}/close", json={})
        rig = RigStanding(verification=None, is_overdue=False)
        wanted = ReportRequest(figures=Request(), language=Language.ENGLISH, rig=rig)
        files = lot_files(self.store.path, self.store.particles_dir, lot, wanted, [DropFormat.PDF])
        assert files is not None
        await self.store.write(partial(note_issued, self.store.dir), lot, files)
        return lot

    async def drifting(self) -> list[str]:
        return [each["figure"] for each in (await self.client.get(CONTROL)).json()["drifting"]]

    async def charts(self) -> dict[str, dict[str, Any]]:
        answer = (await self.client.get(CONTROL)).json()
        return {each["figure"]: each for each in answer["charts"]}

    async def events(self, *types: EventType) -> list[tuple[str, str]]:
        found = await self.store.read(events_after, 0, 1000, types)
        return [(each["type"], each["subject"]) for each in found.items]


@pytest.fixture
async def days(client: httpx.AsyncClient, store: Store, monkeypatch: pytest.MonkeyPatch) -> Days:
    renderers = {**lot_reports.RENDERERS, lot_reports.ReportFormat.PDF: lot_reports.render_csv}
    monkeypatch.setattr("service.daemon.lot_files.RENDERERS", renderers)
    await put_product(client)
    return Days(client, store)


@pytest.mark.full
async def test_lots_are_the_points_of_a_chart(client: httpx.AsyncClient, days: Days) -> None:
    assert [(name, each["points"]) for name, each in (await days.charts()).items()] == [
        (each, []) for each in FIGURES
    ]
    assert "no lot has been completed" in (await client.get(f"{CONTROL}/d50_mm.svg")).text
    for _ in range(7):
        await days.complete()
    assert {each["centre"] for each in (await days.charts()).values()} == {None}
    few = await days.complete(n_stones=40)
    for _ in range(14):
        await days.complete()
    charts = await days.charts()
    assert list(charts) == FIGURES
    d50 = charts["d50_mm"]
    assert (d50["origin"], d50["n_baseline"], len(d50["points"])) == ("first_lots", 20, 22)
    assert await days.drifting() == []
    uncounted = [point for point in d50["points"] if not point["is_counted"]]
    assert [(point["lot"], point["lower"], point["rules"]) for point in uncounted] == [(few, None, [])]
    assert uncounted[0]["figure"]["value"] is not None
    for point in d50["points"]:
        figures = (await client.get(f"/lots/{point['lot']}/gradation")).json()
        (median,) = (each for each in figures["quantiles"] if each["percent"] == 50)
        assert point["figure"] == median["exact_mm"]
    assert (d50["specified"], d50["capability"]) == (None, None)
    newest = (await client.get(f"{CONTROL}?limit=2")).json()["charts"][0]
    assert newest == d50 | {"points": d50["points"][-2:]}
    flakiness = charts["flakiness_percent"]
    assert (flakiness["specified"]["max_percent"], flakiness["capability"]["n"]) == (20, 21)
    assert flakiness["capability"]["ppk_low"] < flakiness["capability"]["ppk"]


@pytest.mark.full
async def test_limits_of_a_lot_are_as_wide_as_its_stones_are_few(days: Days) -> None:
    for n_stones in (2000, 200) * 5:
        await days.complete(n_stones=n_stones)
    d50 = (await days.charts())["d50_mm"]
    many, few = (d50["points"][place] for place in (0, 1))
    of_sampling = [((each["upper"] - d50["centre"]) / 3) ** 2 - d50["sd"] ** 2 for each in (many, few)]
    stones = [each["figure"]["n_effective"] for each in (many, few)]
    assert of_sampling[1] / of_sampling[0] == pytest.approx(stones[0] / stones[1])
    assert stones[0] > 5 * stones[1]


@pytest.mark.full
async def test_a_drift_is_an_event_once_and_an_alarm_until_it_is_gone(
    client: httpx.AsyncClient, store: Store, control: FakeControl, alarms: Alarms, days: Days
) -> None:
    watch = ProductWatch(store, control)
    drifting = (EventType.PRODUCT_DRIFTING.value, "basalt-8-16")
    for _ in range(21):
        last_good = await days.complete()
    assert await days.events(EventType.PRODUCT_DRIFTING) == []
    entry = (await client.post("/diary", json={"kind": "liner", "text": "turned"})).json()
    log = EventLog(store)
    log.note(NewEvent(type=EventType.ALARM_RAISED, subject="optics", data={"detail": "c07: dust"}))
    log.note(NewEvent(type=EventType.ALARM_RAISED, subject="drift", data={"detail": "no cause of itself"}))
    await log.written()
    coarse = [await days.complete(COARSE_MM) for _ in range(3)]
    assert await days.events(EventType.PRODUCT_DRIFTING) == [drifting]
    d50 = (await days.charts())["d50_mm"]
    assert "d50_mm" in await days.drifting()
    out = [point for point in d50["points"] if point["rules"]]
    assert [point["lot"] for point in out][-3:] == coarse
    assert {"beyond_limits", "ewma"} <= set(out[-1]["rules"])
    causes = out[-1]["causes"]
    (closed_at,) = (point["closed_at"] for point in d50["points"] if point["lot"] == last_good)
    assert causes["since"] == closed_at
    assert causes["diary"] == [entry]
    assert [(each["subject"], each["data"]["detail"]) for each in causes["events"]] == [
        ("optics", "c07: dust")
    ]

    drawn = (await client.get(f"{CONTROL}/d50_mm.svg?language=de")).text
    root = ElementTree.fromstring(drawn)  # noqa: S314 - of our own making
    assert f"außer Kontrolle: {', '.join(coarse)}" in (root.findtext(f"{SVG}desc") or "")
    assert (
        sum(each.get("class") == "does-not-conform" for each in root.iter(f"{SVG}circle")) == 3 + 1
    )  # legend
    assert "Brechwerkzeug" in {each.text for each in root.iter(f"{SVG}text")}
    assert_problem(await client.get(f"{CONTROL}/d51_mm.svg"), 404, "unknown-chart")

    await watch.look()
    alarms.update(watch.checks())
    (alarm,) = (each for each in alarms.within(AlarmState.UNACKNOWLEDGED) if each.check == "drift")
    assert "D50, mm: " in (alarm.detail or "")
    assert "d50_mm" in {finding.parameters["figure"] for finding in alarm.findings}
    n_until_gone = 0
    while await days.drifting():
        await days.complete()
        n_until_gone += 1
    assert 0 < n_until_gone < 20  # each of five figures must cross its centre
    await watch.look()
    checks = watch.checks()
    assert checks["drift"].status is CheckStatus.PASS
    assert await days.events(EventType.PRODUCT_DRIFTING) == [drifting]


async def test_limits_of_a_product_without_a_lot_are_an_empty_chart(client: httpx.AsyncClient) -> None:
    await put_product(client)
    limits = {"d50_mm": {"centre": 11.2, "sd": 0.2}}
    assert (await client.put(CONTROL, json={"limits": limits})).status_code == 200
    found = (await client.get(CONTROL)).json()
    assert (found["drifting"], {len(each["points"]) for each in found["charts"]}) == ([], {0})
    for wrong in ({"centre": 1e400, "sd": 0.2}, {"centre": 11.2, "sd": 1e308}, {"centre": -1, "sd": 0.2}):
        content = json.dumps({"limits": {"d50_mm": wrong}}).replace("Infinity", "1e400")
        refused = await client.put(CONTROL, content=content, headers={"Content-Type": "application/json"})
        assert_problem(refused, 422, "invalid-request")


async def test_limits_are_set_by_hand_and_taken_back(client: httpx.AsyncClient, days: Days) -> None:
    for _ in range(3):
        await days.complete()
    limits = {"limits": {"d50_mm": {"centre": 10.0, "sd": 0.1}}}
    answer = await client.put(CONTROL, json=limits)
    assert (answer.status_code, answer.json()) == (200, limits | {"since": None})
    d50 = (await days.charts())["d50_mm"]
    assert (d50["origin"], d50["centre"], d50["n_baseline"]) == ("by_hand", 10.0, 0)
    assert await days.drifting() == ["d50_mm"]
    noted = (await client.get("/audit?limit=1000")).json()["items"][-1]
    assert (noted["action"], noted["before"]["limits"]) == ("control limits", {})
    await client.put(CONTROL, json={"since": "2100-01-01T00:00:00Z"})
    assert not any(each["points"] for each in (await days.charts()).values())
    await client.put(CONTROL, json={})
    assert (await days.charts())["d50_mm"]["origin"] is None


@pytest.mark.parametrize(
    "wrong",
    [
        {"limits": {"d50": {"centre": 1, "sd": 1}}},
        {"limits": {"passing_11.2_mm_percent": {"centre": 1, "sd": 1}}},
        {"limits": {"d50_mm": {"centre": 1, "sd": -1}}},
        {"limits": {"d50_mm": {"centre": 1}}},
        {"since": "yesterday"},
        {"target": 1},
    ],
)
async def test_what_are_no_limits_is_refused(client: httpx.AsyncClient, days: Days, wrong: object) -> None:
    before = (await client.get(CONTROL)).json()
    assert_problem(await client.put(CONTROL, json=wrong), 422, "invalid-request")
    assert (await client.get(CONTROL)).json() == before
    for method in ("GET", "PUT"):
        answer = await client.request(
            method, "/products/granite/control", json={} if method == "PUT" else None
        )
        assert_problem(answer, 404, "unknown-product")


async def test_a_lot_that_does_not_conform_is_an_alarm_until_one_does(
    store: Store, control: FakeControl, days: Days
) -> None:
    watch = ProductWatch(store, control)

    async def conformity() -> str | None:
        await watch.look()
        return watch.checks()["conformity"].detail

    assert await conformity() is None
    bad = await days.complete(median_mm=18.0, n_stones=1000)
    assert await conformity() == f"lot {bad} of basalt-8-16 does not conform"
    await days.complete(n_stones=30)  # too few for a verdict
    assert await conformity() == f"lot {bad} of basalt-8-16 does not conform"
    assert await days.events(EventType.LOT_DOES_NOT_CONFORM) == [("lot.does_not_conform", bad)]
    await days.complete(median_mm=9.5, n_stones=8000, long_share=0.02)
    assert await conformity() is None


async def test_the_open_lot_reaches_its_verdict_once(
    client: httpx.AsyncClient, store: Store, control: FakeControl, days: Days, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(overviews, "FIGURES_S", 0.0)
    monkeypatch.setattr(overviews, "FIGURES_SHARE", 1.0)
    n_evaluated = 0
    evaluate = overviews.overview_figures

    def counted(*given: Any) -> Any:
        nonlocal n_evaluated
        n_evaluated += 1
        return evaluate(*given)

    monkeypatch.setattr(overviews, "overview_figures", counted)
    watch = ProductWatch(store, control)
    lot = await days.open(median_mm=18.0, n_stones=1000)
    for _ in range(20):
        await watch.look()
    assert n_evaluated == 1
    (told,) = (await store.read(events_after, 0, 1000, [EventType.LOT_VERDICT_REACHED])).items
    assert (told["subject"], told["data"]["reached"]["verdict"]) == (lot, Verdict.DOES_NOT_CONFORM)
    assert (await client.get(f"/lots/{lot}")).json()["reached"] == told["data"]["reached"]
    await watch.look()
    assert watch.checks()["conformity"].detail == f"lot {lot} of basalt-8-16 does not conform so far"


async def test_no_stones_while_the_feeder_runs_is_an_alarm(
    store: Store, control: FakeControl, days: Days, monkeypatch: pytest.MonkeyPatch
) -> None:
    age_s: float | None = None
    status = lambda: AcquisitionStatus(state=control.state, last_stone_age_s=age_s)  # noqa: E731 - of two words
    monkeypatch.setattr(control, "acquisition_status", status)
    begun_s, later_s = time.monotonic(), 0.0
    monkeypatch.setattr("service.daemon.product_watch.time.monotonic", lambda: begun_s + later_s)
    watch = ProductWatch(store, control)

    def feed() -> Checks:
        return {"feed": watch.checks()["feed"]}

    control.lots = LotsSettings(no_stones_min=10.0)
    later_s = 3600.0
    assert feed()["feed"].status is CheckStatus.PASS  # disarmed
    control.state = AcquisitionState.ARMED
    assert feed()["feed"].status is CheckStatus.PASS  # no lot is open
    lot = await days.open()
    await watch.look()
    assert feed()["feed"].status is CheckStatus.PASS
    later_s += 601
    assert feed()["feed"].detail == f"no stone has fallen for 10 minutes, and lot {lot} is open"
    age_s = 2.0
    assert feed()["feed"].status is CheckStatus.PASS
    age_s, later_s = 700.0, later_s + 698
    assert (feed()["feed"].status, feed()["feed"].observed_value) == (CheckStatus.WARN, 11.7)
    control.lots = LotsSettings()
    assert feed()["feed"].status is CheckStatus.PASS  # nobody asked for it
    control.lots, control.state = LotsSettings(no_stones_min=10.0), AcquisitionState.DISARMED
    assert feed()["feed"].status is CheckStatus.PASS
