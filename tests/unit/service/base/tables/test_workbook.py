"""Sheets of workbooks as tables: what a spreadsheet writes is read back, what is hostile is refused in bounds."""

import zipfile
from collections.abc import Mapping
from contextlib import suppress
from datetime import date
from io import BytesIO
from typing import Any

import pytest
import xlsxwriter
from hypothesis import given
from hypothesis import strategies as st

from service.base.tables.lines import TableError, lines_of
from service.base.tables.workbook import (
    MAX_BYTES,
    MAX_CELL,
    MAX_MARKS,
    MAX_ROWS,
    MAX_UNPACKED_BYTES,
    WorkbookError,
    sheets_of,
)
from service.lots.tables.sievings import read_table


def workbook(**sheets: list[list[Any]]) -> bytes:
    """A workbook as xlsxwriter makes it; a tuple is a value with its format, a text with = a formula's value."""
    out = BytesIO()
    with xlsxwriter.Workbook(out, {"in_memory": True}) as book:
        for name, rows in sheets.items():
            sheet = book.add_worksheet(name)
            for i, row in enumerate(rows):
                for j, cell in enumerate(row):
                    value, form = cell if isinstance(cell, tuple) else (cell, None)
                    if isinstance(value, date):
                        sheet.write_datetime(
                            i, j, value, book.add_format({"num_format": form or "dd/mm/yyyy"})
                        )
                    elif value is not None:
                        sheet.write(i, j, value, form and book.add_format({"num_format": form}))
    return out.getvalue()


def packed(parts: Mapping[str, bytes]) -> bytes:
    out = BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in parts.items():
            file.writestr(name, content)
    return out.getvalue()


def changed(content: bytes, name: str, part: bytes) -> bytes:
    with zipfile.ZipFile(BytesIO(content)) as file:
        return packed({each: file.read(each) for each in file.namelist()} | {name: part})


def test_a_sieving_of_a_laboratory_s_workbook_is_read_as_it_was_saved() -> None:
    rows = [
        ["Sieb mm", "Rückstand g", "Durchgang %"],
        [16, 0, (1.0, "0.0%")],
        [11.2, 250.125, (0.749875, "0.00%")],
        [8, 500, (0.249875, "0.0 %")],
        ["Schale", 249.875, None],
    ]
    (table,) = sheets_of(workbook(Sieblinie=rows, leer=[])).values()
    assert table.splitlines()[2] == "11.2\t250.1250\t74.9875 %"
    read = read_table(table)
    assert read.sieving.retained_g == {16.0: 0.0, 11.2: 250.125, 8.0: 500.0}
    assert read.sieving.pan_g == 249.875
    assert "Durchgang" not in read.understood and "passing in %" in read.understood


def test_dates_numbers_and_texts_are_as_people_see_them() -> None:
    rows = [
        [date(2026, 3, 2), (date(2026, 12, 31), "d. mmmm yyyy"), 1.234, 1234567.5, "a\nb\tc", True],
        [],
        [None, 0.1 + 0.2, (5, '0 "mm"'), (0.5, '0.0 "%"')],
    ]
    (table,) = sheets_of(workbook(Sheet=rows)).values()
    first, empty, last = table.splitlines()
    assert first.split("\t") == ["2026-03-02", "2026-12-31", "1.2340", "1234567.5", "a b c", "1"]
    assert empty == ""
    assert last.split("\t") == ["", "0.3", "5", "0.5"]


@given(st.floats(0.01, 9999, allow_nan=False).map(lambda value: round(value, 3)))
def test_a_number_of_a_workbook_has_one_reading(grams: float) -> None:
    (table,) = sheets_of(workbook(Sheet=[["Sieve mm", "Retained g"], [8, grams], [4, 1.5]])).values()
    assert read_table(table).sieving.retained_g[8.0] == grams


