"""Tables of many sievings, months of them: each lot is read by itself, or refused by itself with the reason."""

import re
from collections.abc import Mapping, Sequence, Sized
from dataclasses import replace
from datetime import datetime

from service.base.schema import served
from service.lots.laboratory import SievingError
from service.lots.tables.heads import TableLine, lines_of
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
    SievingError
        The head does not say what the columns are, or there are more than `MOST_TABLES` sievings.
    """
    lines = lines_of(text)
    if not lines:
        raise SievingError("table: needs sieves: lines of an aperture and what is retained")
    head, *below = lines
    lots = [i for i, cell in enumerate(head.cells) if LOT.fullmatch(cell)]
    if len(lots) != 1:
        raise SievingError("table: the head must name one column 'Lot', 'Los' or 'Charge'")
    said = {
        name: i for name, words in SAID.items() for i, cell in enumerate(head.cells) if words.fullmatch(cell)
    }
    rest = [i for i in range(len(head.cells)) if i not in (*lots, *said.values()) and head.cells[i]]
    sieves = {i: found for i in rest if (found := SIEVE.fullmatch(head.cells[i]))}
    if not sieves:
        groups = _by_lot(below, lots[0], said)
        _require_few(groups)
        return [_taken(group, lots[0], said, _long(head, group, rest)) for group in groups]
    _require_few(below)
    pans = {i: found for i in rest if i not in sieves and (found := PAN.fullmatch(head.cells[i]))}
    for i in rest:
        if i not in sieves and i not in pans:
            raise SievingError(
                f"table: column {i + 1}: the head {head.cells[i][:40]!r} is not understood: write {EXAMPLE}"
            )
    kinds = {found["kind"].strip() for found in sieves.values()}
    units = {(found["unit"] or "mm").lower() for found in sieves.values()}
    if len(kinds) != 1 or "" in kinds or len(units) != 1:
        raise SievingError(
            f"table: each head must say the same of its sieve, retained or passing, in g or %: {EXAMPLE}"
        )
    columns = {i: found["size"] for i, found in sieves.items()} | dict.fromkeys(pans, "pan")
    start = f"Sieve {units.pop()}\t{kinds.pop()}"
    return [_taken([line], lots[0], said, _wide(start, line, columns)) for line in below]


def _require_few(sievings: Sized) -> None:
    """Raise `SievingError` for too many, before the first is read."""
    if len(sievings) > MOST_TABLES:
        raise SievingError(f"table: has {len(sievings)} sievings, more than {MOST_TABLES}: send it in parts")


def _by_lot(lines: Sequence[TableLine], lot: int, said: Mapping[str, int]) -> list[list[TableLine]]:
    """Return the lines of each sieving: of one lot, and of one date and sample where these are given."""
    groups: dict[tuple[str, ...], list[TableLine]] = {}
    for line in lines:
        key = tuple(_cell(line, i) for i in (lot, *said.values()))
        groups.setdefault(key, []).append(line)
    return list(groups.values())


def _long(head: TableLine, lines: Sequence[TableLine], columns: Sequence[int]) -> str:
    """Return the table of one lot, its lines at the numbers that they have."""
    by_number = {line.number: "\t".join(_cell(line, i) for i in columns) for line in (head, *lines)}
    return "\n".join(by_number.get(number, "") for number in range(1, max(by_number) + 1))


def _wide(start: str, line: TableLine, columns: Mapping[int, str]) -> str:
    """Return the table of one line, a sieve a line; a sieve without a value was not used."""
    cells = ((size, _cell(line, i)) for i, size in columns.items())
    return "\n".join([start, *(f"{size}\t{text}" for size, text in cells if text)])


def _cell(line: TableLine, i: int) -> str:
    return line.cells[i] if i < len(line.cells) else ""


def _taken(
    lines: Sequence[TableLine], lot: int, said: Mapping[str, int], table: str
) -> ReadTable | RefusedRow:
    first = lines[0]
    name = _cell(first, lot)
    try:
        if not name:
            raise SievingError("names no lot")
        read = read_table(table)
        given = {field: _cell(first, i) or None for field, i in said.items()}
        sieving = replace(
            read.sieving, sample_id=given.get("sample_id"), sieved_on=_date(given.get("sieved_on"))
        )
    except SievingError as err:
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
    raise SievingError(f"date: {text[:40]!r} is none: write 2026-03-02 or 02.03.2026")
