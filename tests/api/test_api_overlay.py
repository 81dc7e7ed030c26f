"""Curves of many lots in one drawing, and the band that they are seen against."""

from xml.etree import ElementTree

import httpx
import numpy as np
import pytest
from support.lots import PRODUCT, opened, put_product, stone
from support.outcomes import add
from support.rest import assert_problem

from service.store import Store

SVG = "{http://www.w3.org/2000/svg}"


async def fill(client: httpx.AsyncClient, store: Store, session: int, shifts: list[float]) -> list[str]:
    """Make a closed lot of 8 stones for each shift of their sizes."""
    names = []
    for place, shift in enumerate(shifts):
        names.append(f"L{place + 1}")
        await opened(client, names[-1])
        for number in range(8):
            await add(store, session, 100 * place + number + 1, stone(9 + number + shift, volume_mm3=500.0))
        assert (await client.post(f"/lots/{names[-1]}/close", json={})).json()["state"] == "closed"
    return names


@pytest.fixture
async def lots(client: httpx.AsyncClient, store: Store, session: int) -> list[str]:
    await put_product(client)
    return await fill(client, store, session, [0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0])


def query(names: list[str], **more: str) -> str:
    return str(httpx.QueryParams([*(("lot", name) for name in names), *more.items()]))


async def test_the_curves_are_those_of_the_lots(client: httpx.AsyncClient, lots: list[str]) -> None:
    found = (await client.get(f"/comparisons/curves?{query(lots[:3])}")).json()
    assert [each["lot"] for each in found["lots"]] == lots[:3]
    assert found["reference"] is None
    for each in found["lots"]:
        own = (await client.get(f"/lots/{each['lot']}/gradation")).json()["curve"]
        assert each["curve"] == [
            {name: step[name] for name in ("sieve_mm", "passing_percent")} for step in own
        ]
        assert each["measured"] == 8
    other = (await client.get(f"/comparisons/curves?{query(lots[:2], sieve_set='astm-c136')}")).json()
    assert (other["sieve_set"], 9.5 in [step["sieve_mm"] for step in other["lots"][1]["curve"]]) == (
        "astm-c136",
        True,
    )


async def test_the_band_of_the_specification(client: httpx.AsyncClient, lots: list[str]) -> None:
    band = (await client.get(f"/comparisons/curves?{query(lots[:2], reference='specification')}")).json()[
        "reference"
    ]
    assert (band["kind"], band["name"], band["n_lots"]) == ("specification", "GC85-20 8/16", None)
    steps = {each["sieve_mm"]: (each["low_percent"], each["high_percent"]) for each in band["steps"]}
    assert (steps[8], steps[16]) == ((0, 20), (85, 99))
    await client.put("/products/free", json={**PRODUCT, "specification": None, "flakiness_category": None})
    await client.post("/lots", json={"lot": "free", "product": "free"})
    free = (await client.get("/comparisons/curves?lot=free&reference=specification")).json()
    assert free["reference"] is None, "it has no limits"


async def test_the_band_of_the_lots_before(client: httpx.AsyncClient, lots: list[str]) -> None:
    shown, others = lots[:1], lots[1:]
    band = (await client.get(f"/comparisons/curves?{query(shown, reference='history')}")).json()["reference"]
    assert (band["kind"], band["name"], band["n_lots"]) == ("history", "basalt-8-16", 6)
    at_16 = next(each for each in band["steps"] if each["sieve_mm"] == 16)
    passing = []
    for name in others:
        curve = (await client.get(f"/lots/{name}/gradation")).json()["curve"]
        passing += [step["passing_percent"]["value"] for step in curve if step["sieve_mm"] == 16]
    median, reach = np.median(passing), 2 * np.std(passing, ddof=1)
    assert at_16["median_percent"] == pytest.approx(median)
    assert at_16["low_percent"] == pytest.approx(max(median - reach, 0))
    assert at_16["high_percent"] == pytest.approx(min(median + reach, 100))
    assert all(0 <= each["low_percent"] <= each["high_percent"] <= 100 for each in band["steps"])
    assert 2.0 not in [each["sieve_mm"] for each in band["steps"]], "it is not measured"
    await client.post(f"/lots/{lots[-1]}/void", json={"reason": "of another product"})
    assert await n_lots(client, shown) == 5, "a void lot does not count"
    assert await n_lots(client, lots[:2]) is None, "four lots have no spread"


async def n_lots(client: httpx.AsyncClient, shown: list[str]) -> int | None:
    band = (await client.get(f"/comparisons/curves?{query(shown, reference='history')}")).json()["reference"]
    return None if band is None else int(band["n_lots"])


@pytest.mark.parametrize("reference", ["specification", "history", None])
async def test_they_are_drawn(client: httpx.AsyncClient, lots: list[str], reference: str | None) -> None:
    more = {"language": "de"} | ({} if reference is None else {"reference": reference})
    answer = await client.get(f"/comparisons/curves.svg?{query([*lots[:2], lots[0]], **more)}")
    assert answer.headers["Content-Type"] == "image/svg+xml"
    root = ElementTree.fromstring(answer.text)  # noqa: S314 - of our own making
    texts = [each.text or "" for each in root.iter(f"{SVG}text")]
    assert [text for text in texts if text.startswith("L")] == lots[:2], "each once"
    colours = [each.get("stroke") for each in root.iter(f"{SVG}polyline") if each.get("stroke")]
    assert len(set(colours)) == 2
    assert any("± 2 s" in text for text in texts) == (reference == "history")
    bands = [each for each in root.iter(f"{SVG}polygon") if each.get("class") == "envelope"]
    assert bool(bands) == (reference is not None)


async def test_what_cannot_be_overlaid_is_said(client: httpx.AsyncClient, lots: list[str]) -> None:
    for ending in ("", ".svg"):
        address = f"/comparisons/curves{ending}"
        assert_problem(await client.get(address), 422, "invalid-request")
        assert_problem(await client.get(f"{address}?{query(['L1'] * 13)}"), 422, "invalid-request")
        assert_problem(await client.get(f"{address}?{query(['L1', 'nobody'])}"), 404, "unknown-lot")
        assert_problem(await client.get(f"{address}?lot=L1&reference=best"), 422, "invalid-request")


async def test_of_lots_without_stones(client: httpx.AsyncClient) -> None:
    await put_product(client)
    await opened(client)
    found = (await client.get("/comparisons/curves?lot=L1&reference=history")).json()
    assert {step["passing_percent"]["value"] for step in found["lots"][0]["curve"]} == {None}
    assert "not measured" in (await client.get("/comparisons/curves.svg?lot=L1")).text
