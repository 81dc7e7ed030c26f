"""The sizes D_p of a lot: those of the product, of a request, on reports."""

import csv
from io import StringIO

import httpx
import pytest
from support.lots import PRODUCT, opened, put_product, stone
from support.outcomes import add
from support.rest import assert_problem

from service.store import Store


@pytest.fixture
async def lot(client: httpx.AsyncClient, store: Store, session: int) -> str:
    """Return an open lot of 100 stones of equal volume, of 8.1, 8.2 ... 18 mm."""
    await put_product(client)
    await opened(client)
    for sequence in range(1, 101):
        await add(store, session, sequence, stone(8 + sequence / 10, volume_mm3=500.0))
    return "L1"


async def sizes(client: httpx.AsyncClient, address: str) -> dict[float, float]:
    figures = (await client.get(address)).json()
    return {each["percent"]: each["exact_mm"]["value"] for each in figures["quantiles"]}


async def test_any_sizes_can_be_asked_for(client: httpx.AsyncClient, lot: str) -> None:
    address = f"/lots/{lot}/gradation"
    assert await sizes(client, address) == pytest.approx({10: 9, 30: 11, 50: 13, 60: 14, 90: 17})
    asked = await sizes(client, f"{address}?quantiles=95,5,16,2.5,84,5")
    assert asked == pytest.approx({2.5: 8.3, 5: 8.5, 16: 9.6, 84: 16.4, 95: 17.5})
    assert list(asked) == sorted(asked)
    answer = (await client.get(f"{address}?quantiles=2.5,50")).text
    assert '"percent":2.5' in answer
    assert '"percent":50,' in answer, "a whole number as before"
    interpolated = [each["interpolated_mm"] for each in (await client.get(address)).json()["quantiles"]]
    assert all(each["low"] <= each["value"] <= each["high"] for each in interpolated)
    for path in ("/windows/current", "/windows/shift"):
        assert (await client.get(f"{path}?quantiles=5")).json()["quantiles"][0]["percent"] == 5


@pytest.mark.parametrize(
    "text",
    ["", "0", "100", "-5", "50;60", "nan", "inf", "1,,2", "٥٠", "1_0", ",".join(map(str, range(1, 22)))],
)
async def test_no_sizes_for_what_is_no_percent(client: httpx.AsyncClient, lot: str, text: str) -> None:
    answer = await client.get(f"/lots/{lot}/gradation", params={"quantiles": text})
    assert_problem(answer, 422, "invalid-request")
    assert answer.json()["detail"].startswith("quantiles:")


async def test_a_product_has_sizes_of_its_own(client: httpx.AsyncClient, lot: str) -> None:
    saved = await client.put("/products/basalt-8-16", json={**PRODUCT, "quantiles": [84, 16]})
    assert saved.json()["quantiles"] == [84, 16]
    await client.post(f"/lots/{lot}/void", json={"reason": "of the product before"})
    await opened(client, "L2")
    assert list(await sizes(client, "/lots/L2/gradation")) == [16, 50, 84], "the median is always there"
    assert list(await sizes(client, "/lots/L2/gradation?quantiles=10")) == [10]
    compared = (await client.get("/comparisons/lots?a=L2&b=L1")).json()
    names = [each["figure"] for each in compared["figures"]]
    assert [name for name in names if name.startswith("d")] == ["d16_mm", "d50_mm", "d84_mm"]
    for wrong in ([0], [100], [], [50] * 21, [50, 50], [True], ["50"]):
        answer = await client.put("/products/basalt-8-16", json={**PRODUCT, "quantiles": wrong})
        assert_problem(answer, 422, "invalid-request")


async def test_reports_print_the_sizes_that_were_asked_for(client: httpx.AsyncClient, lot: str) -> None:
    address = f"/lots/{lot}/report"
    german = (await client.get(f"{address}.html?quantiles=2.5,95&language=de")).text
    assert ">D2,5<" in german
    assert ">D95<" in german
    assert ">D30<" not in german
    rows = csv.DictReader(StringIO((await client.get(f"{address}.csv?quantiles=2.5")).text))
    assert [row["name"] for row in rows if row["section"] == "quantiles"] == [
        "d2.5_interpolated_mm",
        "d2.5_exact_mm",
    ]


async def test_csv_of_a_report_in_german_is_for_a_german_spreadsheet(
    client: httpx.AsyncClient, lot: str
) -> None:
    german, plain = [
        (await client.get(f"/lots/{lot}/report.csv{query}")).content for query in ("?language=de", "")
    ]
    assert german.startswith("\ufeffsection;name;sieve_mm;value;".encode())
    assert plain.startswith(b"section,name,sieve_mm,value,")
    rows = [
        list(csv.DictReader(StringIO(text), delimiter=delimiter))
        for text, delimiter in ((german.decode("utf-8-sig"), ";"), (plain.decode(), ","))
    ]
    d50 = [next(row["value"] for row in each if row["name"] == "d50_exact_mm") for each in rows]
    assert d50[0] == d50[1].replace(".", ",")
    assert "," in d50[0]


async def test_the_uncertainty_of_the_main_figures_has_a_budget(client: httpx.AsyncClient, lot: str) -> None:
    figures = (await client.get(f"/lots/{lot}/gradation?quantiles=5")).json()
    budgets = {each["figure"]: each for each in figures["uncertainty"]}
    assert list(budgets) == ["d50_mm", "flakiness_percent", "shape_percent"], "D50 whatever is asked for"
    assert budgets["d50_mm"]["value"] == pytest.approx(13)
    for each in budgets.values():
        squares = each["sampling"] ** 2 + each["instrument"] ** 2 + each["scale"] ** 2
        assert each["combined"] ** 2 == pytest.approx(squares)
        assert each["expanded"] == pytest.approx(each["coverage_factor"] * each["combined"])
    assert 0 < budgets["d50_mm"]["scale"] < budgets["d50_mm"]["sampling"]
