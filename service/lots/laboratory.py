"""The laboratory: sievings of portions of a lot, which may be voided and replaced."""

import json
import math
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from http import HTTPStatus
from typing import Any

from pydantic import TypeAdapter

from drivers.files.times import utc_now
from pipeline.gradation.curve import retained_to_passing
from service.base.errors import ProblemError, ProblemKind, TooManyError
from service.base.tables.lines import TableError
from service.store import audit
from service.store.schema import rows_by_name

MAX_SIEVINGS = 100
"""Most sievings of a lot: they are one list, without pages."""
MOST_SIEVES = 100
"""In one table or request; a stored one may be older than this limit."""
MOST_LOST = 0.01
"""Share of the dry mass by which the fractions may miss it (EN 933-1)."""


class SievingError(TableError):
    """A sieving does not add up, or has numbers that cannot be; names the sieve."""


class UnknownSievingError(ProblemError):
    """The lot has no sieving of this number."""

    kinds = (ProblemKind("unknown-sieving", HTTPStatus.NOT_FOUND, "No such sieving"),)


class SievingVoidError(ProblemError):
    """A sieving is to be replaced that is void already."""

    kinds = (ProblemKind("sieving-void", HTTPStatus.CONFLICT, "The sieving is void"),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sieving:
    """A laboratory's sieving of a portion (EN 933-1): masses retained, or percent passing where no mass is known."""

    retained_g: Mapping[float, float] = field(default_factory=dict)  # by aperture in mm
    pan_g: float | None = None  # with `retained_g` alone
    given_passing_percent: Mapping[float, float] | None = (
        None  # by aperture in mm, where only percents are known
    )
    dry_mass_g: float | None = None  # before sieving
    sample_id: str | None = None
    by: str | None = None
    remark: str | None = None
    sieved_on: str | None = None  # 2026-03-02
    reason: str | None = None  # why it is right though it contradicts the instrument

    def __post_init__(self) -> None:
        name = "retained_g" if self.given_passing_percent is None else "passing_percent"
        given = self.retained_g if self.given_passing_percent is None else self.given_passing_percent
        if not given or not all(0 < sieve_mm < math.inf for sieve_mm in given):
            raise SievingError(f"{name}: needs sieves with apertures above 0 mm")
        if self.given_passing_percent is not None:
            falling = [percent for _, percent in sorted(given.items(), reverse=True)]
            if self.mass_g is not None or falling != sorted(falling, reverse=True):
                raise SievingError("passing_percent: must fall with falling sieves, and stand without masses")
            if not 0 <= falling[-1] <= falling[0] <= 100:
                raise SievingError("passing_percent: must be from 0 to 100")
            if self.dry_mass_g is not None:
                raise SievingError("dry_mass_g: there are no masses to compare it with")
            return
        weighed_g = {f"retained_g: {sieve_mm:g} mm": grams for sieve_mm, grams in given.items()}
        for place, grams in [*weighed_g.items(), ("pan_g", self.pan_g or 0.0)]:
            if not 0 <= grams < 1e7:
                raise SievingError(f"{place}: must be grams from 0, not {grams:g}")
        if not self.mass_g:
            raise SievingError("retained_g: nothing was weighed")
        dry_mass_g = self.mass_g if self.dry_mass_g is None else self.dry_mass_g
        if not abs(self.mass_g - dry_mass_g) <= MOST_LOST * dry_mass_g:
            raise SievingError(
                f"dry_mass_g: {dry_mass_g:g} g were sieved, but the fractions add up to {self.mass_g:g} g, which is"
                " more than 1 % from it: sieve again, or look for a slip"
            )

    @property
    def mass_g(self) -> float | None:
        """All that was weighed; None where only percents are known."""
        return sum(self.retained_g.values()) + (self.pan_g or 0.0) if self.retained_g else None

    @property
    def passing_percent(self) -> dict[float, float]:
        """By rising aperture in mm: the share of the mass that lies on all smaller sieves and in the pan."""
        if self.given_passing_percent is not None:
            return dict(sorted(self.given_passing_percent.items()))
        return retained_to_passing(self.retained_g, self.pan_g or 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredSieving:
    """A sieving of a lot; a void one counts in no study, chart or report."""

    sieving: int
    at: str
    document: Sieving
    voided_at: str | None = None
    void_reason: str | None = None
    replaced_by: int | None = None  # the sieving that corrects it


SIEVING = TypeAdapter(Sieving)


def add_sieving(
    connection: sqlite3.Connection, lot: str, sieving: Sieving, who: str, replaces: int | None = None
) -> StoredSieving:
    """Store a sieving of a lot; the one that it `replaces` is void from then on, for the same reason.

    Raises `TooManyError` if the lot has `MAX_SIEVINGS` already, `UnknownSievingError` or `SievingVoidError` if there
    is nothing to replace.
    """
    document = asdict(sieving)
    (n,) = connection.execute("SELECT count(*) FROM sievings WHERE lot = ?", (lot,)).fetchone()
    if n >= MAX_SIEVINGS:
        raise TooManyError("sievings", f"lot {lot} has {MAX_SIEVINGS} sievings already")
    if replaces is not None and _sieving_of(connection, lot, replaces).voided_at is not None:
        raise SievingVoidError(f"replaces: sieving {replaces} of lot {lot} is void already")
    number, at = connection.execute(
        "INSERT INTO sievings (lot, at, document) VALUES (?, ?, ?) RETURNING sieving, at",
        (lot, utc_now(), json.dumps(document)),
    ).fetchone()
    audit.note(connection, who, "sieving", lot, after=document)
    if replaces is not None:
        void_sieving(connection, lot, replaces, sieving.reason or "", who, replaced_by=number)
    return StoredSieving(sieving=number, at=at, document=sieving)


def add_history(
    connection: sqlite3.Connection, found: Sequence[tuple[str, Sieving]], who: str
) -> list[dict[str, Any]]:
    """Store sievings of lots, all of them or none, and return their documents; raises as `add_sieving` does."""
    return [
        sieving_document(add_sieving(connection, lot, sieving, who)) | {"lot": lot} for lot, sieving in found
    ]


def void_sieving(
    connection: sqlite3.Connection,
    lot: str,
    number: int,
    reason: str,
    who: str,
    replaced_by: int | None = None,
) -> StoredSieving:
    """Declare a sieving void: it is kept, and counts no more. A void one is returned as it is.

    Raises `UnknownSievingError` if the lot has none of this number.
    """
    before = _sieving_of(connection, lot, number)
    if before.voided_at is not None:
        return before
    connection.execute(
        "UPDATE sievings SET voided_at = ?, void_reason = ?, replaced_by = ? WHERE sieving = ?",
        (utc_now(), reason, replaced_by, number),
    )
    after = _sieving_of(connection, lot, number)
    facts = (sieving_document(each) for each in (before, after))
    audit.note(connection, who, "sieving voided", lot, before=next(facts), after=next(facts))
    return after


def sievings(connection: sqlite3.Connection, lot: str) -> list[StoredSieving]:
    """Return the sievings of a lot, in their order, void ones included."""
    rows = connection.execute(
        "SELECT sieving, at, document, voided_at, void_reason, replaced_by FROM sievings"
        " WHERE lot = ? ORDER BY sieving",
        (lot,),
    )
    return [
        StoredSieving(**row | {"document": SIEVING.validate_json(row["document"])})
        for row in rows_by_name(rows)
    ]


def valid_sievings(connection: sqlite3.Connection, lot: str) -> list[StoredSieving]:
    """Return the sievings of a lot that count, in their order."""
    return [each for each in sievings(connection, lot) if each.voided_at is None]


def sievings_json(connection: sqlite3.Connection, lot: str) -> bytes:
    """Return the sievings of a lot as JSON."""
    return json.dumps({"items": [sieving_document(each) for each in sievings(connection, lot)]}).encode()


def sieving_document(stored: StoredSieving) -> dict[str, Any]:
    """Return a sieving as its document says it."""
    facts, sieving = asdict(stored), stored.document
    facts = facts.pop("document") | facts
    facts.pop("given_passing_percent")
    return {
        **facts,
        "mass_g": sieving.mass_g,
        "retained_g": {f"{sieve_mm:g}": grams for sieve_mm, grams in sieving.retained_g.items()},
        "passing_percent": {f"{sieve_mm:g}": share for sieve_mm, share in sieving.passing_percent.items()},
    }


def _sieving_of(connection: sqlite3.Connection, lot: str, number: int) -> StoredSieving:
    for each in sievings(connection, lot):
        if each.sieving == number:
            return each
    raise UnknownSievingError(f"lot {lot} has no sieving {number}")
