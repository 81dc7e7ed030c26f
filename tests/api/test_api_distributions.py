"""Distributions of shape over a lot."""

from xml.etree import ElementTree

import httpx
import pytest
from support.lots import opened, put_product, stone
from support.outcomes import add, rejected
from support.rest import assert_problem

from service.store import Store

MEASURES = ["elongation_ratio", "flatness_ratio", "sphericity", "convexity", "angularity"]


@pytest.fixture
async def lot(client: httpx.AsyncClient, store: Store, session: int) -> str:
    """Return an open lot of 60 stones of equal volume; ten of them are of a version without sphericity."""
    await put_product(client)
    await opened(client)
    for number in range(1, 61):
        shape = {
            "elongation_ratio": 0.4 + number / 200,
            "flatness_ratio": 0.5,
            "convexity": 0.9,
            "angularity": 1000.0 + 10 * number,
            "sphericity": None if number > 50 else 0.6 + number / 1000,
        }
        await add(store, session, number, stone(8 + number / 10, volume_mm3=700.0, **shape))
    await add(store, session, 61, rejected("clipped"))
    return "L1"


async def test_the_distributions_of_a_lot(client: httpx.AsyncClient, lot: str) -> None:
    found = (await client.get(f"/lots/{lot}/distributions")).json()
    assert (found["lot"], found["measured"]) == ("L1", 60)
    items = {each["measure"]: each for each in found["items"]}
    assert list(items) == MEASURES
    for each in items.values():
        for name in ("mass_percent", "number_percent"):
            assert sum(share[name] for share in each["classes"]) == pytest.approx(100)
    elongation = items["elongation_ratio"]
    values = {each["percent"]: each["value"] for each in elongation["quantiles"]}
    assert {name: each["value"] for name, each in values.items()} == pytest.approx(
        {10: 0.43, 50: 0.55, 90: 0.67}
    )
    assert values[50]["low"] < 0.55 < values[50]["high"]
    assert values[50]["state"] == "measured"
    assert elongation["mean"]["value"] == pytest.approx(0.5525)
    sphericity = items["sphericity"]
    assert (sphericity["n_stones"], sphericity["n_unmeasured"]) == (50, 10)
    assert [(each["lower"], each["upper"]) for each in items["flatness_ratio"]["classes"]] == [(0.5, 0.55)]
    assert [each["lower"] for each in items["angularity"]["classes"]] == [1000, 1200, 1400, 1600]
    assert_problem(await client.get("/lots/L9/distributions"), 404, "unknown-lot")


async def test_of_a_choice_of_the_stones(client: httpx.AsyncClient, lot: str) -> None:
    heaviest = (await client.get(f"/lots/{lot}/particles?limit=1")).json()["items"][0]["id"]
    found = (await client.get(f"/lots/{lot}/distributions?without={heaviest}")).json()
    assert found["measured"] == 59
    assert_problem(await client.get(f"/lots/{lot}/distributions?without=nobody"), 422, "invalid-request")


async def test_of_no_stone_nothing_is_measured(client: httpx.AsyncClient) -> None:
    await put_product(client)
    await opened(client)
    for each in (await client.get("/lots/L1/distributions")).json()["items"]:
        assert (each["n_stones"], each["classes"], each["mean"]["value"]) == (0, [], None)
    assert "not measured" in (await client.get("/lots/L1/distributions/sphericity.svg")).text


@pytest.mark.parametrize("measure", MEASURES)
async def test_each_is_drawn(client: httpx.AsyncClient, lot: str, measure: str) -> None:
    address = f"/lots/{lot}/distributions/{measure}.svg"
    answer = await client.get(f"{address}?language=de")
    assert answer.headers["Content-Type"] == "image/svg+xml"
    root = ElementTree.fromstring(answer.text)  # noqa: S314 - of our own making
    classes = (await client.get(f"/lots/{lot}/distributions")).json()["items"]
    shown = next(each["classes"] for each in classes if each["measure"] == measure)
    bars = [each for each in root.iter("{http://www.w3.org/2000/svg}polygon") if each.get("class") == "bar"]
    assert len(bars) == len(shown)
    assert "Masse-%" in answer.text
    again = await client.get(f"{address}?language=de", headers={"If-None-Match": answer.headers["ETag"]})
    assert again.status_code == 304
    assert_problem(await client.get(f"/lots/{lot}/distributions/colour.svg"), 422, "invalid-request")
    assert_problem(await client.get(f"/lots/L9/distributions/{measure}.svg"), 404, "unknown-lot")
