"""Tables of sievings as laboratories paste them: the words of the head say what a column is, the rest must agree.

A table is read in one way or refused: what could mean two things is an error that says what to write instead.
"""

import csv
import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from enum import StrEnum
from itertools import pairwise, zip_longest
from typing import NamedTuple

from pipeline.gradation.curve import retained_to_passing
from service.lots.laboratory import MOST_SIEVES, Sieving, SievingError

MOST_COLUMNS = 20
APERTURES_MM = (0.02, 200.0)
"""Least and greatest aperture: ISO 3310-1 begins at 0.02 mm."""
MOST_PERCENT = 100.5
"""Sums of rounded percents may end a little above 100."""
PAN = frozenset({"pan", "boden", "receiver", "schale", "siebboden", "auffangschale"})
"""Words for what passes the last sieve, beside the aperture 0; all but two are German."""
TOTAL = frozenset({"sum", "total", "summe", "gesamt"})
"""Words for the line that adds a column up."""
BLANK = frozenset({"", "-", "–", "—"})
NUMBER = re.compile(r"([0-9.,'’\s]*+)([^0-9.,'’\s][^0-9]*+)?")
MARKS = {".": r"[,'’\s]", ",": r"[.'’\s]"}
"""Decimal marks, each with the marks that may then part the thousands."""
MARK_NAMES = {".": "point", ",": "comma"}
WRITTEN = {
    mark: re.compile(
        rf"(?:[0-9]++|[1-9][0-9]{{0,2}}+({parts})[0-9]{{3}}+(?:\1[0-9]{{3}}+)*+)?(?:[{mark}]([0-9]*+))?"
    )
    for mark, parts in MARKS.items()
}
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
SOURCES = (
    (Word.RETAINED, Quantity.MASS),
    (Word.CUMULATIVE, Quantity.MASS),
    (Word.PASSING, Quantity.PERCENT),
    (Word.RETAINED, Quantity.PERCENT),
    (Word.CUMULATIVE, Quantity.PERCENT),
)
"""Columns that a sieving can be read from, the best first."""
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
    def title(self) -> str:
        if self.kind is Word.LOT:
            return f"column {self.number}: lot"
        kind = "cumulative retained" if self.kind is Word.CUMULATIVE else self.kind
        return f"column {self.number}: {kind} in {self.unit_name}"


class TableLine(NamedTuple):
    """A line of the table that is not empty."""

    number: int
    cells: list[str]

    def cell(self, column: LabColumn) -> str:
        return self.cells[column.number - 1] if column.number <= len(self.cells) else ""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class SieveRow:
    """A line of the table: a sieve, the pan (0 mm) or the sum (None), with its numbers by column."""

    line: int
    sieve_mm: float | None
    numbers: Mapping[int, Number]

    @property
    def name(self) -> str:
        what = "sum" if self.sieve_mm is None else f"sieve {self.sieve_mm:g} mm" if self.sieve_mm else "pan"
        return f"table: line {self.line}: {what}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadTable:
    """A sieving as a table has it."""

    sieving: Sieving
    understood: str  # how the table was read: "column 1: aperture in µm; column 2: passing in %"
    line: int  # first line of the sieving, from 1


def read_table(text: str) -> ReadTable:
    """Read the table of one sieving; raise `SievingError` as `read_tables` does, or if it has a column of lots."""
    tables = read_tables(text)
    if None not in tables:
        raise SievingError("table: has a column of lots: leave it out, or send the table to POST /sievings")
    return tables[None]


