"""Heads of tables of sievings: their words, in English and German, say what each column is."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from service.base.messages import Code, CodedText, message
from service.base.tables.lines import TableError, TableLine
from service.base.tables.numbers import (
    ANY,
    NUMBER,
    TOKEN,
    UNITS,
    Cell,
    Limits,
    Quantity,
    TableColumn,
    head_and_rows,
    written,
)
from service.base.tables.numbers import cell_of as number_of

PERCENT_OF_MASS = re.compile(r"\bma?\.? ?-? ?%")
"""German: M.-%, Ma.-%."""


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
PAN = frozenset({"pan", "boden", "receiver", "schale", "siebboden", "auffangschale"})
"""Words for what passes the last sieve, beside the aperture 0; all but two are German."""
TOTAL = frozenset({"sum", "total", "summe", "gesamt"})
"""Words for the line that adds a column up."""
LIMITS = {
    Quantity.LENGTH: Limits(
        0.02 * (1 - 1e-9), 200.0, "is no aperture from 0.02 to 200 mm: name the unit in the head"
    ),
    Quantity.PERCENT: Limits(0.0, 100.5, "is more than 100 %"),
}
"""What an aperture and a percent may be: ISO 3310-1 begins at 0.02 mm; sums of rounded percents end above 100."""
EXAMPLES = "'Sieve mm', 'Sieve µm', 'Retained g', 'Retained %', 'Cumulative retained %', 'Passing %'"


@dataclass(frozen=True, slots=True, kw_only=True)
class LabColumn(TableColumn):
    """A column of a table, as its head and its cells say it."""

    kind: Word
    words: frozenset[Word]
    is_unit_assumed: bool = False

    @property
    def title(self) -> CodedText:
        unit = {} if self.kind is Word.LOT else {"unit": self.unit_name}
        return message(Code(f"column_{self.kind}"), column=self.number, **unit)


def columns_of(lines: Sequence[TableLine]) -> tuple[list[LabColumn], Sequence[TableLine]]:
    """Return the columns that the head names, or those of a table without a head, and the lines below it."""
    if not any(NUMBER.fullmatch(cell) and cell[:1].isdigit() for cell in lines[0].cells):
        head, below = head_and_rows(lines)
        for line in below:
            if len(line.cells) > len(head.cells):
                raise TableError(
                    f"{line.place}: column {len(line.cells)} has no head: write one such as {EXAMPLES}"
                )
        named = [_column(head, i, text) for i, text in enumerate(head.cells, start=1)]
        return [_with_unit(column, below) for column in named if _is_used(column, below)], below
    for line in lines:
        if len(line.cells) != 2:
            raise TableError(
                f"{line.place}: {'; '.join(line.cells)[:80]!r} is not an aperture and a mass:"
                f" write a head that names the columns, such as {EXAMPLES}"
            )
    kinds = ((Word.APERTURE, Quantity.LENGTH), (Word.RETAINED, Quantity.MASS))
    return [
        LabColumn(number=i, kind=kind, words=frozenset({kind}), quantity=quantity, unit_name=quantity)
        for i, (kind, quantity) in enumerate(kinds, start=1)
    ], lines


def _column(line: TableLine, number: int, text: str) -> LabColumn:
    """Return a column by the text of its head; raise `TableError` if a word is not known, or two contradict."""
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


def _not_understood(line: TableLine, column: int, text: str, what: str) -> TableError:
    return TableError(
        f"{line.place}: column {column}: the head {text[:40]!r} is not understood ({what[:40]!r}):"
        f" write one such as {EXAMPLES}"
    )


def _is_used(column: LabColumn, lines: Sequence[TableLine]) -> bool:
    """Return False for an empty column without a head; raise `TableError` if it has cells."""
    if column.kind is not Word.OTHER:
        return True
    for line in lines:
        if line.at(column.number):
            raise TableError(f"{line.place}: column {column.number} has no head: write {EXAMPLES}")
    return False


def _with_unit(column: LabColumn, lines: Sequence[TableLine]) -> LabColumn:
    """Return a column with its quantity: where the head has no unit, the one of its cells, or the one that is usual."""
    if column.quantity is not None or column.kind is Word.LOT:
        return column
    units = {UNITS[unit] for line in lines if (unit := written(line.at(column.number))[2]) in UNITS}
    quantities = {quantity for quantity, _ in units}
    usual = {Word.APERTURE: Quantity.LENGTH, Word.PASSING: Quantity.PERCENT}.get(column.kind, Quantity.MASS)
    is_usual = column.kind in (Word.APERTURE, Word.PASSING) or Word.MASS in column.words
    if len(quantities) > 1 or not (quantities or is_usual or column.kind is Word.RETAINED):
        raise TableError(f"table: column {column.number}: write its unit in the head: mm, µm, g, kg, lb or %")
    quantity = quantities.pop() if quantities else usual
    return replace(column, quantity=quantity, unit_name=quantity, is_unit_assumed=not units)


def cell_of(line: TableLine, column: LabColumn, name: str) -> Cell | None:
    """Return a number of the table, None for an empty cell and a word; raise `TableError` for other texts."""
    if column.kind is Word.LOT or (column.kind is Word.APERTURE and name in PAN | TOTAL):
        return None
    return number_of(line, column, LIMITS.get(column.quantity, ANY) if column.quantity else ANY)
