"""Workbooks, months of sievings and repeatability of chosen lots, over REST."""

import base64
from io import BytesIO
from typing import Any

import httpx
import numpy as np
import pytest
import xlsxwriter
from support.lots import opened, put_product
from support.rest import assert_problem


def workbook(rows: list[list[Any]]) -> str:
    out = BytesIO()
    with xlsxwriter.Workbook(out, {"in_memory": True}) as book:
        sheet = book.add_worksheet("Siebung")
        for number, row in enumerate(rows):
            sheet.write_row(number, 0, row)
    return base64.b64encode(out.getvalue()).decode()


@pytest.fixture
async def lots(client: httpx.AsyncClient) -> None:
    await put_product(client)
    for lot in ("L1", "L2"):
        await opened(client, lot, sample_id="S 1")
        await client.post(f"/lots/{lot}/close", json={})


@pytest.mark.usefixtures("lots")
async def test_a_workbook_is_read_as_the_table_of_a_sieving(client: httpx.AsyncClient) -> None:
    rows = [["Sieb mm", "Rückstand g"], [16, 12.5], [8, 80.125], ["Schale", 7.375]]
    answer = await client.post("/tables", json={"workbook": workbook(rows)})
    ((sheet, table),) = [(each["sheet"], each["table"]) for each in answer.json()["items"]]
    assert sheet == "Siebung"
    stored = (await client.post("/lots/L1/sieving", json={"table": table})).json()
    assert (stored["retained_g"], stored["pan_g"]) == ({"16": 12.5, "8": 80.125}, 7.375)
    for wrong in (
        "",
        "not base64!",
        base64.b64encode(b"\xd0\xcf\x11\xe0").decode(),
        base64.b64encode(b"PK\3\4").decode(),
    ):
        assert_problem(await client.post("/tables", json={"workbook": wrong}), 422, "invalid-request")


async def test_a_text_of_a_spreadsheet_is_read_in_its_encoding(client: httpx.AsyncClient) -> None:
    text = "Sieb µm;Rückstand g\n16000;12,5\n"
    for encoding in ("utf-8-sig", "utf-16", "cp1252"):
        sent = {"workbook": base64.b64encode(text.encode(encoding)).decode()}
        answer = await client.post("/tables", json=sent)
        assert answer.json() == {"items": [{"sheet": "", "table": text}]}


@pytest.mark.usefixtures("lots")
async def test_months_of_sievings_are_shown_with_what_is_refused_and_stored_once(
    client: httpx.AsyncClient,
) -> None:
    table = (
        "Lot;Date;Passing % 16 mm;Passing % 8 mm\nL1;2026-03-02;90.5;10\nL9;2026-03-02;90;10\n"
        "L2;2026-03-03;90;95\nL2;2026-03-04;91;12\nL1;2026-03-02;90.5;10\n"
    )
    wanted = {"table": table, "skip_refused": True}
    assert_problem(
        await client.post("/sievings", json={"table": table}), 422, "invalid-request"
    )  # all or none
    shown = (await client.post("/sievings", json={**wanted, "dry_run": True})).json()
    assert [each["lot"] for each in shown["items"]] == ["L1", "L2"]
    refused = [(each["lot"], each["line"], each["reason"]) for each in shown["refused"]]
    assert [each[:2] for each in refused] == [("L9", 3), ("L2", 4), ("L1", 6)]
    for (_, _, reason), why in zip(refused, ("no lot 'L9'", "95 after 90", "stored already"), strict=True):
        assert why in reason
    assert (await client.get("/lots/L1/sieving")).json()["items"] == []
    stored = (await client.post("/sievings", json=wanted)).json()
    assert [(each["lot"], each["sieved_on"]) for each in stored["items"]] == [
        ("L1", "2026-03-02"),
        ("L2", "2026-03-04"),
    ]
    assert stored["refused"] == shown["refused"]
    again = (await client.post("/sievings", json=wanted)).json()
    assert again["items"] == []
    assert len((await client.get("/lots/L1/sieving")).json()["items"]) == 1


@pytest.mark.usefixtures("lots")
async def test_repeated_sievings_of_chosen_lots_tell_the_laboratory_s_repeatability(
    client: httpx.AsyncClient,
) -> None:
    passing = {"L1": (10.0, 12.0), "L2": (11.0,)}
    for lot, percents in passing.items():
        for percent in percents:
            body = {"table": f"Sieve mm;Passing %\n16;90\n8;{percent}", "by": "Ann"}
            assert (await client.post(f"/lots/{lot}/sieving", json=body)).status_code == 201
    query = "/repeatability?of=laboratory&conditions=sampler"
    found = (await client.get(f"{query}&lot=L1&lot=L2")).json()
    assert found["sample_id"] == "S 1"
    assert [(run["lot"], run["sieving"], run["group"]) for run in found["runs"]] == [
        ("L1", 1, "Ann"),
        ("L1", 2, "Ann"),
        ("L2", 3, "Ann"),
    ]
    at_8 = found["figures"]["passing_8_mm_percent"]
    sd = np.std([10, 12, 11], ddof=1)
    assert at_8["repeatability_sd"] == pytest.approx(sd)
    # 2 degrees of freedom: chi-square at 97.5 % is 7.378, at 2.5 % 0.05064 (tables)
    assert at_8["repeatability_sd_low"] == pytest.approx(sd * np.sqrt(2 / 7.378), rel=1e-3)
    assert at_8["repeatability_sd_high"] == pytest.approx(sd * np.sqrt(2 / 0.05064), rel=1e-3)
    assert_problem(await client.get(f"{query}&lot=L1&lot=L1&sample_id=S"), 422, "invalid-request")
    assert_problem(await client.get("/repeatability"), 422, "invalid-request")
    assert_problem(await client.get(f"{query}&lot=L8&lot=L9"), 404, "unknown-sample")
    partly = await client.get(f"{query}&lot=L1&lot=L9&lot=L2")
    assert_problem(partly, 422, "invalid-request")
    assert partly.json()["detail"].endswith(": L9"), "nobody takes the others for the whole"
    assert_problem(await client.get(f"{query}&lot=L2&lot=L2"), 409, "too-few-runs")
