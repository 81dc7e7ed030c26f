"""The stones of a lot as CSV and as Parquet: every value, its type and unit, and what was not measured."""

import csv
import json
from datetime import UTC, datetime
from io import BytesIO, StringIO
from typing import Any

import httpx
import pytest
from pyarrow import parquet
from support.lots import opened, put_product, stone
from support.outcomes import add, rejected
from support.rest import assert_problem

from service.lots import stone_files
from service.results.columns import columns_of_stones
from service.store import Store

N_STONES = 7
SHARES = [0.1, 1 / 3, 2e-17, 1e21, 123456.789]


@pytest.fixture
async def lot(client: httpx.AsyncClient, store: Store, session: int) -> str:
    """Return an open lot of five measured stones, a rejected one, and one whose result was removed."""
    await put_product(client)
    await opened(client)
    for number, value in enumerate(SHARES, 1):
        optional = {"min_box_mm": None, "sphericity": None} if number == 2 else {"sphericity": value}
        hull = {"volume_mm3": value, "surface_area_mm2": 2.0, "equivalent_diameter_mm": 3.0}
        await add(store, session, number, stone(8 + value % 1, detail="=1+1; ä", hull=hull, **optional))
    await add(store, session, 6, rejected("clipped"))
    kept = await add(store, session, 7, stone(9.5, sphericity=0.75, quality_causes=["focus"]))
    await store.write(lambda base: base.execute("DELETE FROM results WHERE seq = ?", (kept,)))
    return "L1"


async def records(client: httpx.AsyncClient, lot: str) -> list[dict[str, Any]]:
    """Return the results of the stones as REST serves them, oldest first."""
    return list(reversed((await client.get(f"/particles?lot={lot}&limit=100")).json()["items"]))


@pytest.fixture(params=[1, 3, N_STONES, 2000])
def pieces(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """Stones are read in pieces: none must be lost or come twice at the seams."""
    monkeypatch.setattr(stone_files, "STONES_OF_A_PIECE", request.param)
    return int(request.param)


@pytest.mark.usefixtures("pieces")
async def test_parquet_has_every_value_with_type_and_unit(client: httpx.AsyncClient, lot: str) -> None:
    answer = await client.get(f"/lots/{lot}/stones.parquet")
    assert answer.headers["Content-Type"] == "application/vnd.apache.parquet"
    assert answer.headers["Content-Disposition"] == 'attachment; filename="L1-stones.parquet"'
    table = parquet.read_table(BytesIO(answer.content))
    rows, expected = table.to_pylist(), await records(client, lot)
    assert len(rows) == N_STONES
    for row, record in zip(rows, expected, strict=False):
        for column in columns_of_stones():
            assert row[column.name] == column.cell(record), column.name
        assert row["volume_mm3"] == record["volume_mm3"], "to the last bit"
        assert row["captured_at"] == datetime.fromisoformat(record["captured_at"]).astimezone(UTC)
    assert rows[0]["min_box_b_mm"] == 20.0
    assert [row["hull.volume_mm3"] for row in rows[:5]] == SHARES
    assert json.loads(rows[0]["dropped_views"]) == {"c03": "residual"}
    unit = {name: table.field(name).metadata.get(b"unit", b"").decode() for name in table.column_names}
    assert {name: unit[name] for name in ("volume_mm3", "min_box_a_mm", "mass_g", "sphericity", "tangency_px")} == {
        "volume_mm3": "mm³", "min_box_a_mm": "mm", "mass_g": "g", "sphericity": "", "tangency_px": "px",
    }  # fmt: skip
    assert unit["volume_sd_percent"] == "%"
    described = [table.field(name).metadata[b"description"] for name in table.column_names]
    assert all(described)
    assert table.schema.metadata[b"lot"] == b"L1"


async def test_what_is_not_known_is_null(client: httpx.AsyncClient, lot: str) -> None:
    content = (await client.get(f"/lots/{lot}/stones.parquet")).content
    *_, second, _, _, _, clipped, removed = parquet.read_table(BytesIO(content)).to_pylist()
    assert (second["sphericity"], second["min_box_a_mm"]) == (None, None)
    assert (clipped["outcome"], clipped["reason"], clipped["volume_mm3"]) == ("rejected", "clipped", None)
    assert (removed["sieve_size_mm"], removed["sphericity"]) == (9.5, 0.75)
    assert json.loads(removed["quality_causes"]) == ["focus"]
    assert removed["is_simulated"] is True
    assert (removed["views"], removed["recorded_at"], removed["n_stones"]) == (None, None, 1)


async def test_parquet_of_no_stone_has_the_columns(client: httpx.AsyncClient) -> None:
    await put_product(client)
    await opened(client)
    table = parquet.read_table(BytesIO((await client.get("/lots/L1/stones.parquet")).content))
    assert (table.num_rows, table.column_names) == (0, [column.name for column in columns_of_stones()])


@pytest.mark.usefixtures("pieces")
async def test_csv_has_every_value(client: httpx.AsyncClient, lot: str) -> None:
    answer = await client.get(f"/lots/{lot}/stones.csv")
    assert answer.headers["Content-Type"] == "text/csv; charset=utf-8"
    assert answer.text.count("\r\n") == N_STONES + 1
    rows, expected = list(csv.DictReader(StringIO(answer.text))), await records(client, lot)
    assert len(rows) == N_STONES
    for row, record in zip(rows, expected, strict=False):
        for name in ("volume_mm3", "sphericity", "sieve_size_mm"):
            assert (float(row[name]) if row[name] else None) == record[name], "to the last bit"
        assert row["id"] == record["id"]
        assert row["captured_at"] == record["captured_at"]
    assert rows[0]["detail"] == "'=1+1; ä", "no formula"
    assert rows[1]["sphericity"] == ""
    assert rows[0]["is_simulated"] == "true"


@pytest.mark.usefixtures("pieces")
async def test_csv_for_a_german_spreadsheet(client: httpx.AsyncClient, lot: str) -> None:
    content = (await client.get(f"/lots/{lot}/stones.csv?language=de")).content
    text = content.decode("utf-8-sig")
    assert content.startswith("\ufeff".encode())
    assert "\ufeff" not in text
    german = list(csv.DictReader(StringIO(text), delimiter=";"))
    plain = list(csv.DictReader(StringIO((await client.get(f"/lots/{lot}/stones.csv")).text)))
    assert [row["hull.volume_mm3"] for row in german] == [
        "0,1",
        "0,3333333333333333",
        "2e-17",
        "1e+21",
        "123456,789",
        "",
        "",
    ]
    for row, other in zip(german, plain, strict=True):
        assert {**row, **dict.fromkeys(numbers := [c.name for c in columns_of_stones() if c.kind == "number"])} == {
            **other, **dict.fromkeys(numbers),
        }  # fmt: skip
    assert (await client.get(f"/lots/{lot}/stones.csv?language=en")).text == (
        await client.get(f"/lots/{lot}/stones.csv")
    ).text


async def test_of_an_unknown_lot(client: httpx.AsyncClient) -> None:
    for ending in ("csv", "parquet"):
        assert_problem(await client.get(f"/lots/L9/stones.{ending}"), 404, "unknown-lot")
    assert_problem(await client.get("/lots/L9/stones.csv?language=fr"), 422, "invalid-request")
