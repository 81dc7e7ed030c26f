"""A sieving beside the instrument's own curve of the lot: read back before it is stored, refused if implausible."""

import sqlite3
from dataclasses import replace
from http import HTTPStatus

from pipeline.gradation.estimates import Estimate
from pipeline.gradation.sieves import MeasuredRange
from service.base.errors import ProblemError, ProblemKind
from service.base.messages import Code, CodedFinding, CodedText, findings_of, joined, message
from service.base.schema import served
from service.base.tables.lines import TableError
from service.lots.evaluation import passing_of
from service.lots.laboratory import Sieving, valid_sievings
from service.lots.lots import find_lot
from service.lots.stones import stones_of_lot
from service.lots.tables.history import MOST_TABLES, RefusedRow, read_history
from service.lots.tables.sievings import read_tables

LEAST_STONES = 50
"""Measured stones from which on the instrument's curve can contradict a sieving."""
MOST_POINTS = 15.0
"""Difference of passing in percentage points up to which it never does: methods and portions differ."""

MOST_ON_TOP_PERCENT = 50.0
"""Share of the mass on the coarsest sieve from which columns or units are more likely wrong than the stone coarse."""
LEAST_SIEVES = 3
"""Sieves from which on a sieving is of the whole curve: with fewer only what is too fine may be asked for."""


class ImplausibleSievingError(ProblemError):
    """A sieving is odd, or contradicts the instrument's curve, and no reason is given; names the sieves."""

    kinds = (
        ProblemKind(
            "implausible-sieving", HTTPStatus.CONFLICT, "The sieving contradicts the instrument's curve"
        ),
    )


@served
class SievingStep:
    """One sieve of a sieving, beside the instrument."""

    sieve_mm: float
    """Aperture, mm"""
    retained_g: float | None
    """Mass retained on it, g; null where only percents are known"""
    passing_percent: float
    """Share of the mass that passes it by the sieving"""
    instrument_percent: Estimate
    """The same by the raw sizes of the lot's stones; without a value beyond the measured range"""
    difference: float | None
    """Instrument minus sieving, percentage points; null where there is no value"""


@served
class SievingReading:
    """A sieving as it was read, beside the instrument's curve of its lot; nothing of it is stored."""

    lot: str
    """Name of the lot"""
    understood: str
    """How columns and numbers were taken, in words"""
    understood_findings: tuple[CodedFinding, ...]
    """The same, as codes with their parameters"""
    mass_g: float | None
    """Mass of all fractions, g; null where only percents are known"""
    dry_mass_g: float | None
    """As it was given"""
    sieves: tuple[SievingStep, ...]
    """By rising aperture"""
    implausible: str | None
    """Why it will be refused without a `reason`; null if it is plausible"""
    implausible_findings: tuple[CodedFinding, ...]
    """The same, as codes with their parameters; empty if it is plausible"""


def sieving_reading(
    connection: sqlite3.Connection, lot: str, sieving: Sieving, understood: str, measured: MeasuredRange
) -> SievingReading:
    """Return a sieving beside the instrument's curve of the lot, at the same sieves."""
    stones = stones_of_lot(connection, lot).lot
    passing = sieving.passing_percent
    instrument = passing_of(stones, list(passing), measured)
    steps = tuple(
        SievingStep(
            sieve_mm=sieve_mm,
            retained_g=sieving.retained_g.get(sieve_mm),
            passing_percent=percent,
            instrument_percent=instrument[sieve_mm],
            difference=None if (value := instrument[sieve_mm].value) is None else value - percent,
        )
        for sieve_mm, percent in passing.items()
    )
    may_judge = stones.n_measured >= LEAST_STONES
    odd = joined(
        [
            *(_kept_on_top(step) for step in steps[LEAST_SIEVES - 1 :][-1:] if _is_top_heavy(step)),
            *(_contradiction(step) for step in steps if may_judge and _contradicts(step)),
        ]
    )
    return SievingReading(
        lot=lot,
        understood=understood,
        understood_findings=findings_of(understood),
        mass_g=sieving.mass_g,
        dry_mass_g=sieving.dry_mass_g,
        sieves=steps,
        implausible=None if odd is None else f"lot {lot}: {odd}",
        implausible_findings=findings_of(odd),
    )


