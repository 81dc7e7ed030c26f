"""Trends, the crusher's diary and its changes over REST, and comparisons of lots."""

import hashlib
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from xml.etree import ElementTree

import httpx
import pytest
from support.fallen import fall
from support.lots import opened, put_product
from support.rest import FakeControl, app_of, assert_problem, client_of

from pipeline.frames import rfc3339
from service.store import Store
from service.store.events import EventType, NewEvent, note_event
from service.web.settings import ApiKey, ApiSettings, Scope

SVG = "{http://www.w3.org/2000/svg}"


def ago(minutes: float) -> str:
    return rfc3339(datetime.now(UTC) - timedelta(minutes=minutes))


async def fallen(store: Store, minutes_ago: float, minutes: float, **more: object) -> int:
    """Let stones fall a while ago."""
    since = datetime.now(UTC) - timedelta(minutes=minutes_ago)
    return await store.write(fall, since, minutes, **more)


async def test_a_trend_is_followed_and_drawn(client: httpx.AsyncClient, store: Store) -> None:
    await fallen(store, 50, 40)
    await client.post("/diary", json={"kind": "gap", "value": 25, "at": ago(20)})
    found = (await client.get("/trends?hours=1")).json()
    assert sum(bucket["n_stones"] for bucket in found["buckets"]) == 2400
    assert [entry["kind"] for entry in found["diary"]] == ["gap"]
    for figure in ("rate", "d50", "flakiness", "shape"):
        answer = await client.get(f"/trends/{figure}.svg?hours=1")
        assert answer.headers["Content-Type"] == "image/svg+xml"
        root = ElementTree.fromstring(answer.text)  # noqa: S314 - of our own making
        assert "gap 25 mm" in {element.text for element in root.iter(f"{SVG}text")}
        assert any(element.get("class") == "mark" for element in root.iter(f"{SVG}polyline"))
        assert bool([each for each in root.iter() if each.get("class") == "band"]) == (figure != "rate")
        assert "at first" in (root.findtext(f"{SVG}desc") or "")
    german = (await client.get("/trends/shape.svg?hours=1&language=de")).text
    assert "Kornformkennzahl SI" in german
    assert "Spalt 25 mm" in german
    assert_problem(await client.get("/trends/weight.svg"), 422, "invalid-request")
    assert_problem(await client.get("/trends?hours=721"), 422, "invalid-request")


async def test_a_trend_of_a_product_has_its_passing_its_limits_and_its_alarms(
    client: httpx.AsyncClient, store: Store
) -> None:
    await put_product(client)
    await fallen(store, 50, 40)
    of_product = "hours=1&product=basalt-8-16"
    titles = {}
    for figure in ("passing_lower", "passing_upper"):
        text = (await client.get(f"/trends/{figure}.svg?{of_product}")).text
        root = ElementTree.fromstring(text)  # noqa: S314 - of our own making
        titles[figure] = root.findtext(f"{SVG}title")
        assert any(each.get("class") == "curve" for each in root.iter(f"{SVG}polyline"))
        assert "control limits" not in text and "alarm of the product" not in text
        nothing = (await client.get(f"/trends/{figure}.svg?hours=1")).text  # no product, no sieve
        assert "nothing was measured" in nothing
    assert len(set(titles.values())) == 2 and all("Passing" in str(each) for each in titles.values())
    limits = {"limits": {"d50_mm": {"centre": 14.0, "sd": 0.5}}}
    assert (await client.put("/products/basalt-8-16/control", json=limits)).status_code == 200
    raised = NewEvent(type=EventType.ALARM_RAISED, subject="drift", data={})
    await store.write(note_event, replace(raised, at=ago(5)))
    text = (await client.get(f"/trends/d50.svg?{of_product}")).text
    assert "alarm of the product" in text


async def test_a_trend_of_nothing_says_so(client: httpx.AsyncClient) -> None:
    text = (await client.get("/trends/d50.svg?hours=24")).text
    assert "nothing was measured" in text


