"""Shifts and their sheets over REST."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from io import BytesIO

import httpx
import pytest
from pypdf import PdfReader
from support.lots import opened, put_product, stone
from support.outcomes import rejected, trigger
from support.rest import FakeControl, assert_problem

from drivers.files.times import utc_now
from pipeline.frames import rfc3339
from service.health.alarms.alarm import Alarm, AlarmState
from service.health.alarms.alarms import keep
from service.health.alarms.rules import Priority
from service.lots.shifts import LotsSettings
from service.results.fields import Result
from service.store import Store
from service.store.events import EventType, NewEvent, note_event


@pytest.fixture
def now(control: FakeControl) -> datetime:
    """The present moment, in a shift that began four hours ago and ends in four."""
    now = datetime.now(UTC).astimezone()
    starts = tuple(f"{now + timedelta(hours=hours):%H:%M}" for hours in (-4, 4))
    control.lots = LotsSettings(shift_starts=starts, no_stones_min=15.0)
    return now


@pytest.fixture
async def session(store: Store) -> int:
    """A rig whose stones fall when they fall, which is simulated no less: no replay."""
    return await store.begin_session({"calibration_id": "0123", "is_simulated": True, "is_replay": False})


async def fell(store: Store, session: int, number: int, at: datetime, record: Result) -> None:
    """Store a stone that fell at a moment."""
    await store.record_triggers(
        session, {f"{number:08d}": replace(trigger(number), utc=at.astimezone(UTC).isoformat())}
    )
    await store.finish(session, f"{number:08d}", record)


async def test_shifts_are_listed_and_named_by_their_beginning(
    client: httpx.AsyncClient, now: datetime
) -> None:
    items = (await client.get("/shifts?limit=5")).json()["items"]
    assert len(items) == 5
    assert items[0]["shift"] == f"{now - timedelta(hours=4):%Y-%m-%d-%H%M}"
    assert [each["is_over"] for each in items] == [False, True, True, True, True]
    assert [each["since"] for each in items[:-1]] == [each["until"] for each in items[1:]]
    for each in items:
        got = (await client.get(f"/shifts/{each['shift']}")).json()
        assert {name: got[name] for name in each} == each
    for name in ("2026-01-01-0501", "tomorrow", "1999-01-01-0600"):
        assert_problem(await client.get(f"/shifts/{name}"), 404, "unknown-shift")
        assert_problem(await client.get(f"/shifts/{name}/sheet.pdf"), 404, "unknown-shift")
    assert_problem(await client.get(f"/shifts/{items[0]['shift']}/sheet.xlsx"), 422, "invalid-request")


async def test_a_sheet_has_what_happened_within_its_shift(
    client: httpx.AsyncClient, store: Store, session: int, now: datetime
) -> None:
    await put_product(client)
    begin = now.replace(second=0, microsecond=0) - timedelta(hours=4)

    def after(minutes: float) -> datetime:
        return begin + timedelta(minutes=minutes)

    outside = {"mass_g": 2.5, "density_kg_m3": 2500.0}
    await fell(store, session, 1, after(-1), stone(30.0))
    await fell(store, session, 2, after(5), stone(10.0, **outside))
    await opened(client, tonnage_t=12.5)
    await fell(store, session, 3, after(10), stone(11.0))
    await fell(store, session, 4, after(60), stone(12.0))
    await fell(store, session, 5, after(61), rejected("clipped"))
    alarm = Alarm(
        id=7,
        check="gate",
        state=AlarmState.NORMAL,
        priority=Priority.URGENT,
        detail="silent",
        raised_at=rfc3339(after(20)),
        changed_at=rfc3339(after(30)),
        cleared_at=rfc3339(after(30)),
        acknowledged_at=rfc3339(after(21)),
        acknowledged_by="key wall",
        ended_at=rfc3339(after(30)),
    )
    earlier = replace(alarm, id=6, check="disk", raised_at=rfc3339(after(-90)), ended_at=rfc3339(after(-60)))
    for each in (earlier, alarm):
        await store.write(keep, each)
    begun = "UPDATE sessions SET started_at = ?"
    await store.write(lambda connection: connection.execute(begun, (rfc3339(after(-600)),)))
    for at, kind, data in (
        (after(30), EventType.ACQUISITION_CHANGED, {"state": "disarmed", "trouble": None}),
        (after(40), EventType.ACQUISITION_CHANGED, {"state": "armed", "trouble": None}),
        (
            after(45),
            EventType.VERIFICATION_ENDED,
            {"outcome": "passed", "diameter_mm": 14.3, "error_mm": -0.001},
        ),
    ):
        await store.write(note_event, NewEvent(type=kind, subject="v1", at=rfc3339(at), data=data))
    entry = {"kind": "gap", "value": 25, "text": "<b>wider</b>", "at": rfc3339(after(50))}
    assert (await client.post("/diary", json=entry)).status_code == 201

    name = (await client.get("/shifts?limit=1")).json()["items"][0]["shift"]
    sheet = (await client.get(f"/shifts/{name}")).json()
    assert [sheet[each] for each in ("triggers", "measured", "rejected", "lost", "void")] == [4, 3, 1, 0, 0]
    without, basalt = sheet["products"]
    assert (without["product"], without["measured"], without["mass_kg"]) == (None, 1, None)
    assert (basalt["product"], basalt["measured"], basalt["unmeasured"]) == ("basalt-8-16", 2, 1)
    assert basalt["mass_kg"] == pytest.approx(2700e-9 * 0.6 * (11**3 + 12**3))
    assert basalt["flakiness_limits"]["max_percent"] == 20
    assert basalt["d50_limits"] is None  # no lot was completed
    (lot,) = sheet["lots"]
    record = lot["lot"]
    assert (record["lot"], record["state"], record["n_stones"], record["reached"]) == ("L1", "open", 3, None)
    assert lot["d50_mm"] is None
    assert [each["id"] for each in sheet["alarms"]] == [7]
    assert [(each["text"], each["value"]) for each in sheet["diary"]] == [("<b>wider</b>", 25)]
    assert [(each["outcome"], each["error_mm"]) for each in sheet["verifications"]] == [("passed", -0.001)]
    stops = [(each["since"], each["until"], each["unarmed_s"]) for each in sheet["stops"]]
    assert stops == [
        (rfc3339(after(10)), rfc3339(after(60)), 600.0),  # ten of its fifty minutes were not measured
        (rfc3339(after(61)), sheet["as_of"], 0.0),
    ]
    assert (sheet["is_simulated"], sheet["is_over"]) == (True, False)

    html = await client.get(f"/shifts/{name}/sheet.html?language=de")
    assert html.headers["content-type"] == "text/html; charset=utf-8"
    for text in ("Schicht vom", "SIMULIERT", "VORLÄUFIG", "2 700 kg/m³", "&lt;b&gt;wider", "key wall"):
        assert text in html.text.replace("\u00a0", " ")
    pdf = await client.get(f"/shifts/{name}/sheet.pdf")
    assert pdf.headers["content-disposition"] == f'inline; filename="shift-{name}.pdf"'
    (page,) = PdfReader(BytesIO(pdf.content)).pages
    assert "key wall" in page.extract_text()


async def test_stones_of_a_void_lot_are_counted_and_weigh_nothing(
    client: httpx.AsyncClient, store: Store, session: int, now: datetime
) -> None:
    await put_product(client)
    await opened(client)
    await fell(store, session, 1, now - timedelta(hours=1), stone(12.0))
    await client.post("/lots/L1/void", json={"reason": "wrong product"})
    (shift,) = (await client.get("/shifts?limit=1")).json()["items"]
    sheet = (await client.get(f"/shifts/{shift['shift']}")).json()
    assert (sheet["triggers"], sheet["void"], sheet["products"]) == (1, 1, [])
    assert [each["lot"]["state"] for each in sheet["lots"]] == ["void"]
    assert sheet["as_of"] <= utc_now()