def test_what_is_no_workbook_or_hostile_is_refused() -> None:
    good = workbook(Sheet=[["Sieve mm", "Retained g"], [8, 1]])
    sheet = "xl/worksheets/sheet1.xml"
    entity = b'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">]><worksheet><sheetData/></worksheet>'
    far = b'<worksheet><sheetData><row><c r="A%d"><v>1</v></c></row></sheetData></worksheet>' % (MAX_ROWS + 1)
    index = b'<worksheet><sheetData><row><c r="A1" t="s"><v>99</v></c></row></sheetData></worksheet>'
    huge = b'<worksheet><sheetData><row><c r="A1"><v>1e999</v></c></row></sheetData></worksheet>'
    for wrong, why in (
        (b"Sieve;Retained", "no .xlsx"),
        (b"PK" + b"x" * 100, "unpacked"),
        (good[: len(good) // 2], "unpacked"),
        (b"PK" + bytes(MAX_BYTES), "larger"),
        (packed({"a.txt": b"x"}), "damaged"),
        (changed(good, sheet, b" " * MAX_UNPACKED_BYTES), "too large"),  # a bomb of 20 kB
        (
            changed(good, sheet, b"<c/>" * (MAX_MARKS + 1)),
            "too large",
        ),  # each element takes more than its text
        (changed(good, sheet, entity), "not as spreadsheets"),
        (changed(good, sheet, entity.decode().encode("utf-16")), "not as spreadsheets"),
        (changed(good, sheet, far), "lines"),
        (changed(good, sheet, index), "damaged"),
        (changed(good, sheet, huge), "no number"),
        (changed(good, sheet, b"<worksheet><sheetData>"), "damaged"),
        (packed({f"{n}.xml": b"" for n in range(1001)}), "parts"),
    ):
        with pytest.raises(WorkbookError, match=why):
            sheets_of(wrong)


def test_a_text_that_many_cells_share_is_no_bomb() -> None:
    texts = b"<sst><si><t>" + b"x " * 10**6 + b"</t></si></sst>"
    book = changed(workbook(Sheet=[["text"]]), "xl/sharedStrings.xml", texts)

    def with_cells(n_cells: int) -> bytes:
        cells = b"".join(b'<c r="A%d" t="s"><v>0</v></c>' % (row + 1) for row in range(n_cells))
        sheet = b"<worksheet><sheetData><row>" + cells + b"</row></sheetData></worksheet>"
        return changed(book, "xl/worksheets/sheet1.xml", sheet)

    (table,) = sheets_of(with_cells(100)).values()
    assert len(table) == 100 * (MAX_CELL + 1)
    with pytest.raises(WorkbookError, match="more than 500000 characters"):
        sheets_of(with_cells(600))


@given(st.binary(max_size=300), st.integers(0, 3000))
def test_a_damaged_workbook_is_an_error_of_its_own(garbage: bytes, at: int) -> None:
    good = workbook(Sheet=[["Sieve mm", "Retained g"], [8, 1]])
    with suppress(TableError):
        sheets_of(good[:at] + garbage + good[at + len(garbage) :])


def test_cells_without_a_place_follow_each_other() -> None:
    """Some exporters leave `r` out, which is optional: box/spout #267, tidyverse/readxl #102."""
    sheet = (
        b"<worksheet><sheetData><row><c t='inlineStr'><is><t>Sieve mm</t></is></c>"
        b"<c t='inlineStr'><is><t>g</t></is></c></row><row/>"
        b"<row r=''><c><v>8</v></c><c><v>1.5</v></c></row><row r='7'><c r='B7'><v>3</v></c><c><v>4</v></c></row>"
        b"</sheetData></worksheet>"
    )
    (table,) = sheets_of(changed(workbook(Sheet=[["x"]]), "xl/worksheets/sheet1.xml", sheet)).values()
    assert table == "Sieve mm\tg\n\n8\t1.5\n\n\n\n\t3\t4\n"


def test_a_quotation_mark_of_a_cell_stays_in_it() -> None:
    rows = [["Sieve mm", "g"], [8, 1.5], ['"Pan', 2]]
    (table,) = sheets_of(workbook(Sheet=rows)).values()
    assert [line.cells for line in lines_of(table)][2] == ['"Pan', "2"]


def test_a_strict_workbook_is_read() -> None:
    """Excel saves it as "Strict Open XML Spreadsheet": ExcelDataReader #498, JanKallman/EPPlus #134."""
    good = workbook(Sheet=[["Date", "g"], [date(2026, 3, 2), 1.5]])
    strict = {
        b"http://schemas.openxmlformats.org/officeDocument/2006/": b"http://purl.oclc.org/ooxml/officeDocument/",
        b"http://schemas.openxmlformats.org/spreadsheetml/2006/": b"http://purl.oclc.org/ooxml/spreadsheetml/",
    }
    with zipfile.ZipFile(BytesIO(good)) as file:
        parts = {each: file.read(each) for each in file.namelist()}
    for name, part in parts.items():
        for usual, own in strict.items():
            parts[name] = parts[name].replace(usual, own)
        assert parts[name] != part or "xl/w" not in name
    assert sheets_of(packed(parts)) == sheets_of(good) == {"Sheet": "Date\tg\n2026-03-02\t1.5\n"}
    sheet = "xl/worksheets/sheet1.xml"
    dated = (
        b'<worksheet><sheetData><row><c t="d"><v>2026-03-02T00:00:00</v></c></row></sheetData></worksheet>'
    )
    assert sheets_of(packed(parts | {sheet: dated})) == {"Sheet": "2026-03-02\n"}
