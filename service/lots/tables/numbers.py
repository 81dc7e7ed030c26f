"""Numbers of tables of sievings: a decimal mark that fits all of them, or what has two readings is refused."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import NamedTuple

from service.lots.laboratory import SievingError
from service.lots.tables.heads import UNITS, LabColumn, Quantity, TableLine, Word, written

APERTURES_MM = (0.02, 200.0)
"""Least and greatest aperture: ISO 3310-1 begins at 0.02 mm."""
MOST_PERCENT = 100.5
"""Sums of rounded percents may end a little above 100."""
PAN = frozenset({"pan", "boden", "receiver", "schale", "siebboden", "auffangschale"})
"""Words for what passes the last sieve, beside the aperture 0; all but two are German."""
TOTAL = frozenset({"sum", "total", "summe", "gesamt"})
"""Words for the line that adds a column up."""
BLANK = frozenset({"", "-", "–", "—"})
MARKS = {".": r"[,'’\s]", ",": r"[.'’\s]"}
"""Decimal marks, each with the marks that may then part the thousands."""
MARK_NAMES = {".": "point", ",": "comma"}
WRITTEN = {
    mark: re.compile(
        rf"(?:[0-9]++|[1-9][0-9]{{0,2}}+({parts})[0-9]{{3}}+(?:\1[0-9]{{3}}+)*+)?(?:[{mark}]([0-9]*+))?"
    )
    for mark, parts in MARKS.items()
}


class Number(NamedTuple):
    """A number as it was read, in mm, g or %."""

    value: float
    half_digit: float  # half of the last digit's place


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """A number as it is written in a table."""

    line: int
    column: LabColumn
    text: str
    digits: str
    unit: float  # in mm, g or %

    @property
    def place(self) -> str:
        return f"table: line {self.line}: column {self.column.number}: {self.text[:40]!r}"

    def number(self, mark: str) -> Number | None:
        """Return the number with this decimal mark; None if it is not written so."""
        written = WRITTEN[mark].fullmatch(self.digits)
        plain = re.sub(MARKS[mark], "", self.digits).replace(mark, ".")
        if written is None or plain in ("", "."):
            return None
        value = float(Decimal(plain) * Decimal(str(self.unit)))  # 5600 µm are 5.6 mm to the last bit
        return Number(value, 0.5 * self.unit * 10.0 ** -len(written[2] or ""))

    def numbers(self, marks: Sequence[str]) -> list[Number]:
        """Return the numbers that it may be: each possible value once."""
        found = {each.value: each for mark in marks if (each := self.number(mark)) is not None}
        return [each for each in found.values() if self._is_possible(each.value)]

    def _is_possible(self, value: float) -> bool:
        low, high = APERTURES_MM
        if self.column.quantity is Quantity.LENGTH:
            return value == 0 or low * (1 - 1e-9) <= value <= high
        return self.column.quantity is Quantity.MASS or value <= MOST_PERCENT


def cell_of(line: TableLine, column: LabColumn, name: str) -> Cell | None:
    """Return a number of the table, None for an empty cell and a word; raise `SievingError` for other texts."""
    text = line.cell(column)
    is_word = column.kind is Word.APERTURE and name in PAN | TOTAL
    if column.kind is Word.LOT or text in BLANK or is_word:
        return None
    digits, unit = written(text)
    cell = Cell(line=line.number, column=column, text=text, digits=digits, unit=column.unit)
    if not digits or (unit and unit not in UNITS):
        raise SievingError(f"{cell.place} is not a number")
    if not unit:
        return cell
    quantity, size = UNITS[unit]
    if quantity is not column.quantity:
        raise SievingError(f"{cell.place} is in {unit}, but the column in {column.unit_name}")
    return replace(cell, unit=size)


def numbers_of(cells: Sequence[Cell]) -> tuple[dict[int, dict[int, Number]], str | None]:
    """Return the numbers by line and column, and the decimal mark if one alone fits all of them.

    Raises `SievingError` for a number that is none, is beyond what may be, or has two readings.
    """
    fitting = [mark for mark in MARKS if all(cell.numbers([mark]) for cell in cells)]
    found: dict[int, dict[int, Number]] = {}
    for cell in cells:
        readings = cell.numbers(fitting or list(MARKS))
        if not readings:
            raise SievingError(f"{cell.place} {_why_impossible(cell)}")
        if len(readings) > 1:
            values = " or ".join(f"{each.value / cell.unit:.15g}" for each in readings)
            raise SievingError(
                f"{cell.place} may be {values}: write all digits without a mark, or a decimal more, such as"
                f" {cell.digits}0"
            )
        found.setdefault(cell.line, {})[cell.column.number] = readings[0]
    return found, fitting[0] if len(fitting) == 1 else None


def _why_impossible(cell: Cell) -> str:
    if not any(cell.number(mark) for mark in MARKS):
        return "is not a number"
    if cell.column.quantity is Quantity.LENGTH:
        return "is no aperture from {:g} to {:g} mm: name the unit in the head".format(*APERTURES_MM)
    return "is more than 100 %"