def read_tables(text: str) -> dict[str | None, ReadTable]:
    """Read sievings as they are copied from a spreadsheet or a laboratory's sheet, by lot.

    Columns are parted by semicolons or tabs, or commas alone. Without a column of lots there is one sieving, of None.
    The head names columns in English or German: aperture in mm or µm; retained in g, kg, lb or %, also cumulative;
    passing in %. Without a head there are two columns: aperture in mm, retained in g. A unit behind a number wins.
    Of several columns the masses count, and the others must agree with them within rounding.

    Raises
    ------
    SievingError
        The table cannot be read in one way alone, or contradicts itself; names the line, and what to write instead.
    """
    written = _lines(text)
    if not written:
        raise SievingError("table: needs sieves: lines of an aperture and what is retained")
    columns, lines = _columns(written)
    columns = [_with_unit(column, lines) for column in columns if _is_used(column, lines)]
    apertures = [column for column in columns if column.kind is Word.APERTURE]
    if len(apertures) != 1:
        raise SievingError(
            f"table: {len(apertures)} columns of apertures: the head must name one, as 'Sieve mm'"
        )
    names = [_sieve_name(line, apertures[0]) for line in lines]
    cells = [
        cell
        for line, name in zip(lines, names, strict=True)
        for column in columns
        if (cell := _cell(line, column, name)) is not None
    ]
    numbers, mark = _numbers(cells)
    understood = [*(column.title for column in columns), *([f"decimal {MARK_NAMES[mark]}"] if mark else [])]
    rows: dict[str | None, list[SieveRow]] = {}
    lot_column = next((column for column in columns if column.kind is Word.LOT), None)
    for line, name in zip(lines, names, strict=True):
        row = _row(line.number, name, apertures[0], numbers.get(line.number, {}))
        rows.setdefault(_lot(line, lot_column), []).append(row)
    if not rows:
        raise SievingError("table: needs sieves below its head")
    return {
        lot: ReadTable(sieving=_sieving(of, columns), understood="; ".join(understood), line=of[0].line)
        for lot, of in rows.items()
    }


def _lines(text: str) -> list[TableLine]:
    """Return the lines that have cells; raise `SievingError` if commas part them into more or fewer than the first."""
    lines = unicodedata.normalize("NFKC", text.removeprefix("\ufeff")).splitlines()
    named = SEPARATOR.fullmatch(lines[0].lower()) if lines else None
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


def _columns(lines: Sequence[TableLine]) -> tuple[list[LabColumn], Sequence[TableLine]]:
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
        return [_column(first.number, i, text) for i, text in enumerate(head, start=1)], below
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
    units = {UNITS[unit] for line in lines if (unit := _written(line.cell(column))[1]) in UNITS}
    quantities = {quantity for quantity, _ in units}
    usual = {Word.APERTURE: Quantity.LENGTH, Word.PASSING: Quantity.PERCENT}.get(column.kind, Quantity.MASS)
    is_usual = column.kind in (Word.APERTURE, Word.PASSING) or Word.MASS in column.words
    if len(quantities) > 1 or not (quantities or is_usual or column.kind is Word.RETAINED):
        raise SievingError(
            f"table: column {column.number}: write its unit in the head: mm, µm, g, kg, lb or %"
        )
    quantity = quantities.pop() if quantities else usual
    return replace(column, quantity=quantity, unit_name=quantity, is_unit_assumed=not units)


def _written(cell: str) -> tuple[str, str]:
    """Return the digits with their marks, and the unit behind them in lower case; both empty if it is no number."""
    found = NUMBER.fullmatch(cell)
    return (found[1].strip(), (found[2] or "").strip().lower()) if found else ("", "")


def _sieve_name(line: TableLine, column: LabColumn) -> str:
    """Return the name of a sieve in lower case; raise `SievingError` if there is none."""
    name = line.cell(column).lower()
    if name in BLANK:
        raise SievingError(f"table: line {line.number}: has no aperture in column {column.number}")
    return name


