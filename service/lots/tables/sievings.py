"""Tables of sievings as laboratories paste them: the words of the head say what a column is, the rest must agree.

A table is read in one way or refused: what could mean two things is an error that says what to write instead.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from pipeline.gradation.curve import retained_to_passing
from service.base.messages import Code, joined, message
from service.base.tables.lines import TableError, TableLine, lines_of
from service.base.tables.numbers import BLANK, Number, Quantity, numbers_of
from service.lots.laboratory import MOST_SIEVES, Sieving
from service.lots.tables.heads import EXAMPLES, TOTAL, LabColumn, Word, cell_of, columns_of

MARK_NAMES = {".": "point", ",": "comma"}
SOURCES = (
    (Word.RETAINED, Quantity.MASS),
    (Word.CUMULATIVE, Quantity.MASS),
    (Word.PASSING, Quantity.PERCENT),
    (Word.RETAINED, Quantity.PERCENT),
    (Word.CUMULATIVE, Quantity.PERCENT),
)
"""Columns that a sieving can be read from, the best first."""


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
    lot: str = ""  # of a table of many


def read_table(text: str) -> ReadTable:
    """Read the table of one sieving; raise `TableError` as `read_tables` does, or if it has a column of lots."""
    tables = read_tables(text)
    if None not in tables:
        raise TableError("table: has a column of lots: leave it out, or send the table to POST /sievings")
    return tables[None]


def read_tables(text: str) -> dict[str | None, ReadTable]:
    """Read sievings as they are copied from a spreadsheet or a laboratory's sheet, by lot.

    Columns are parted by semicolons or tabs, or commas alone. Without a column of lots there is one sieving, of None.
    The head names columns in English or German: aperture in mm or µm; retained in g, kg, lb or %, also cumulative;
    passing in %. Without a head there are two columns: aperture in mm, retained in g. A unit behind a number wins.
    Of several columns the masses count, and the others must agree with them within rounding.

    Raises
    ------
    TableError
        The table cannot be read in one way alone, or contradicts itself; names the line, and what to write instead.
    """
    written = lines_of(text)
    if not written:
        raise TableError("table: needs sieves: lines of an aperture and what is retained")
    columns, lines = columns_of(written)
    apertures = [column for column in columns if column.kind is Word.APERTURE]
    if len(apertures) != 1:
        raise TableError(
            f"table: {len(apertures)} columns of apertures: the head must name one, as 'Sieve mm'"
        )
    names = [_sieve_name(line, apertures[0]) for line in lines]
    cells = [
        cell
        for line, name in zip(lines, names, strict=True)
        for column in columns
        if (cell := cell_of(line, column, name)) is not None
    ]
    numbers, mark = numbers_of(cells)
    marks = [message(Code(f"decimal_{MARK_NAMES[mark]}"))] if mark else []
    understood = joined([*(column.title for column in columns), *marks])
    rows: dict[str | None, list[SieveRow]] = {}
    lot_column = next((column for column in columns if column.kind is Word.LOT), None)
    for line, name in zip(lines, names, strict=True):
        row = _row(line.number, name, apertures[0], numbers.get(line.number, {}))
        rows.setdefault(_lot(line, lot_column), []).append(row)
    if not rows:
        raise TableError("table: needs sieves below its head")
    return {
        lot: ReadTable(sieving=_sieving(of, columns), understood=understood or "", line=of[0].line)
        for lot, of in rows.items()
    }


def _sieve_name(line: TableLine, column: LabColumn) -> str:
    """Return the name of a sieve in lower case; raise `TableError` if there is none."""
    name = line.at(column.number).lower()
    if name in BLANK:
        raise TableError(f"{line.place}: has no aperture in column {column.number}")
    return name


def _row(line: int, name: str, apertures: LabColumn, numbers: Mapping[int, Number]) -> SieveRow:
    aperture = numbers.get(apertures.number)
    sieve_mm = None if name in TOTAL else aperture.value if aperture else 0.0
    return SieveRow(line=line, sieve_mm=sieve_mm, numbers=numbers)


def _lot(line: TableLine, column: LabColumn | None) -> str | None:
    if column is None:
        return None
    lot = line.at(column.number)
    if not lot:
        raise TableError(f"{line.place}: column {column.number} names no lot")
    return lot


def _sieving(rows: Sequence[SieveRow], columns: Sequence[LabColumn]) -> Sieving:
    """Return the sieving that rows of one lot hold; raise `TableError` if they contradict each other."""
    sizes = [row.sieve_mm for row in rows]
    for i, row in enumerate(rows):
        if row.sieve_mm in sizes[:i]:
            raise TableError(f"{row.name} is there twice")
        if i - sizes[:i].count(0.0) - sizes[:i].count(None) >= MOST_SIEVES and row.sieve_mm:
            raise TableError(f"{row.name}: more than {MOST_SIEVES} sieves")
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
            raise TableError(f"table: {same.title} and {column.title} are both there: leave one out")
    for meaning in SOURCES:
        found = by_meaning.get(meaning)
        if found and (found.kind is not Word.CUMULATIVE or Word.RETAINED in found.words):
            return found
    raise TableError(f"table: no column tells what is retained or passing: name it in the head: {EXAMPLES}")


def _taken(source: LabColumn, sieves: Sequence[SieveRow], pan: SieveRow | None) -> Sieving:
    """Return the sieving by the column that it is read from, of sieves from the largest to the smallest."""
    for row in sieves:
        if source.number not in row.numbers:
            raise TableError(f"{row.name}: column {source.number} is empty: write 0 where nothing is")
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
        raise TableError(f"table: column {source.number}: write its unit in the head: g, kg, lb or %")
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
                raise TableError(f"table: column {source.number}: percents add up to {total:g}, not to 100")
            passing = retained_to_passing(values, in_pan.value if in_pan else 0.0)
        case Word.CUMULATIVE, _:
            passing = {sieve_mm: 100 - value for sieve_mm, value in values.items()}
        case _:
            passing = values
    within = {sieve_mm: min(max(value, 0.0), 100.0) for sieve_mm, value in passing.items()}  # rounded sums
    return Sieving(given_passing_percent=within)


def _require_order(source: LabColumn, sieves: Sequence[SieveRow]) -> None:
    """Raise `TableError` unless passing falls with falling sieves, or what is retained rises."""
    sign = 1 if source.kind is Word.PASSING else -1
    for larger, row in pairwise(sieves):
        value, before = row.numbers[source.number].value, larger.numbers[source.number].value
        if sign * value > sign * before:
            word = "falls" if sign > 0 else "rises"
            raise TableError(
                f"{row.name}: {value:g} after {before:g} at {larger.sieve_mm:g} mm,"
                f" but {source.kind} {word} with falling sieves"
            )


def _check(
    sieving: Sieving, source: LabColumn, columns: Sequence[LabColumn], rows: Sequence[SieveRow]
) -> None:
    """Raise `TableError` if a column disagrees with the sieving beyond rounding, of rows from the largest sieve on.

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
                raise TableError(f"table: {column.title}: leave it out: no column has the masses retained")
            size = (mass_g or 0.0) / 100 if column.quantity is Quantity.MASS else 1.0  # of a percent
            expected = shares[column.kind] * size
            steps = 1 if column.kind is Word.RETAINED and row.sieve_mm else i + 1
            if column is source and row.sieve_mm == 0:
                steps = 0  # of passing, the pan has none; of what is retained, all
            rounding = (steps + 1) * (number.half_digit + source_half * size)
            if abs(number.value - expected) > rounding + 1e-6:
                raise TableError(
                    f"{row.name}: {column.title} is {number.value / column.unit:g}, but"
                    f" {expected / column.unit:.4g} follows from {source.title}"
                )
        above = here
