"""Heads of tables of sievings: their words, in English and German, say what each column is."""

import csv
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import zip_longest
from typing import NamedTuple

from service.base.messages import Code, CodedText, message
from service.lots.laboratory import SievingError

MOST_LINES = 10_000
MOST_COLUMNS = 20
NUMBER = re.compile(r"([0-9.,'’\s]*+)([^0-9.,'’\s][^0-9]*+)?")
SEPARATOR = re.compile(r"sep=([;,\t])")
"""First line of a file that a spreadsheet is to open."""
TOKEN = re.compile(r"[^\W\d_]+|[^\s()\[\]{}.,:;/*_–—-]")
PERCENT_OF_MASS = re.compile(r"\bma?\.? ?-? ?%")
"""German: M.-%, Ma.-%."""


class Quantity(StrEnum):
    """Physical quantity of a column, by its unit in the store."""

    LENGTH = "mm"
    MASS = "g"
    PERCENT = "%"


class Word(StrEnum):
    """Subject of a word of the head, and with it of a column."""

    PASSING = "passing"
    CUMULATIVE = "cumulative"
    RETAINED = "retained"
    LOT = "lot"
    APERTURE = "aperture"
    MASS = "mass"
    OTHER = "other"


WORDS = {
    Word.PASSING: r"passing|passed|finer|undersize|\w*durchg[aä]nge?|durchgangssumme",
    Word.CUMULATIVE: r"cum|cumul|cumulative|cumulated|kum|kumuliert\w*|kumulativ\w*|\w*summe",
    Word.RETAINED: r"retained|residue|\w*r(ü|ue)ckst[aä]nd(e|ssumme)?",
    Word.LOT: r"lot|los|charge|batch",
    Word.APERTURE: r"sieves?|apertures?|openings?|sizes?|mesh|d|ø|siebe?|pr(ü|ue)fsiebe?|sieb(größen?|öffnung(en)?)"
    r"|(sieb|maschen|siebmaschen|loch|nenn)weiten?|korngr(ö|oe)(ß|ss)en?|diameter|durchmesser",
    Word.MASS: r"mass(es)?|massen?|weights?|wt|gewichte?|gew",
    Word.OTHER: r"of|the|on|each|by|in|and|than|material|soil|individual|einzeln\w*|auf|dem|der|je|am"
    r"|particle|grain|is|iso|din|en|astm|square|nominal|ri",
}
"""Regular expressions of the words of a head, in lower case; English and German."""
UNITS = {
    **dict.fromkeys(("mm", "millimetre", "millimeter"), (Quantity.LENGTH, 1.0)),
    **dict.fromkeys(("μm", "um", "micron", "microns", "mikrometer"), (Quantity.LENGTH, 1e-3)),
    **dict.fromkeys(("g", "gram", "grams", "gramm"), (Quantity.MASS, 1.0)),
    **dict.fromkeys(("kg", "kilogram", "kilograms", "kilogramm"), (Quantity.MASS, 1000.0)),
    **dict.fromkeys(("lb", "lbs", "pound", "pounds"), (Quantity.MASS, 453.59237)),
    **dict.fromkeys(("%", "percent", "percentage", "prozent"), (Quantity.PERCENT, 1.0)),
}
"""Quantity and size of each unit, in mm, g or %; the pound is the international one of 1959."""
EXAMPLES = "'Sieve mm', 'Sieve µm', 'Retained g', 'Retained %', 'Cumulative retained %', 'Passing %'"


@dataclass(frozen=True, slots=True, kw_only=True)
class LabColumn:
    """A column of a table, as its head and its cells say it."""

    number: int  # from 1
    kind: Word
    words: frozenset[Word]
    quantity: Quantity | None
    unit: float = 1.0  # in mm, g or %
    unit_name: str = ""
    is_unit_assumed: bool = False

    @property
    def title(self) -> CodedText:
        unit = {} if self.kind is Word.LOT else {"unit": self.unit_name}
        return message(Code(f"column_{self.kind}"), column=self.number, **unit)


class TableLine(NamedTuple):
    """A line of the table that is not empty."""

    number: int
    cells: list[str]

    def cell(self, column: LabColumn) -> str:
        return self.cells[column.number - 1] if column.number <= len(self.cells) else ""


def lines_of(text: str) -> list[TableLine]:
    """Return the lines that have cells; raise `SievingError` for too many, or if commas part one otherwise."""
    lines = unicodedata.normalize("NFKC", text.removeprefix("\ufeff")).splitlines()
    named = SEPARATOR.fullmatch(lines[0].lower()) if lines else None
    if len(lines) > MOST_LINES:
        raise SievingError(f"table: more than {MOST_LINES} lines: send it in parts")
    mark = (
        named[1]
        if named
        else next((each for each in ";\t" if any(each in written for written in lines)), ",")
    )
    found, n_cells = [], 0
    for number, written in enumerate(lines, start=1):
        if named is not None and number == 1:
            continue
        parted = written.replace("\t", ";") if mark == ";" else written
        try:
            cells = [cell.strip() for cell in next(csv.reader([parted], delimiter=mark), [])]
        except csv.Error as err:
            raise SievingError(f"table: line {number}: {err}") from err
        if len(cells) > MOST_COLUMNS:
            raise SievingError(f"table: line {number}: more than {MOST_COLUMNS} columns")
        n_cells = n_cells or len(cells)
        if mark == "," and any(cells) and len(cells) != n_cells:
            raise SievingError(
                f"table: line {number}: {len(cells)} cells where the first line has {n_cells}:"
                " part columns by semicolons where commas are decimal marks"
            )
        while cells and not cells[-1]:
            cells.pop()
        if cells:
            found.append(TableLine(number, cells))
    return found


