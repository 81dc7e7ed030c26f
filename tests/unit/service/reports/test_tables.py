"""The reports that a machine reads: CSV and workbook."""

import csv
import zipfile
from io import BytesIO, StringIO
from xml.etree import ElementTree

import pytest
from support.lot_figures import lot_document, report_data

from service.base.csv_text import csv_text
from service.base.language import Language
from service.reports.csv_file import render_csv
from service.reports.report import ReportData
from service.reports.workbook import render_xlsx

Cell = str | float | None
NS = {"m": "http://schemas.openxmlformats.org/spreadsheetml/2006/main"}
FORMULAS = ["=1+1", "+1", "-1", "@SUM(A1)", " =1+1", "\t=1+1", "\r\n=1", "＝1+1", '=HYPERLINK("http://x")']


def parsed(text: str | bytes) -> ElementTree.Element:
    return ElementTree.fromstring(text)  # noqa: S314 - of our own making


def table(data: ReportData) -> list[dict[str, str]]:
    return list(csv.DictReader(StringIO(render_csv(data).decode("utf-8"), newline="")))


def passing(rows: list[dict[str, str]], sieve_mm: str, name: str = "passing_percent") -> dict[str, str]:
    """Return the one row of the curve at a sieve."""
    key = ("curve", name, sieve_mm)
    (found,) = [row for row in rows if (row["section"], row["name"], row["sieve_mm"]) == key]
    return found


def sheets(data: ReportData) -> dict[str, list[list[Cell]]]:
    """Return the cells of all sheets of a workbook: texts and numbers."""
    with zipfile.ZipFile(BytesIO(render_xlsx(data))) as archive:
        assert archive.testzip() is None
        strings = ["".join(part.itertext()) for part in parsed(archive.read("xl/sharedStrings.xml"))]
        book = parsed(archive.read("xl/workbook.xml"))
        names = [sheet.attrib["name"] for sheet in book.iterfind("m:sheets/m:sheet", NS)]
        return {
            name: _cells(parsed(archive.read(f"xl/worksheets/sheet{i}.xml")), strings)
            for i, name in enumerate(names, 1)
        }


def _cells(sheet: ElementTree.Element, strings: list[str]) -> list[list[Cell]]:
    """Return the rows, None where a cell is empty."""
    assert sheet.find(".//m:f", NS) is None, "a formula"
    rows: list[list[Cell]] = []
    for row in sheet.iterfind(".//m:row", NS):
        found: dict[int, Cell] = {}
        for item in row:
            text = item.findtext("m:v", "", NS)
            column = ord(item.attrib["r"].rstrip("0123456789")) - ord("A")
            found[column] = strings[int(text)] if item.get("t") == "s" else float(text)
        rows.append([found.get(column) for column in range(max(found, default=-1) + 1)])
    return rows


def test_csv_has_one_figure_a_row_with_all_that_is_known_of_it() -> None:
    rows = table(report_data())
    found = passing(rows, "4.0")
    assert (found["value"], found["low_95"], found["high_95"], found["unit"]) == ("3.9", "2.5", "5.3", "%")
    assert (found["limit_min"], found["limit_max"], found["verdict"]) == ("0.0", "5.0", "undecided")
    assert (found["more_stones"], found["state"]) == ("220", "measured")
    by_name = {(row["section"], row["name"]): row["value"] for row in rows}
    assert by_name["lot", "lot"] == "2026-04711"
    assert by_name["accounting", "rejected: multiple"] == "12"
    assert by_name["accounting", "body: photo"] == "901"
    assert by_name["accounting", "not_refined: rush"] == "71"
    assert by_name["verdict", "verdict"] == "undecided"
    assert by_name["d4791", "1:3 flat_percent by mass"] == "10.0"
    assert by_name["d4791 12.5 to 14 mm", "1:3 flat_percent by mass"] == "10.0"
    assert by_name["d4791 12.5 to 14 mm", "n_stones"] == "122"
    assert by_name["d4791 mean by mass", "1:3 flat_percent by mass"] == "11.0"
    assert by_name["about", "verification_error_mm"] == "0.021"


