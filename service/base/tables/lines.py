"""Tables as text: bytes of any encoding decoded, lines split into cells at the delimiter that the table shows."""

import codecs
import csv
import re
import unicodedata
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from service.base.errors import InvalidRequestError

MOST_LINES = 10_000
MOST_COLUMNS = 20
SEPARATOR = re.compile(r'"?sep=([^\w\s"]|\t)"?[;,\t]*', re.IGNORECASE)
"""First line of a file that a spreadsheet is to open."""
QUOTED = re.compile(r'"[^"]*("|$)')
NOTE = re.compile(r"([²³¹\u2070-\u2089\u2460-\u249b\u24ea-\u24ff\u2776-\u2793]+)")
"""Small and circled digits. They stay as they are: 12.5 with the mark of a note is not 12.51."""


class TableError(InvalidRequestError):
    """A table cannot be read, or contradicts itself; names the line, the column and the cell, as far as it can."""


class TableLine(NamedTuple):
    """A line of a table that is not empty."""

    number: int
    cells: list[str]
    table: str = "table"

    def at(self, column: int) -> str:
        """Return the cell of a column, from 1; empty where the line ends before it."""
        return self.cells[column - 1] if column <= len(self.cells) else ""

    @property
    def place(self) -> str:
        return f"{self.table}: line {self.number}"


def text_of(content: bytes) -> str:
    """Return the text of a spreadsheet's file: UTF-8, UTF-16, or the code page 1252 of old Windows programs."""
    for encoding, mark, odd in (("utf-16-le", codecs.BOM_UTF16_LE, 1), ("utf-16-be", codecs.BOM_UTF16_BE, 0)):
        if content.startswith(mark) or (len(content) > 1 and content[odd] == 0 != content[1 - odd]):
            return content.decode(encoding, errors="replace").removeprefix("\ufeff")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def lines_of(text: str, table: str = "table", *, may_be_short: bool = False) -> list[TableLine]:
    """Return the lines that have cells, parted at tabs, semicolons, commas or what a line `sep=` names.

    A cell in quotes may go on in the next lines. Where commas part cells, a line with more of them than the first
    shows decimal commas, and so does one with less, unless empty cells at the end may be left out (`may_be_short`).

    Raises `TableError` for a line that cannot be parted so, and for more than `MOST_LINES` or `MOST_COLUMNS`.
    """
    parts = NOTE.split(text.removeprefix("\ufeff"))
    parts[::2] = (unicodedata.normalize("NFKC", part) for part in parts[::2])
    lines = "".join(parts).splitlines()
    if len(lines) > MOST_LINES:
        raise TableError(f"{table}: more than {MOST_LINES} lines: send it in parts")
    named = SEPARATOR.fullmatch(lines[0].strip(" ")) if lines else None
    if named is not None:
        lines[0] = ""
    mark = named[1] if named else _mark(lines)
    reader = csv.reader((f"{line}\n" for line in lines), delimiter=mark, skipinitialspace=True, strict=True)
    found: list[TableLine] = []
    n_cells, number = 0, 1
    while True:
        try:
            read = next(reader, None)
        except csv.Error as err:
            problem = str(err).replace("unexpected end of data", "a quotation mark is not closed")
            raise TableError(f"{table}: line {number}: {problem}") from err
        if read is None:
            return found
        cells = [" ".join(cell.split("\n")).strip() for cell in read]
        line = TableLine(number, cells, table)
        number = reader.line_num + 1
        if len(cells) > MOST_COLUMNS:
            raise TableError(f"{line.place}: more than {MOST_COLUMNS} columns")
        n_cells = n_cells or len(cells)
        is_short = len(cells) < n_cells
        if mark == "," and any(cells) and len(cells) != n_cells and not (is_short and may_be_short):
            raise TableError(
                f"{line.place}: {len(cells)} cells where the first line has {n_cells}:"
                " part columns by semicolons where commas are decimal marks"
            )
        while cells and not cells[-1]:
            cells.pop()
        if cells:
            found.append(line)


def _mark(lines: Sequence[str]) -> str:
    """Return the mark between cells: one of the first line if it has any, for notes further down may have others."""
    bare = [unquoted for line in lines if (unquoted := QUOTED.sub("", line).strip())]
    shown = (mark for some in (bare[:1], bare) for mark in "\t;," if any(mark in line for line in some))
    return next(shown, ",")


def tabbed(rows: Iterable[Sequence[str]]) -> str:
    """Return cells as text with tabs between them, which `lines_of` reads back."""
    quoted = (
        (f'"{cell.replace(chr(34), chr(34) * 2)}"' if '"' in cell else cell for cell in row) for row in rows
    )
    return "".join("\t".join(row) + "\n" for row in quoted)