def columns_of(lines: Sequence[TableLine]) -> tuple[list[LabColumn], Sequence[TableLine]]:
    """Return the columns that the head names, or those of a table without a head, and the lines below it."""
    first, *below = lines
    if not any(NUMBER.fullmatch(cell) and cell[:1].isdigit() for cell in first.cells):
        head = first.cells
        if below and all(cell.lower().strip("()[]") in ("", *UNITS) for cell in below[0].cells):
            units, *below = below  # a second line of the head
            head = [" ".join(cells) for cells in zip_longest(head, units.cells, fillvalue="")]
        for line in below:
            if len(line.cells) > len(head):
                place = f"table: line {line.number}: column {len(line.cells)}"
                raise SievingError(f"{place} has no head: write one such as {EXAMPLES}")
        named = [_column(first.number, i, text) for i, text in enumerate(head, start=1)]
        return [_with_unit(column, below) for column in named if _is_used(column, below)], below
    for line in lines:
        if len(line.cells) != 2:
            raise SievingError(
                f"table: line {line.number}: {'; '.join(line.cells)[:80]!r} is not an aperture and a mass:"
                f" write a head that names the columns, such as {EXAMPLES}"
            )
    kinds = ((Word.APERTURE, Quantity.LENGTH), (Word.RETAINED, Quantity.MASS))
    return [
        LabColumn(number=i, kind=kind, words=frozenset({kind}), quantity=quantity, unit_name=quantity)
        for i, (kind, quantity) in enumerate(kinds, start=1)
    ], lines


def _column(line: int, number: int, text: str) -> LabColumn:
    """Return a column by the text of its head; raise `SievingError` if a word is not known, or two contradict."""
    tokens = TOKEN.findall(PERCENT_OF_MASS.sub("%", text.lower()))
    units = [token for token in tokens if token in UNITS]
    words: set[Word] = set()
    for each, after in zip(tokens, [*tokens[1:], ""], strict=False):
        found = {word for word, pattern in WORDS.items() if re.fullmatch(pattern, each)}
        is_inch = each == "in" and after not in UNITS
        if is_inch or not (found or each in UNITS):
            raise _not_understood(line, number, text, each)
        words |= found
    quantity, unit = UNITS[units[0]] if units else (None, 1.0)
    kind = _kind(words, quantity)
    if kind is None or len(set(units)) > 1 or ("mesh" in tokens and not units):
        raise _not_understood(line, number, text, text)
    return LabColumn(
        number=number,
        kind=kind,
        words=frozenset(words),
        quantity=quantity,
        unit=unit,
        unit_name={"μm": "µm"}.get(units[0], units[0]) if units else "",  # as keyboards write it
    )


def _kind(words: set[Word], quantity: Quantity | None) -> Word | None:
    """Return the kind of a column, None if its words and its unit do not tell one."""
    of = words - {Word.OTHER}
    is_length, is_percent = quantity is Quantity.LENGTH, quantity is Quantity.PERCENT
    if not words and quantity is None:
        return Word.OTHER  # without a head
    if of == {Word.LOT}:
        return None if quantity else Word.LOT
    if Word.LOT in of or {Word.PASSING, Word.RETAINED} <= of:
        return None
    for kind in (Word.PASSING, Word.CUMULATIVE, Word.RETAINED):
        if kind in of:
            return None if is_length else kind
    if Word.APERTURE in of:
        return Word.APERTURE if of == {Word.APERTURE} and (is_length or quantity is None) else None
    if of == {Word.MASS}:
        return None if is_length or is_percent else Word.RETAINED
    return None if of or quantity is None or is_percent else Word.APERTURE if is_length else Word.RETAINED


def _not_understood(line: int, column: int, text: str, what: str) -> SievingError:
    return SievingError(
        f"table: line {line}: column {column}: the head {text[:40]!r} is not understood ({what[:40]!r}):"
        f" write one such as {EXAMPLES}"
    )


def _is_used(column: LabColumn, lines: Sequence[TableLine]) -> bool:
    """Return False for an empty column without a head; raise `SievingError` if it has cells."""
    if column.kind is not Word.OTHER:
        return True
    for line in lines:
        if line.cell(column):
            raise SievingError(
                f"table: line {line.number}: column {column.number} has no head: write {EXAMPLES}"
            )
    return False


def _with_unit(column: LabColumn, lines: Sequence[TableLine]) -> LabColumn:
    """Return a column with its quantity: where the head has no unit, the one of its cells, or the one that is usual."""
    if column.quantity is not None or column.kind is Word.LOT:
        return column
    units = {UNITS[unit] for line in lines if (unit := written(line.cell(column))[1]) in UNITS}
    quantities = {quantity for quantity, _ in units}
    usual = {Word.APERTURE: Quantity.LENGTH, Word.PASSING: Quantity.PERCENT}.get(column.kind, Quantity.MASS)
    is_usual = column.kind in (Word.APERTURE, Word.PASSING) or Word.MASS in column.words
    if len(quantities) > 1 or not (quantities or is_usual or column.kind is Word.RETAINED):
        raise SievingError(
            f"table: column {column.number}: write its unit in the head: mm, µm, g, kg, lb or %"
        )
    quantity = quantities.pop() if quantities else usual
    return replace(column, quantity=quantity, unit_name=quantity, is_unit_assumed=not units)


def written(cell: str) -> tuple[str, str]:
    """Return the digits with their marks, and the unit behind them in lower case; both empty if it is no number."""
    found = NUMBER.fullmatch(cell)
    return (found[1].strip(), (found[2] or "").strip().lower()) if found else ("", "")
