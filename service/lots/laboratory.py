"""The laboratory: sievings of portions of a lot, and how its sieves and this instrument agree for a product."""

import json
import math
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from http import HTTPStatus
from typing import Any

from pydantic import TypeAdapter

from drivers.files.times import utc_now
from pipeline.gradation.correlation import MappingForm, SievedLot, SizeMapping, Study, study
from pipeline.gradation.curve import retained_to_passing
from service.base.errors import InvalidRequestError, ProblemError, ProblemKind, TooManyError
from service.base.schema import Time, served
from service.lots.lots import LotState, lots
from service.lots.stones import stones_of_lot
from service.store import audit
from service.store.schema import rows_by_name

MAX_SIEVINGS = 100
"""Most sievings of a lot: they are one list, without pages."""
MOST_SIEVES = 100
"""In one table or request; a stored one may be older than this limit."""
MOST_LOST = 0.01
"""Share of the dry mass by which the fractions may miss it (EN 933-1)."""
MOST_LOTS = 1000


class SievingError(InvalidRequestError):
    """A laboratory's table cannot be read, or does not add up; names the line or the sieve."""


class UnknownSievingError(ProblemError):
    """The lot has no sieving of this number."""

    kinds = (ProblemKind("unknown-sieving", HTTPStatus.NOT_FOUND, "No such sieving"),)


class SievingVoidError(ProblemError):
    """A sieving is to be replaced that is void already."""

    kinds = (ProblemKind("sieving-void", HTTPStatus.CONFLICT, "The sieving is void"),)


class NothingToStudyError(ProblemError):
    """No lot of the product has both stones and a sieving from which a size follows."""

    kinds = (ProblemKind("nothing-to-study", HTTPStatus.CONFLICT, "No lot was both sieved and measured"),)


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


@served
class CorrelationDocument:
    """One version of a study: how the instrument's sizes become those of the laboratory's sieves."""

    product: str
    """Id of the product"""
    version: int
    """Number of the study, from 1"""
    at: Time
    """When it was made, RFC 3339 UTC"""
    form: MappingForm
    """`factor`: one factor for all sizes; otherwise a rising mapping"""
    factor: float
    """Sieve's size by the instrument's, mean of all sizes"""
    instrument_mm: tuple[float, ...]
    """Knots of the mapping; one knot is one factor"""
    sieve_mm: tuple[float, ...]
    """Sizes of the laboratory's sieves at the knots, mm"""
    relative_se: tuple[float | None, ...]
    """Standard error at each knot, from lot to lot; null with one lot"""
    n_lots: int
    """Lots that were sieved and measured"""
    n_points: int
    """Points of all curves that were compared"""
    raw_rmse: float
    """Points of passing by which raw curves miss the laboratory's"""
    raw_bias: float
    """Mean of raw minus the laboratory's passing, percentage points"""
    rmse: float
    """The same with the mapping, on the lots that it was fitted to"""
    held_out_rmse: float | None
    """Each lot by the mapping of the others; null with one lot"""
    held_out_bias: float | None
    """Mean of these differences, each lot by the mapping of the others, percentage points; null with one
    lot"""

    @property
    def mapping(self) -> SizeMapping:
        return SizeMapping(**{each.name: getattr(self, each.name) for each in fields(SizeMapping)})


SIEVING, STUDY = TypeAdapter(Sieving), TypeAdapter(Study)


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


def study_of(connection: sqlite3.Connection, product: str, form: MappingForm) -> Study:
    """Study all lots of a product that were sieved, void ones left out; takes long, so not on the writer's connection.

    Raises `NothingToStudyError` if no lot has both stones and a sieving that tell a size.
    """
    names = [
        each.lot
        for each in lots(connection, None, product, None, MOST_LOTS)
        if each.state is not LotState.VOID
    ]
    sieved = [
        SievedLot(lot=stones_of_lot(connection, name).lot, passing=each.document.passing_percent)
        for name in names
        for each in valid_sievings(connection, name)
    ]
    try:
        return study([each for each in sieved if each.lot.n_measured], form)
    except ValueError as err:
        raise NothingToStudyError(f"product {product}: {err}") from err


def keep_study(connection: sqlite3.Connection, product: str, found: Study, who: str) -> CorrelationDocument:
    """Store a study as the newest version of the product's."""
    (version,) = connection.execute(
        "SELECT coalesce(max(version), 0) + 1 FROM correlations WHERE product = ?", (product,)
    ).fetchone()
    at = utc_now()
    connection.execute(
        "INSERT INTO correlations (product, version, at, document) VALUES (?, ?, ?, ?)",
        (product, version, at, json.dumps(asdict(found))),
    )
    audit.note(connection, who, "correlation", product, after=asdict(found))
    return _correlation(product, version, at, found)


def correlations(connection: sqlite3.Connection, product: str) -> list[CorrelationDocument]:
    """Return all versions of a product's study, the newest first."""
    rows = connection.execute(
        "SELECT version, at, document FROM correlations WHERE product = ? ORDER BY version DESC", (product,)
    )
    return [_correlation(product, version, at, STUDY.validate_json(text)) for version, at, text in rows]


def _correlation(product: str, version: int, at: str, found: Study) -> CorrelationDocument:
    figures, factor = asdict(found), found.mapping.factor
    figures |= figures.pop("mapping")
    return CorrelationDocument(product=product, version=version, at=at, factor=factor, **figures)
