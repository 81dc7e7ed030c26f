"""Files of tables: the text of any of them, and rows whose columns are found by the names in the head."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from drivers.files.bounded import read_bounded
from service.base.tables.lines import TableError, TableLine, lines_of, text_of
from service.base.tables.numbers import TOKEN, UNITS, TableColumn, head_and_rows
from service.base.tables.workbook import MAX_BYTES, WorkbookError, sheets_of

COMPOUND_FILE = b"\xd0\xcf\x11\xe0"
"""Beginning of .xls, which is not read."""


class NamedColumn(NamedTuple):
    """A column that a table may have: the names that its head may have, and the unit where the head has none."""

    names: tuple[str, ...]
    usual_unit: str = ""


def tables_of(content: bytes) -> dict[str, str]:
    """Return the tables of a file by name: the sheets of a workbook that have cells, or the one table of a text.

    Raises `WorkbookError` for a workbook that cannot be read, and for what is neither that nor text.
    """
    if content.startswith(b"PK"):
        return sheets_of(content)
    text = text_of(content)
    if "\0" in text or content.startswith(COMPOUND_FILE):
        raise WorkbookError("workbook: is neither .xlsx nor text: save it as .xlsx or CSV, or copy the table")
    return {"": text} if text.strip() else {}


def table_text(path: Path) -> str:
    """Return the only table of a file as text; raise `TableError`, which names the file, if there are several."""
    try:
        tables = tables_of(read_bounded(path, MAX_BYTES))
    except OSError as err:
        raise TableError(f"{path}: cannot be read: {err.strerror}") from err
    except TableError as err:
        raise TableError(f"{path}: {err}") from err
    if len(tables) > 1:
        raise TableError(f"{path}: has the sheets {', '.join(tables)}: keep one of them, or save it as CSV")
    return next(iter(tables.values()), "")


def read_rows(
    path: Path, wanted: Mapping[str, NamedColumn], needed: tuple[str, ...]
) -> tuple[dict[str, TableColumn], list[TableLine]]:
    """Return the columns by the keys of `wanted`, as far as the head names them, and the rows below it.

    Case, blanks, hyphens and underscores of a head do not matter, and it may have a unit; other columns are left out.

    Raises `TableError`, which names the file, if it cannot be read, or its head names a `needed` column not or twice.
    """
    lines = lines_of(table_text(path), str(path), may_be_short=True)
    head, rows = head_and_rows(lines) if lines else (TableLine(1, [], str(path)), [])
    columns: dict[str, TableColumn] = {}
    for number, text in enumerate(head.cells, start=1):
        tokens = TOKEN.findall(text.lower())
        name = "_".join(each for each in tokens if each not in {*UNITS, "in"})
        key = next((key for key, column in wanted.items() if name in column.names), None)
        if key is None:
            continue
        if key in columns:
            raise TableError(f"{head.place}: column {number}: {text!r} is there twice")
        units = [each for each in tokens if each in UNITS] or [wanted[key].usual_unit]
        quantity, unit = UNITS.get(units[0], (None, 1.0))
        columns[key] = TableColumn(number=number, quantity=quantity, unit=unit, unit_name=units[0])
    if not set(needed) <= set(columns):
        read = ", ".join(repr(cell[:40]) for cell in head.cells)
        raise TableError(
            f"{head.place}: must name the columns {' and '.join(needed)}, not {read or 'nothing'}"
        )
    return columns, list(rows)