def history_of(
    connection: sqlite3.Connection, table: str, reason: str | None, by: str | None, measured: MeasuredRange
) -> list[tuple[Sieving, SievingReading]]:
    """Return the sievings of a table with a column of lots, each beside the instrument's curve of its lot.

    Raises `TableError` if the table cannot be read, or names a lot that there is not; it names the line.
    """
    tables = read_tables(table)
    if len(tables) > MOST_TABLES:
        raise TableError(f"table: has {len(tables)} lots, more than {MOST_TABLES}: send it in parts")
    found = []
    for lot, read in tables.items():
        if lot is None:
            raise TableError("table: the head must name a column 'Lot', 'Los' or 'Charge'")
        if find_lot(connection, lot) is None:
            raise TableError(f"table: line {read.line}: there is no lot {lot[:64]!r}")
        sieving = replace(read.sieving, reason=reason, by=by)
        found.append((sieving, sieving_reading(connection, lot, sieving, read.understood, measured)))
    return found


def part_of_history(
    connection: sqlite3.Connection, table: str, reason: str | None, by: str | None, measured: MeasuredRange
) -> tuple[list[tuple[Sieving, SievingReading]], list[RefusedRow]]:
    """Return the sievings of a table that can be stored, each with its reading, and those that are refused.

    Refused are also those of lots that there are not, what contradicts the instrument without a `reason`, and what is
    stored already. Raises `TableError` as `read_history` does.
    """
    rows = read_history(table)
    found: list[tuple[Sieving, SievingReading]] = []
    refused = []
    known: dict[str, list[Sieving]] = {}
    for row in rows:
        if isinstance(row, RefusedRow):
            refused.append(row)
            continue
        sieving = replace(row.sieving, reason=reason, by=by)
        why = None
        if find_lot(connection, row.lot) is None:
            why = f"there is no lot {row.lot[:64]!r}"
        else:
            stored = known.setdefault(
                row.lot, [each.document for each in valid_sievings(connection, row.lot)]
            )
            reading = sieving_reading(connection, row.lot, sieving, row.understood, measured)
            if any(_is_same(each, sieving) for each in stored):
                why = "is stored already"
            elif reason is None:
                why = reading.implausible
        if why is not None:
            refused.append(RefusedRow(lot=row.lot, line=row.line, reason=why))
        else:
            stored.append(sieving)
            found.append((sieving, reading))
    return found, refused


def _is_same(stored: Sieving, other: Sieving) -> bool:
    """True for the same masses or percents of the same day."""
    return all(
        getattr(stored, name) == getattr(other, name)
        for name in ("retained_g", "pan_g", "given_passing_percent", "sieved_on", "sample_id")
    )


def require_plausible(reading: SievingReading, reason: str | None) -> None:
    """Raise `ImplausibleSievingError` if a sieving contradicts the instrument and no reason is given for it."""
    if reading.implausible is not None and reason is None:
        raise ImplausibleSievingError(
            f"{reading.implausible}: check the table with dry_run, or give the reason why it is right"
        )


def _is_top_heavy(step: SievingStep) -> bool:
    return step.passing_percent < 100 - MOST_ON_TOP_PERCENT


def _kept_on_top(step: SievingStep) -> CodedText:
    return message(Code.SIEVING_TOP_HEAVY, sieve_mm=step.sieve_mm, percent=100 - step.passing_percent)


def _contradicts(step: SievingStep) -> bool:
    """True beyond both `MOST_POINTS` and the 95 % interval of the instrument's passing."""
    found = step.instrument_percent
    if step.difference is None or found.low is None or found.high is None:
        return False
    return abs(step.difference) > MOST_POINTS and not found.low <= step.passing_percent <= found.high


def _contradiction(step: SievingStep) -> CodedText:
    found = step.instrument_percent
    instrument = {"instrument_percent": found.value, "low_percent": found.low, "high_percent": found.high}
    return message(
        Code.SIEVING_CONTRADICTS,
        sieve_mm=step.sieve_mm,
        sieved_percent=step.passing_percent,
        **{name: value or 0.0 for name, value in instrument.items()},
    )