def _cell(line: TableLine, column: LabColumn, name: str) -> Cell | None:
    """Return a number of the table, None for an empty cell and a word; raise `SievingError` for other texts."""
    text = line.cell(column)
    is_word = column.kind is Word.APERTURE and name in PAN | TOTAL
    if column.kind is Word.LOT or text in BLANK or is_word:
        return None
    digits, unit = _written(text)
    cell = Cell(line=line.number, column=column, text=text, digits=digits, unit=column.unit)
    if not digits or (unit and unit not in UNITS):
        raise SievingError(f"{cell.place} is not a number")
    if not unit:
        return cell
    quantity, size = UNITS[unit]
    if quantity is not column.quantity:
        raise SievingError(f"{cell.place} is in {unit}, but the column in {column.unit_name}")
    return replace(cell, unit=size)


def _numbers(cells: Sequence[Cell]) -> tuple[dict[int, dict[int, Number]], str | None]:
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


def _row(line: int, name: str, apertures: LabColumn, numbers: Mapping[int, Number]) -> SieveRow:
    aperture = numbers.get(apertures.number)
    sieve_mm = None if name in TOTAL else aperture.value if aperture else 0.0
    return SieveRow(line=line, sieve_mm=sieve_mm, numbers=numbers)


def _lot(line: TableLine, column: LabColumn | None) -> str | None:
    if column is None:
        return None
    lot = line.cell(column)
    if not lot:
        raise SievingError(f"table: line {line.number}: column {column.number} names no lot")
    return lot


def _sieving(rows: Sequence[SieveRow], columns: Sequence[LabColumn]) -> Sieving:
    """Return the sieving that rows of one lot hold; raise `SievingError` if they contradict each other."""
    sizes = [row.sieve_mm for row in rows]
    for i, row in enumerate(rows):
        if row.sieve_mm in sizes[:i]:
            raise SievingError(f"{row.name} is there twice")
        if i - sizes[:i].count(0.0) - sizes[:i].count(None) >= MOST_SIEVES and row.sieve_mm:
            raise SievingError(f"{row.name}: more than {MOST_SIEVES} sieves")
    source = _source(columns)
    sieves = sorted((row for row in rows if row.sieve_mm), key=lambda row: -(row.sieve_mm or 0.0))
    pan = next((row for row in rows if row.sieve_mm == 0), None)
    sieving = _taken(source, sieves, pan)
    _check(
        sieving,
        source,
        columns,
        [*sieves, *([pan] if pan else []), *(row for row in rows if row.sieve_mm is None)],
    )
    return sieving


def _source(columns: Sequence[LabColumn]) -> LabColumn:
    """Return the column that the sieving is read from."""
    by_meaning: dict[tuple[Word, Quantity | None], LabColumn] = {}
    for column in columns:
        same = by_meaning.setdefault((column.kind, column.quantity), column)
        if same is not column:
            raise SievingError(f"table: {same.title} and {column.title} are both there: leave one out")
    for meaning in SOURCES:
        found = by_meaning.get(meaning)
        if found and (found.kind is not Word.CUMULATIVE or Word.RETAINED in found.words):
            return found
    raise SievingError(f"table: no column tells what is retained or passing: name it in the head: {EXAMPLES}")