async def test_the_diary_takes_an_entry_once_whichever_way_it_comes(client: httpx.AsyncClient) -> None:
    wanted = {"kind": "liner", "text": "turned", "at": "2026-03-01T07:10:00+01:00"}
    first = await client.post("/diary", json=wanted, headers={"Idempotency-Key": "k1"})
    again = await client.post("/diary", json=wanted, headers={"Idempotency-Key": "k1"})
    assert (first.status_code, again.json()) == (201, first.json())
    assert (first.json()["at"], first.json()["who"]) == ("2026-03-01T06:10:00.000Z", "this machine")
    second = (await client.post("/events", json={"kind": "gap", "value": 25.0})).json()
    items = (await client.get("/diary")).json()["items"]
    assert items == [second, first.json()]
    assert (await client.get("/diary?since=2026-03-02T00:00:00Z")).json()["items"] == [second]
    noted = [each for each in (await client.get("/events")).json()["items"] if each["type"] == "diary.noted"]
    assert [each["data"] for each in noted] == [first.json(), second]


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": "weather"},
        {"kind": "gap", "value": -1},
        {"kind": "gap", "at": "2100-01-01T00:00:00Z"},
        {"kind": "gap", "at": "06:10"},
        {"kind": "gap", "text": "x" * 501},
        {"text": "no kind"},
    ],
)
async def test_what_is_no_entry_is_refused(client: httpx.AsyncClient, wrong: dict[str, object]) -> None:
    for path in ("/diary", "/events"):
        assert_problem(await client.post(path, json=wrong), 422, "invalid-request")
    assert (await client.get("/diary")).json()["items"] == []


async def test_writing_into_the_diary_needs_the_scope_to_operate(store: Store, control: FakeControl) -> None:
    key = ApiKey(name="screen", sha256=hashlib.sha256(b"token").hexdigest(), scopes=(Scope.READ,))
    bearer = {"Authorization": "Bearer token"}
    async with client_of(app_of(store, control, ApiSettings(keys=(key,)))) as client:
        for path in ("/diary", "/events"):
            assert_problem(await client.post(path, json={"kind": "gap"}, headers=bearer), 403, "forbidden")
        assert (await client.get("/diary", headers=bearer)).status_code == 200


async def test_a_change_is_told_in_a_sentence(client: httpx.AsyncClient, store: Store) -> None:
    next_seq = await fallen(store, 240, 115)
    await fallen(store, 120, 115, long_share=0.26, first_seq=next_seq, seed=1)
    entry = (await client.post("/diary", json={"kind": "liner", "at": ago(121)})).json()
    (item,) = (await client.get("/diary/changes?hours=24")).json()["items"]
    assert item["entry"] == entry
    figures = {each["figure"]: each for each in item["figures"]}
    assert set(figures) == {"d50_mm", "flakiness_percent", "shape_percent", "stones_per_min"}
    shape = figures["shape_percent"]
    assert shape["is_significant"]
    assert shape["sentence"].startswith(
        f"Shape index up {shape['difference']:.1f} points since the liner change of "
    )
    assert shape["sentence"].endswith(", significant")
    assert not figures["stones_per_min"]["is_significant"]
    german = (await client.get("/diary/changes?hours=24&language=de")).json()["items"][0]["figures"]
    assert any(each["sentence"].endswith("Punkte gestiegen, signifikant") for each in german)


async def test_lots_are_compared_figure_by_figure(client: httpx.AsyncClient, store: Store) -> None:
    await put_product(client)
    next_seq = 1
    for lot, long_share in (("L1", 0.18), ("L2", 0.18), ("L3", 0.3)):
        await opened(client, lot)
        next_seq = await fallen(
            store, 60, 30, long_share=long_share, first_seq=next_seq, lot=lot, seed=next_seq
        )
        await client.post(f"/lots/{lot}/close", json={})

    async def compared(query: str) -> dict[str, dict[str, object]]:
        answer = (await client.get(f"/comparisons/lots?{query}")).json()
        assert answer["a"]["measured"] == 1620
        return {each["figure"]: each for each in answer["figures"]}

    alike, apart = await compared("a=L1&b=L2"), await compared("a=L1&b=L3")
    assert not any(each["is_significant"] for each in alike.values())
    assert apart["shape_percent"]["is_significant"]
    assert not apart["d50_mm"]["is_significant"]
    a, b = apart["shape_percent"]["a"]["value"], apart["shape_percent"]["b"]["value"]  # type: ignore[index]
    assert apart["shape_percent"]["difference"] == pytest.approx(b - a)
    assert apart["passing_2_mm_percent"]["is_significant"] is None  # not measured
    same = await client.get("/comparisons/lots?a=L1&b_algorithm_version=10")
    assert same.json()["is_paired"]
    assert {each["difference"] for each in same.json()["figures"]} <= {0, None}
    assert_problem(await client.get("/comparisons/lots?a=L1&b=L9"), 404, "unknown-lot")
    assert_problem(await client.get("/comparisons/lots?a=L1&b_algorithm_version=9"), 422, "invalid-request")
