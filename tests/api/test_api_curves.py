"""Curves of lots as drawings, of chosen stones, beside other lots and other versions."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import httpx
import pytest
from support.lots import opened, put_product, stone
from support.outcomes import add
from support.rest import FakeControl, ReadingThread, app_of, assert_problem, client_of

from service.remeasuring.jobs import revise
from service.store import Store
from service.store.reads import particle

SVG = "{http://www.w3.org/2000/svg}"
OLD, NEW = "9", "10"


@pytest.fixture
async def lot(client: httpx.AsyncClient, store: Store, session: int) -> str:
    """Return an open lot of 60 stones from 8.2 to 14 mm, measured by the older version."""
    await put_product(client)
    await opened(client)
    for sequence in range(1, 61):
        await add(store, session, sequence, stone(8.1 + sequence / 10, algorithm_version=OLD))
    return "L1"


async def revised(store: Store, seq: int, record: dict[str, Any], folder: Path) -> None:
    """Measure the stone of this first result again, without files."""
    found = await store.read(particle, seq)
    assert found is not None
    assert await revise(store, found, record, folder, "test")


def drawn(answer: httpx.Response) -> ElementTree.Element:
    assert answer.status_code == 200, answer.text
    assert answer.headers["Content-Type"] == "image/svg+xml"
    return ElementTree.fromstring(answer.text)  # noqa: S314 - of our own making


def texts(answer: httpx.Response) -> set[str | None]:
    return {element.text for element in drawn(answer).iter(f"{SVG}text")}


async def passing(client: httpx.AsyncClient, path: str) -> dict[float, float]:
    figures = (await client.get(path)).json()
    return {step["sieve_mm"]: step["passing_percent"]["value"] for step in figures["curve"]}


async def test_the_curve_of_a_lot_is_that_of_its_report(client: httpx.AsyncClient, lot: str) -> None:
    answer = await client.get(f"/lots/{lot}/curve.svg")
    report = (await client.get(f"/lots/{lot}/report.html")).text
    assert drawn(answer).findtext(f"{SVG}title") == "Gradation"
    assert answer.text.strip() in report
    german = await client.get(f"/lots/{lot}/curve.svg?language=de&sieve_set=en-basic-1")
    assert "Durchgang, Masse-%" in texts(german)
    again = await client.get(f"/lots/{lot}/curve.svg", headers={"If-None-Match": answer.headers["ETag"]})
    assert (again.status_code, again.content) == (304, b"")


async def test_it_changes_with_the_next_stone(
    client: httpx.AsyncClient, lot: str, store: Store, session: int
) -> None:
    before = await client.get(f"/lots/{lot}/curve.svg")
    assert (await client.get(f"/lots/{lot}/curve.svg")).text == before.text
    await add(store, session, 61, stone(15.5))
    assert (await client.get(f"/lots/{lot}/curve.svg")).text != before.text


async def test_equal_requests_share_one_drawing(store: Store, control: FakeControl, session: int) -> None:
    asked: list[str] = []

    class Counting(ReadingThread):
        async def run(self, function: Any, *arguments: object) -> Any:
            asked.append(str(arguments))
            return await super().run(function, *arguments)

    async with client_of(app_of(store, control, reading=Counting())) as client:
        await put_product(client)
        await opened(client)
        asked.clear()
        for _ in range(5):
            drawn(await client.get("/lots/L1/curve.svg"))
        assert len(asked) == 1
        drawn(await client.get("/lots/L1/curve.svg?language=de"))
        assert len(asked) == 2


async def test_the_curve_of_the_last_minutes(client: httpx.AsyncClient, lot: str) -> None:
    empty = await client.get("/windows/current/curve.svg?minutes=5")
    assert "not measured" in (drawn(empty).findtext(f"{SVG}desc") or "")
    beside = await client.get(f"/windows/current/curve.svg?minutes=5&beside_lot={lot}")
    assert {"L1"} <= texts(beside)
    assert_problem(await client.get("/windows/current/curve.svg?product=chalk"), 404, "unknown-product")


async def test_what_a_curve_would_be_without_some_stones(
    client: httpx.AsyncClient, lot: str, store: Store
) -> None:
    items = (await client.get(f"/lots/{lot}/particles?sieve=16&sieve_set=en-basic-1")).json()["items"]
    heaviest = [item["id"] for item in items[:2]]
    query = "&".join(f"without={name}" for name in heaviest)
    figures = (await client.get(f"/lots/{lot}/gradation?{query}")).json()
    whole = (await client.get(f"/lots/{lot}/gradation")).json()
    assert (figures["measured"], whole["measured"]) == (58, 60)
    assert (figures["without"], whole["without"]) == (sorted(heaviest), [])
    share = sum(item["influence_percent"] for item in items[:2])
    d50, d50_whole = (each["quantiles"][2]["exact_mm"]["value"] for each in (figures, whole))
    assert d50 < d50_whole
    assert figures["mass_kg"] == pytest.approx(whole["mass_kg"] * (1 - share / 100))
    assert (await client.get(f"/lots/{lot}/curve.svg?{query}")).text != (
        await client.get(f"/lots/{lot}/curve.svg")
    ).text
    assert (await client.get(f"/lots/{lot}")).json()["n_stones"] == 60  # nothing of it is stored
    for path in ("gradation", "curve.svg"):
        assert_problem(await client.get(f"/lots/{lot}/{path}?without=nobody"), 422, "invalid-request")
    many = "&".join(f"without={number}" for number in range(101))
    assert_problem(await client.get(f"/lots/{lot}/gradation?{many}"), 422, "invalid-request")


async def test_a_lot_as_each_version_measured_it(
    client: httpx.AsyncClient, lot: str, store: Store, tmp_path: Path
) -> None:
    for seq in range(1, 41):
        await revised(store, seq, stone(8.6 + seq / 10, algorithm_version=NEW), tmp_path)
    versions = (await client.get(f"/lots/{lot}/algorithm-versions")).json()["items"]
    assert versions == [
        {"algorithm_version": NEW, "n_stones": 40},
        {"algorithm_version": OLD, "n_stones": 60},
    ]
    old = (await client.get(f"/lots/{lot}/gradation?algorithm_version={OLD}")).json()
    new = (await client.get(f"/lots/{lot}/gradation?algorithm_version={NEW}")).json()
    assert (old["measured"], old["algorithm_versions"], old["algorithm_version"]) == (60, [OLD], OLD)
    assert (new["measured"], new["algorithm_versions"], new["algorithm_version"]) == (40, [NEW], NEW)
    smallest = {
        each: (await passing(client, f"/lots/{lot}/gradation?algorithm_version={each}"))
        for each in (OLD, NEW)
    }
    assert smallest[OLD][10.0] != smallest[NEW][10.0]
    beside = await client.get(f"/lots/{lot}/curve.svg?algorithm_version={NEW}&beside_algorithm_version={OLD}")
    assert {"L1, algorithm 9", "L1, algorithm 10: passing with 95 % interval"} <= texts(beside)
    assert "Beside it L1, algorithm 9: " in (drawn(beside).findtext(f"{SVG}desc") or "")
    unknown = await client.get(f"/lots/{lot}/gradation?algorithm_version=11")
    assert_problem(unknown, 422, "invalid-request")
    assert "there are 10, 9" in unknown.json()["detail"]


async def test_lots_beside_each_other(client: httpx.AsyncClient, lot: str) -> None:
    await client.post(f"/lots/{lot}/close", json={})
    await opened(client, "L2")
    both = await client.get(f"/lots/{lot}/curve.svg?beside_lot=L2")
    assert "L2" in texts(both)
    assert_problem(await client.get(f"/lots/{lot}/curve.svg?beside_lot=L9"), 404, "unknown-lot")
    assert_problem(await client.get("/lots/L9/curve.svg"), 404, "unknown-lot")
