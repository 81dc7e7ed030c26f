"""Numbers of tables, with their units: a decimal mark that fits all of them, or what has two readings is refused."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from enum import StrEnum
from itertools import zip_longest
from typing import NamedTuple

from service.base.tables.lines import TableError, TableLine

NUMBER = re.compile(r"([0-9.,'’\s]*+)(?:e([+-]?[0-9]{1,2}))?\s*([^0-9.,'’\s][^0-9]*+)?", re.IGNORECASE)
"""Digits with their marks, a power of ten, a unit."""
TOKEN = re.compile(r"[^\W\d_]+|[^\s()\[\]{}.,:;/*_–—-]")
"""Word or sign of a head."""
BLANK = frozenset({"", "-", "–", "—"})
MARKS = {".": r"[,'’\s]", ",": r"[.'’\s]"}
"""Decimal marks, each with the marks that may then part the thousands."""
WRITTEN = {
    mark: re.compile(
        rf"(?:[0-9]++|[1-9][0-9]{{0,2}}+({parts})[0-9]{{3}}+(?:\1[0-9]{{3}}+)*+)?(?:[{mark}]([0-9]*+))?"
    )
    for mark, parts in MARKS.items()
}


class Quantity(StrEnum):
    """Physical quantity of a column, by its unit in the store."""

    LENGTH = "mm"
    MASS = "g"
    PERCENT = "%"


UNITS = {
    **dict.fromkeys(("mm", "millimetre", "millimeter"), (Quantity.LENGTH, 1.0)),
    **dict.fromkeys(("μm", "um", "micron", "microns", "mikrometer"), (Quantity.LENGTH, 1e-3)),
    **dict.fromkeys(("g", "gram", "grams", "gramm"), (Quantity.MASS, 1.0)),
    **dict.fromkeys(("kg", "kilogram", "kilograms", "kilogramm"), (Quantity.MASS, 1000.0)),
    **dict.fromkeys(("lb", "lbs", "pound", "pounds"), (Quantity.MASS, 453.59237)),
    **dict.fromkeys(("%", "percent", "percentage", "prozent"), (Quantity.PERCENT, 1.0)),
}
"""Quantity and size of each unit, in mm, g or %; the pound is the international one of 1959."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableColumn:
    """A column of a table, by its head."""

    number: int  # from 1
    quantity: Quantity | None = None
    unit: float = 1.0  # in mm, g or %
    unit_name: str = ""


class Number(NamedTuple):
    """A number as it was read, in mm, g or %."""

    value: float
    half_digit: float  # half of the last digit's place


class Limits(NamedTuple):
    """Least and greatest number beside 0 that a cell may hold, in mm, g or %."""

    low: float = 0.0
    high: float = float("inf")
    why: str = ""
    """What is said of a number beyond them."""


ANY = Limits()


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A number as it is written in a table."""

    line: TableLine
    column: TableColumn
    text: str
    digits: str
    power: int | None  # of ten, behind an E
    unit: float  # in mm, g or %
    limits: Limits

    @property
    def place(self) -> str:
        return f"{self.line.place}: column {self.column.number}: {self.text[:40]!r}"

    def number(self, mark: str) -> Number | None:
        """Return the number with this decimal mark; None if it is not written so."""
        written = WRITTEN[mark].fullmatch(self.digits)
        plain = re.sub(MARKS[mark], "", self.digits).replace(mark, ".")
        is_grouped_power = written is not None and written[1] is not None and self.power is not None
        if written is None or is_grouped_power or plain in ("", "."):
            return None
        power = self.power or 0
        value = Decimal(plain).scaleb(power) * Decimal(str(self.unit))  # 5600 µm are 5.6 mm to the last bit
        return Number(float(value), 0.5 * self.unit * 10.0 ** (power - len(written[2] or "")))

    def numbers(self, marks: Sequence[str]) -> list[Number]:
        """Return the numbers that it may be: each possible value once."""
        found = {each.value: each for mark in marks if (each := self.number(mark)) is not None}
        low, high, _ = self.limits
        return [each for each in found.values() if each.value == 0 or low <= each.value <= high]


def head_and_rows(lines: Sequence[TableLine]) -> tuple[TableLine, Sequence[TableLine]]:
    """Return the head, with the units of a second line of it, and the lines below."""
    head, *below = lines
    if below and all(cell.lower().strip("()[]") in ("", *UNITS) for cell in below[0].cells):
        cells = [" ".join(both).strip() for both in zip_longest(head.cells, below[0].cells, fillvalue="")]
        return head._replace(cells=cells), below[1:]
    return head, below


def written(cell: str) -> tuple[str, int | None, str]:
    """Return the digits with their marks, the power of ten, and the unit in lower case; empty if it is no number."""
    found = NUMBER.fullmatch(cell)
    if found is None:
        return "", None, ""
    return found[1].strip(), None if found[2] is None else int(found[2]), (found[3] or "").strip().lower()


def cell_of(line: TableLine, column: TableColumn, limits: Limits = ANY) -> Cell | None:
    """Return a number of the table, None for an empty cell; raise `TableError` for a text, or another quantity."""
    text = line.at(column.number)
    if text in BLANK:
        return None
    digits, power, unit = written(text)
    quantity, size = UNITS.get(unit, (column.quantity, column.unit))
    cell = Cell(line=line, column=column, text=text, digits=digits, power=power, unit=size, limits=limits)
    if not digits or (unit and unit not in UNITS):
        raise TableError(f"{cell.place} is not a number")
    if quantity is not column.quantity:
        raise TableError(f"{cell.place} is in {unit}, but the column in {column.unit_name}")
    return cell


def numbers_of(cells: Sequence[Cell]) -> tuple[dict[int, dict[int, Number]], str | None]:
    """Return the numbers by line and column, and the decimal mark if one alone fits all of them.

    Raises `TableError` for a number that is none, is beyond what may be, or has two readings.
    """
    fitting = [mark for mark in MARKS if all(cell.numbers([mark]) for cell in cells)]
    found: dict[int, dict[int, Number]] = {}
    for cell in cells:
        readings = cell.numbers(fitting or list(MARKS))
        if not readings:
            is_number = any(cell.number(mark) for mark in MARKS)
            raise TableError(f"{cell.place} {cell.limits.why if is_number else 'is not a number'}")
        if len(readings) > 1:
            values = " or ".join(f"{each.value / cell.unit:.15g}" for each in readings)
            raise TableError(
                f"{cell.place} may be {values}: write all digits without a mark, or a decimal more, such as"
                f" {cell.digits}0"
            )
        found.setdefault(cell.line.number, {})[cell.column.number] = readings[0]
    return found, fitting[0] if len(fitting) == 1 else None