def _taken(source: LabColumn, sieves: Sequence[SieveRow], pan: SieveRow | None) -> Sieving:
    """Return the sieving by the column that it is read from, of sieves from the largest to the smallest."""
    for row in sieves:
        if source.number not in row.numbers:
            raise SievingError(f"{row.name}: column {source.number} is empty: write 0 where nothing is")
    values = {row.sieve_mm or 0.0: row.numbers[source.number].value for row in sieves}
    in_pan = None if pan is None or source.number not in pan.numbers else pan.numbers[source.number]
    total = sum(values.values()) + (in_pan.value if in_pan else 0.0)
    rounding = sum(row.numbers[source.number].half_digit for row in sieves) + (
        in_pan.half_digit if in_pan else 0.0
    )
    is_like_percent = abs(total - 100) <= 1 and Word.MASS not in source.words
    if source.is_unit_assumed and (
        max(values.values(), default=100.0) < 100 - rounding
        if source.kind is Word.PASSING
        else source.kind is Word.RETAINED and is_like_percent
    ):
        raise SievingError(f"table: column {source.number}: write its unit in the head: g, kg, lb or %")
    if source.kind is not Word.RETAINED:
        _require_order(source, sieves)
    last = list(values.values())[-1] if values else 0.0
    match source.kind, source.quantity:
        case Word.RETAINED, Quantity.MASS:
            return Sieving(retained_g=values, pan_g=in_pan.value if in_pan else 0.0)
        case Word.CUMULATIVE, Quantity.MASS:
            steps = [0.0, *values.values()]
            retained_g = {sieve_mm: b - a for sieve_mm, (a, b) in zip(values, pairwise(steps), strict=True)}
            return Sieving(retained_g=retained_g, pan_g=in_pan.value - last if in_pan else 0.0)
        case Word.RETAINED, _:
            if abs(total - 100) > rounding + 1e-9:
                raise SievingError(f"table: column {source.number}: percents add up to {total:g}, not to 100")
            passing = retained_to_passing(values, in_pan.value if in_pan else 0.0)
        case Word.CUMULATIVE, _:
            passing = {sieve_mm: 100 - value for sieve_mm, value in values.items()}
        case _:
            passing = values
    within = {sieve_mm: min(max(value, 0.0), 100.0) for sieve_mm, value in passing.items()}  # rounded sums
    return Sieving(given_passing_percent=within)


def _require_order(source: LabColumn, sieves: Sequence[SieveRow]) -> None:
    """Raise `SievingError` unless passing falls with falling sieves, or what is retained rises."""
    sign = 1 if source.kind is Word.PASSING else -1
    for larger, row in pairwise(sieves):
        value, before = row.numbers[source.number].value, larger.numbers[source.number].value
        if sign * value > sign * before:
            word = "falls" if sign > 0 else "rises"
            raise SievingError(
                f"{row.name}: {value:g} after {before:g} at {larger.sieve_mm:g} mm,"
                f" but {source.kind} {word} with falling sieves"
            )


def _check(
    sieving: Sieving, source: LabColumn, columns: Sequence[LabColumn], rows: Sequence[SieveRow]
) -> None:
    """Raise `SievingError` if a column disagrees with the sieving beyond rounding, of rows from the largest sieve on.

    Each rounded summand of a cumulated number may be off by half of its last digit.
    """
    passing, mass_g = sieving.passing_percent, sieving.mass_g
    source_half = max(row.numbers[source.number].half_digit for row in rows if source.number in row.numbers)
    if source.quantity is Quantity.MASS and mass_g is not None:
        source_half *= 100 / mass_g  # in percent
    above = 100.0
    for i, row in enumerate(rows):
        here = passing[row.sieve_mm] if row.sieve_mm else 0.0
        above = 100.0 if row.sieve_mm is None else above
        shares = {Word.RETAINED: above - here, Word.CUMULATIVE: 100 - here, Word.PASSING: here}
        for column in columns:
            number = row.numbers.get(column.number)
            if number is None or column.kind not in shares or (column is source and row.sieve_mm):
                continue
            if column.quantity is Quantity.MASS and mass_g is None:
                raise SievingError(f"table: {column.title}: leave it out: no column has the masses retained")
            size = (mass_g or 0.0) / 100 if column.quantity is Quantity.MASS else 1.0  # of a percent
            expected = shares[column.kind] * size
            steps = 1 if column.kind is Word.RETAINED and row.sieve_mm else i + 1
            if column is source and row.sieve_mm == 0:
                steps = 0  # of passing, the pan has none; of what is retained, all
            rounding = (steps + 1) * (number.half_digit + source_half * size)
            if abs(number.value - expected) > rounding + 1e-6:
                raise SievingError(
                    f"{row.name}: {column.title} is {number.value / column.unit:g}, but"
                    f" {expected / column.unit:.4g} follows from {source.title}"
                )
        above = here
