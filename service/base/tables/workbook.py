"""Sheets of a workbook (.xlsx, ECMA-376) as a spreadsheet copies them: bounded, and without anything but their cells.

Formulas, macros, links and pictures are not looked at; a cell has the value that was computed when it was saved.
"""

import re
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from io import BytesIO
from math import isfinite
from typing import Any
from xml.etree import ElementTree

from service.base.tables.lines import TableError, tabbed

MAX_BYTES = 700_000
"""Size of a file at most: in base64 it fits into the body of a request."""
MAX_UNPACKED_BYTES = 20_000_000
"""Size of all parts that are read, unpacked, at most."""
MAX_MARKS = 1_000_000
"""Elements and attributes of these, by their characters; a cell has seven. Each takes some hundred bytes."""
MAX_PARTS = 1000
MAX_SHEETS = 20
MAX_ROWS = 5000
MAX_COLUMNS = 200
MAX_CELL = 1000
"""Characters."""
MAX_TABLE = 500_000
"""Characters of a sheet; a table of sievings may have no more."""
NAME = re.compile(r"([A-Z]{1,3})([0-9]{1,7})")
RELATIONS = (
    "{http://schemas.openxmlformats.org/officeDocument/2006/relationships}id",
    "{http://purl.oclc.org/ooxml/officeDocument/relationships}id",  # of a strict workbook, ISO/IEC 29500
)
PERCENT_FORMATS = frozenset({9, 10})
DATE_FORMATS = frozenset({*range(14, 18), 22})
"""Formats that every workbook has, ECMA-376 18.8.30."""
DATE_LETTERS = re.compile(r'"[^"]*"|\\.|\[[^\]]*\]|([dy])', re.IGNORECASE)
EPOCH = datetime(1899, 12, 30)
"""Day 0, such that days from March 1900 on are right; Excel has a 29 February 1900."""
EPOCH_1904 = datetime(1904, 1, 1)
DAYS = range(61, 2_958_466)


class WorkbookError(TableError):
    """The file is no workbook that can be read, or is too large; says what to do instead."""


def sheets_of(content: bytes) -> dict[str, str]:
    """Return the tables of a workbook's visible sheets by name, with tabs between cells; empty ones are left out.

    Numbers are written with a point and so many digits that they have one reading alone; a percentage with its sign, a
    date as 2026-03-02. Raises `WorkbookError`.
    """
    if len(content) > MAX_BYTES:
        raise WorkbookError(f"workbook: is larger than {MAX_BYTES / 1e6:g} MB: copy the table alone")
    if not content.startswith(b"PK"):
        raise WorkbookError("workbook: is no .xlsx file: save it as .xlsx or CSV, or copy the table")
    try:
        with zipfile.ZipFile(BytesIO(content)) as file:
            if len(file.infolist()) > MAX_PARTS:
                raise WorkbookError(f"workbook: has more than {MAX_PARTS} parts")
            return dict(_sheets(file))
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, zlib.error, OSError) as err:
        raise WorkbookError(f"workbook: cannot be unpacked: {err}") from err
    except (ElementTree.ParseError, LookupError, ValueError, OverflowError) as err:
        if isinstance(err, TableError):
            raise
        raise WorkbookError(f"workbook: is damaged: {err}") from err


class _Parts:
    """The parts of a workbook; all of them together have no more than a spreadsheet of this size needs."""

    def __init__(self, file: zipfile.ZipFile) -> None:
        self._file = file
        self._left_bytes, self._left_marks = MAX_UNPACKED_BYTES, MAX_MARKS
        self.names = frozenset(file.namelist())

    def read(self, name: str) -> ElementTree.Element:
        """Return a part without namespaces; raise `WorkbookError` if it is too large or not as it should be."""
        with self._file.open(name.lstrip("/")) as packed:
            content = packed.read(self._left_bytes + 1)
        self._left_bytes -= len(content)
        self._left_marks -= content.count(b"<") + content.count(b"=")
        if self._left_bytes < 0 or self._left_marks < 0:
            raise WorkbookError(f"workbook: {name} is too large: copy the table alone")
        if b"<!DOCTYPE" in content or b"\0" in content:  # entities; another encoding could hide them
            raise WorkbookError(f"workbook: {name} is not as spreadsheets write it")
        root = ElementTree.fromstring(content)  # noqa: S314 - see above
        for element in root.iter():
            element.tag = element.tag.rpartition("}")[2]
        return root


def _sheets(file: zipfile.ZipFile) -> Iterator[tuple[str, str]]:
    parts = _Parts(file)
    book = parts.read("xl/workbook.xml")
    targets = {each.attrib["Id"]: each.attrib["Target"] for each in parts.read("xl/_rels/workbook.xml.rels")}
    texts = _texts(parts.read(name)) if (name := "xl/sharedStrings.xml") in parts.names else []
    formats = _formats(parts.read(name)) if (name := "xl/styles.xml") in parts.names else []
    properties = book.find("workbookPr")
    is_1904 = properties is not None and properties.get("date1904") in ("1", "true")
    sheets = [each for each in book.iterfind("sheets/sheet") if each.get("state", "visible") == "visible"]
    if len(sheets) > MAX_SHEETS:
        raise WorkbookError(f"workbook: has more than {MAX_SHEETS} sheets")
    for sheet in sheets:
        target = targets[next(filter(None, map(sheet.get, RELATIONS)), "")]
        path = target if target.startswith("/") else f"xl/{target}"
        rows = _rows(parts.read(path), texts, formats, EPOCH_1904 if is_1904 else EPOCH)
        if rows:
            yield sheet.attrib["name"], tabbed(rows)


