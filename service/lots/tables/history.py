"""Tables of many sievings, months of them: each lot is read by itself, or refused by itself with the reason."""

import re
from collections.abc import Mapping, Sequence, Sized
from dataclasses import replace
from datetime import datetime

from service.base.schema import served
from service.base.tables.lines import TableError, TableLine, lines_of, tabbed
from service.lots.tables.sievings import ReadTable, read_table

MOST_TABLES = 200
"""Sievings in one table: each one is read by itself, and its lot's curve computed, before anything is stored."""
LOT = re.compile(r"lot|los|charge|batch", re.IGNORECASE)
SAID = {
    "sieved_on": re.compile(r"date|datum|sieved on|gesiebt am", re.IGNORECASE),
    "sample_id": re.compile(r"sample( id)?|probe(nnummer)?", re.IGNORECASE),
}
"""Heads of columns about a sieving, by the field that they fill."""
SIEVE = re.compile(
    r"(?P<kind>\D*?)\s*\b(?:at|on|bei|auf)?\s*(?P<size>\d+(?:[.,]\d+)?)\s*(?P<unit>mm|µm|μm|um)?",
    re.IGNORECASE,
)
"""Head of the column of one sieve: `Passing % 31.5 mm`."""
PAN = re.compile(
    r"(?:(?P<kind>.+?)\s+)?(?:in )?(?:pan|schale|boden|siebboden|auffangschale)(?:\s+(?P<unit>g|kg|%))?",
    re.IGNORECASE,
)
DATES = ("%Y-%m-%d", "%d.%m.%Y", "%d.%m.%y")
PLACE = re.compile(r"^table: (?:line [0-9]+: )?")
EXAMPLE = "'Lot', 'Date', 'Passing % 31.5 mm', 'Passing % 16 mm'"


@served
class RefusedRow:
    """A sieving of a table of many that cannot be taken."""

    lot: str | None
    """Name of the lot; null where none is named."""
    line: int
    """First line of it, from 1."""
    reason: str
    """Why it is refused."""


def read_history(text: str) -> list[ReadTable | RefusedRow]:
    """Return the sievings of a table with a column of lots, in its order.

    A line is one sieve of a lot, as `read_tables` reads them; or it is a whole sieving, with a column for each
    sieve, whose head says what it has and of which aperture. Date and sample may have columns as well.

    Raises
    ------
    TableError
        The head does not say what the columns are, or there are more than `MOST_TABLES` sievings.
    """
    lines = lines_of(text)
    if not lines:
        raise TableError("table: needs sieves: lines of an aperture and what is retained")
    head, *below = lines
    lots = [i for i, cell in enumerate(head.cells, start=1) if LOT.fullmatch(cell)]
    if len(lots) != 1:
        raise TableError("table: the head must name one column 'Lot', 'Los' or 'Charge'")
    said = {
        name: i
        for name, words in SAID.items()
        for i, cell in enumerate(head.cells, start=1)
        if words.fullmatch(cell)
    }
    rest = [i for i, cell in enumerate(head.cells, start=1) if cell and i not in (*lots, *said.values())]
    sieves = {i: found for i in rest if (found := SIEVE.fullmatch(head.at(i)))}
    if not sieves:
        groups = _by_lot(below, lots[0], said)
        _require_few(groups)
        return [_taken(group, lots[0], said, _long(head, group, rest)) for group in groups]
    _require_few(below)
    pans = {i: found for i in rest if i not in sieves and (found := PAN.fullmatch(head.at(i)))}
    for i in rest:
        if i not in sieves and i not in pans:
            raise TableError(
                f"table: column {i}: the head {head.at(i)[:40]!r} is not understood: write {EXAMPLE}"
            )
    kinds = {found["kind"].strip() for found in sieves.values()}
    units = {(found["unit"] or "mm").lower() for found in sieves.values()}
    if len(kinds) != 1 or "" in kinds or len(units) != 1:
        raise TableError(
            f"table: each head must say the same of its sieve, retained or passing, in g or %: {EXAMPLE}"
        )
    columns = {i: found["size"] for i, found in sieves.items()} | dict.fromkeys(pans, "pan")
    start = (f"Sieve {units.pop()}", kinds.pop())
    return [_taken([line], lots[0], said, _wide(start, line, columns)) for line in below]


def _require_few(sievings: Sized) -> None:
    """Raise `TableError` for too many, before the first is read."""
    if len(sievings) > MOST_TABLES:
        raise TableError(f"table: has {len(sievings)} sievings, more than {MOST_TABLES}: send it in parts")


def _by_lot(lines: Sequence[TableLine], lot: int, said: Mapping[str, int]) -> list[list[TableLine]]:
    """Return the lines of each sieving: of one lot, and of one date and sample where these are given."""
    groups: dict[tuple[str, ...], list[TableLine]] = {}
    for line in lines:
        key = tuple(line.at(i) for i in (lot, *said.values()))
        groups.setdefault(key, []).append(line)
    return list(groups.values())


def _long(head: TableLine, lines: Sequence[TableLine], columns: Sequence[int]) -> str:
    """Return the table of one lot, its lines at the numbers that they have."""
    by_number = {line.number: [line.at(i) for i in columns] for line in (head, *lines)}
    return tabbed(by_number.get(number, []) for number in range(1, max(by_number) + 1))


def _wide(start: Sequence[str], line: TableLine, columns: Mapping[int, str]) -> str:
    """Return the table of one line, a sieve a line; a sieve without a value was not used."""
    cells = ((size, line.at(i)) for i, size in columns.items())
    return tabbed([start, *(cell for cell in cells if cell[1])])


def _taken(
    lines: Sequence[TableLine], lot: int, said: Mapping[str, int], table: str
) -> ReadTable | RefusedRow:
    first = lines[0]
    name = first.at(lot)
    try:
        if not name:
            raise TableError("names no lot")
        read = read_table(table)
        given = {field: first.at(i) or None for field, i in said.items()}
        sieving = replace(
            read.sieving, sample_id=given.get("sample_id"), sieved_on=_date(given.get("sieved_on"))
        )
    except TableError as err:
        is_wide = len(lines) == 1
        reason = PLACE.sub("", str(err)) if is_wide else str(err).removeprefix("table: ")
        return RefusedRow(lot=name or None, line=first.number, reason=reason)
    return replace(read, lot=name, line=first.number, sieving=sieving)


def _date(text: str | None) -> str | None:
    """Return a date as 2026-03-02."""
    if text is None:
        return None
    for form in DATES:
        try:
            return f"{datetime.strptime(text, form):%Y-%m-%d}"
        except ValueError:
            continue
    raise TableError(f"date: {text[:40]!r} is none: write 2026-03-02 or 02.03.2026")