def test_csv_is_the_same_in_every_language_without_mark_and_with_crlf() -> None:
    english, german = render_csv(report_data()), render_csv(report_data(language=Language.GERMAN))
    assert english == german
    assert not english.startswith(b"\xef\xbb\xbf")
    assert english.count(b"\n") == english.count(b"\r\n")


def test_csv_leaves_what_was_not_measured_empty() -> None:
    found = passing(table(report_data()), "2.0")
    assert (found["value"], found["low_95"], found["n_effective"]) == ("", "", "")
    assert (found["state"], found["verdict"]) == ("not_measured", "not_measured")
    by_number = passing(table(report_data()), "2.0", "passing_by_number_percent")
    assert (by_number["value"], by_number["verdict"]) == ("", "")  # limits are of the mass


@pytest.mark.parametrize("text", FORMULAS)
def test_a_text_is_never_a_formula_and_a_negative_number_stays_one(text: str) -> None:
    assert csv_text([[-1.5]]) == "-1.5\r\n"
    data = report_data({"lot": lot_document(lot=text, remark=text, sublot=text)})
    values = {
        row["value"]
        for row in table(data)
        if (row["section"], row["name"]) in (("lot", "lot"), ("lot", "remark"))
    }
    assert {value[0] for value in values} == {"'"}
    assert any(text.strip() in str(row) for row in sheets(data)["About"])  # without a formula


def test_long_and_strange_texts_are_whole_in_csv_and_do_no_harm_in_a_workbook() -> None:
    text = 'W"a,b;c\n' + "x" * 40_000 + "\x00\ud800🪨"
    data = report_data({"lot": lot_document(remark=text)})
    (found,) = [row["value"] for row in table(data) if (row["section"], row["name"]) == ("lot", "remark")]
    assert found == 'W"a,b;c ' + "x" * 40_000 + "🪨"
    (printed,) = [row[1] for row in sheets(data)["About"] if row[:1] == ["Remark"]]
    assert printed == found[:399] + "…"


def test_a_workbook_has_its_sheets_with_numbers_as_numbers() -> None:
    found = sheets(report_data())
    assert list(found) == ["Curve", "Indices", "Laboratory", "Accounting", "About"]
    rows = {row[0]: row for row in found["Curve"]}
    assert rows[16.0][1:4] == [94.2, 92.2, 96.2]
    assert rows[16.0][6:9] == [90.0, 99.0, "conforms"]
    assert rows[2.0][1:6] == [None] * 5  # a chart takes a text for 0
    assert rows[2.0][8] == "not measured"
    indices = {row[0]: row for row in found["Indices"]}
    assert indices["Flakiness index FI, % (EN 933-3)"][1] == 12.4
    assert indices["Fineness modulus (ASTM C136)"][1::7] == [None, "not measured"]
    assert ["rejected: more than one stone", 12.0] in found["Accounting"]
    assert ["Measured body: estimated from the outlines", 84.0] in found["Accounting"]
    assert ["Not refined: other stones were waiting", 71.0] in found["Accounting"]
    assert any("SIMULATED" in str(row[0]) for row in sheets(report_data({"is_simulated": True}))["About"])


def test_a_german_workbook_has_german_sheets() -> None:
    found = sheets(report_data(language=Language.GERMAN))
    assert list(found)[:2] == ["Kurve", "Kennzahlen"]
    assert ["Gemessener Körper: visuelle Hülle", 2.0] in found["Bilanz"]


def test_what_is_no_number_leaves_its_cell_empty() -> None:
    found = sheets(report_data({"mass_kg": float("nan"), "least_portion_kg": None}))["Accounting"]
    assert found[-2:] == [["Measured mass, kg"], ["Least test portion (EN 933-1), kg"]]


def test_csv_has_the_budget_of_each_figure() -> None:
    rows = {row["name"]: row for row in table(report_data()) if row["section"] == "uncertainty"}
    assert (rows["d50_mm expanded"]["value"], rows["d50_mm expanded"]["unit"]) == ("0.28", "mm")
    assert (rows["d50_mm coverage_factor"]["value"], rows["d50_mm coverage_factor"]["unit"]) == ("2.0", "")
    squares = sum(
        float(rows[f"shape_percent {name}"]["value"]) ** 2 for name in ("sampling", "instrument", "scale")
    )
    assert squares == pytest.approx(float(rows["shape_percent combined"]["value"]) ** 2, rel=1e-3)