def _texts(part: ElementTree.Element) -> list[str]:
    """Return the shared texts, formatted ones joined; phonetic hints are no text."""
    return [
        _in_line("".join(run.text or "" for run in (*item.iterfind("t"), *item.iterfind("r/t"))))
        for item in part.iterfind("si")
    ]


def _formats(part: ElementTree.Element) -> list[str]:
    """Return by style of a cell what its number is: `%`, `date` or nothing of these."""
    own = {
        int(each.attrib["numFmtId"]): each.attrib["formatCode"] for each in part.iterfind("numFmts/numFmt")
    }
    found = []
    for style in part.iterfind("cellXfs/xf"):
        number = int(style.get("numFmtId", "0"))
        code = own.get(number, "")
        is_date = number in DATE_FORMATS or any(DATE_LETTERS.findall(code))
        is_percent = number in PERCENT_FORMATS or "%" in re.sub(r'"[^"]*"|\\.', "", code)
        found.append("date" if is_date else "%" if is_percent else "")
    return found


def _rows(
    part: ElementTree.Element, texts: Sequence[str], formats: Sequence[str], epoch: datetime
) -> list[list[str]]:
    """Return the cells of a sheet by line, with empty lines where it has some between others."""
    rows: dict[int, dict[int, str]] = {}
    n_characters = 0
    for row, column, cell in _cells(part):
        text = _text(cell, texts, formats, epoch)
        if not text:
            continue
        place = f"workbook: line {row}: column {column}"
        if row > MAX_ROWS or column > MAX_COLUMNS:
            raise WorkbookError(
                f"{place}: beyond {MAX_ROWS} lines or {MAX_COLUMNS} columns: copy the table alone"
            )
        n_characters += len(text)
        if n_characters > MAX_TABLE:
            raise WorkbookError(f"{place}: more than {MAX_TABLE} characters: copy the table alone")
        rows.setdefault(row, {})[column] = text
    return [
        [rows.get(row, {}).get(column, "") for column in range(1, max(rows.get(row, {0: ""})) + 1)]
        for row in range(1, max(rows, default=0) + 1)
    ]


def _cells(part: ElementTree.Element) -> Iterator[tuple[int, int, ElementTree.Element]]:
    """Yield row, column and element of each cell; where it has no `r`, it follows the one before (18.3.1.4)."""
    row = 0
    for line in part.iterfind("sheetData/row"):
        row, column = int(line.get("r") or row + 1), 0
        for cell in line.iterfind("c"):
            name = cell.get("r")
            place = NAME.fullmatch(name) if name else None
            if name and place is None:
                raise WorkbookError(f"workbook: {name[:20]!r} is no cell")
            row, column = (int(place[2]), _column(place[1])) if place else (row, column + 1)
            yield row, column, cell


def _column(letters: str) -> int:
    number = 0
    for letter in letters:
        number = 26 * number + ord(letter) - ord("A") + 1
    return number


def _text(cell: Any, texts: Sequence[str], formats: Sequence[str], epoch: datetime) -> str:
    """Return a cell as text in one line; one with an error or without a value is empty."""
    kind, value = cell.get("t", "n"), cell.findtext("v")
    if kind == "inlineStr":
        found = "".join(run.text or "" for run in cell.iter("t"))
    elif value is None or kind == "e":
        return ""
    elif kind == "s":
        return texts[int(value)]
    elif kind in ("str", "b", "d"):
        found = value.removesuffix("T00:00:00") if kind == "d" else value
    else:
        style = int(cell.get("s", "0"))
        found = _number(float(value), formats[style] if style < len(formats) else "", epoch)
    return _in_line(found)


def _in_line(text: str) -> str:
    """Return the text of a cell in one line, as far as it is kept."""
    return " ".join(text.split())[:MAX_CELL]


def _number(value: float, kind: str, epoch: datetime) -> str:
    """Return a number such that it has one reading: 1.234 could be a thousand, 1.2340 cannot."""
    if not isfinite(value):
        raise WorkbookError("workbook: a cell has no number that can be written")
    if kind == "date" and int(value) in DAYS:
        return f"{epoch + timedelta(days=int(value)):%Y-%m-%d}"
    shown = 100 * value if kind == "%" else value
    text = f"{shown:.12f}".rstrip("0").rstrip(".") if abs(shown) < 1e12 else repr(shown)
    if len(text.partition(".")[2]) == 3:
        text += "0"
    return f"{text} %" if kind == "%" else text
