"""The laboratory: sievings of portions of a lot, and how its sieves and this instrument agree for a product."""

import json
import math
import re
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from http import HTTPStatus
from typing import Any

from pydantic import TypeAdapter

from drivers.files.times import utc_now
from pipeline.gradation.correlation import MappingForm, SievedLot, SizeMapping, Study, study
from service.base.errors import InvalidRequestError, ProblemError, ProblemKind, TooManyError
from service.base.schema import Time, served
from service.lots.lots import LotState, lots
from service.lots.stones import stones_of_lot
from service.store import audit

MAX_SIEVINGS = 100
"""Most sievings of a lot: they are one list, without pages."""
MOST_SIEVES = 100
"""In one table or request; a stored one may be older than this limit."""
PAN = frozenset({"pan", "boden", "0"})
"""Words for what passes the last sieve; the second is German."""
MASS = re.compile(r"([0-9.,\s]++)(kg|g)?")
GRAMS = {"kg": 1000.0, "g": 1.0, None: None}
MOST_LOTS = 1000


class SievingError(InvalidRequestError):
    """A laboratory's table cannot be read, or does not add up; names the line or the sieve."""


class NothingToStudyError(ProblemError):
    """No lot of the product has both stones and a sieving from which a size follows."""

    kinds = (ProblemKind("nothing-to-study", HTTPStatus.CONFLICT, "No lot was both sieved and measured"),)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sieving:
    """What a laboratory found in a portion: grams retained on each sieve and in the pan."""

    retained_g: Mapping[float, float]  # by aperture in mm
    pan_g: float
    sample_id: str | None = None
    by: str | None = None
    remark: str | None = None

    def __post_init__(self) -> None:
        if not self.retained_g or not all(0 < sieve_mm < math.inf for sieve_mm in self.retained_g):
            raise SievingError("retained_g: needs sieves with apertures above 0 mm")
        weighed_g = {f"retained_g: {sieve_mm:g} mm": grams for sieve_mm, grams in self.retained_g.items()}
        for name, grams in [*weighed_g.items(), ("pan_g", self.pan_g)]:
            if not 0 <= grams < 1e7:
                raise SievingError(f"{name}: must be grams from 0, not {grams:g}")
        if self.mass_g <= 0:
            raise SievingError("retained_g: nothing was weighed")

    @property
    def mass_g(self) -> float:
        """All that was weighed."""
        return sum(self.retained_g.values()) + self.pan_g

    @property
    def passing_percent(self) -> dict[float, float]:
        """By rising aperture in mm: what passes is what lies on all smaller sieves and in the pan."""
        passing, below_g, mass_g = {}, self.pan_g, self.mass_g
        for sieve_mm in sorted(self.retained_g):
            passing[sieve_mm] = 100 * below_g / mass_g
            below_g += self.retained_g[sieve_mm]
        return passing


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredSieving:
    """A sieving of a lot."""

    sieving: int
    at: str
    document: Sieving


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


def parse_table(text: str, **more: str | None) -> Sieving:
    """Read a table of apertures and masses as it is copied from a spreadsheet.

    Columns are parted by semicolons or tabs, decimals by a point or a comma; masses are grams, or kilograms where
    `kg` stands behind the number or at the head of the column. Raises `SievingError`.
    """
    retained_g: dict[float, float] = {}
    pan_g, unit_g = 0.0, 1.0
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        row = _row(line)
        if row is None:
            if retained_g or number > 1:
                raise SievingError(
                    f"table: line {number}: {line.strip()[:80]!r} is not an aperture and a mass"
                )
            is_kg = "kg" in re.findall(r"[^\W_]+", line.lower())
            unit_g = 1000.0 if is_kg else 1.0  # the head of the columns
            continue
        name, mass, factor = row
        grams = _number(mass, number) * (factor or unit_g)
        if name.lower() in PAN:
            pan_g += grams
        else:
            sieve_mm = _number(name.lower().removesuffix("mm"), number)
            if sieve_mm in retained_g:
                raise SievingError(f"table: line {number}: the sieve {sieve_mm:g} mm is there twice")
            if len(retained_g) == MOST_SIEVES:
                raise SievingError(f"table: line {number}: more than {MOST_SIEVES} sieves")
            retained_g[sieve_mm] = grams
    return Sieving(retained_g=retained_g, pan_g=pan_g, **more)


def _row(line: str) -> tuple[str, str, float | None] | None:
    """Return the name of a sieve, what is written as its mass, and grams of its unit; None for other lines."""
    name, *cells = (cell.strip() for cell in line.strip().replace("\t", ";").split(";"))
    if not name or not cells or any(cells[1:]) or len(cells) > 2:
        return None
    mass = MASS.fullmatch(cells[0].lower())
    return None if mass is None else (name, mass[1], GRAMS[mass[2]])


def add_sieving(connection: sqlite3.Connection, lot: str, sieving: Sieving, who: str) -> StoredSieving:
    """Store a sieving of a lot; raise `TooManyError` if it has `MAX_SIEVINGS` already."""
    document = asdict(sieving)
    (n,) = connection.execute("SELECT count(*) FROM sievings WHERE lot = ?", (lot,)).fetchone()
    if n >= MAX_SIEVINGS:
        raise TooManyError("sievings", f"lot {lot} has {MAX_SIEVINGS} sievings already")
    number, at = connection.execute(
        "INSERT INTO sievings (lot, at, document) VALUES (?, ?, ?) RETURNING sieving, at",
        (lot, utc_now(), json.dumps(document)),
    ).fetchone()
    audit.note(connection, who, "sieving", lot, after=document)
    return StoredSieving(sieving=number, at=at, document=sieving)


def sievings(connection: sqlite3.Connection, lot: str) -> list[StoredSieving]:
    """Return the sievings of a lot, in their order."""
    rows = connection.execute(
        "SELECT sieving, at, document FROM sievings WHERE lot = ? ORDER BY sieving", (lot,)
    )
    return [
        StoredSieving(sieving=number, at=at, document=SIEVING.validate_json(text))
        for number, at, text in rows
    ]


def sievings_json(connection: sqlite3.Connection, lot: str) -> bytes:
    """Return the sievings of a lot as JSON."""
    return json.dumps({"items": [sieving_document(each) for each in sievings(connection, lot)]}).encode()


def sieving_document(stored: StoredSieving) -> dict[str, Any]:
    """Return a sieving as its document says it."""
    sieving = stored.document
    return {
        **asdict(sieving),
        "sieving": stored.sieving,
        "at": stored.at,
        "mass_g": sieving.mass_g,
        "retained_g": {f"{sieve_mm:g}": grams for sieve_mm, grams in sieving.retained_g.items()},
        "passing_percent": {f"{sieve_mm:g}": share for sieve_mm, share in sieving.passing_percent.items()},
    }


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
        for each in sievings(connection, name)
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


def _number(text: str, line: int) -> float:
    try:
        return float(text.strip().replace(",", "."))
    except ValueError:
        raise SievingError(f"table: line {line}: {text.strip()[:40]!r} is not a number") from None
