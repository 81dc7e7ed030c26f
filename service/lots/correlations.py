"""Correlation studies of a product: drafts, until one without obstacles is accepted; the newest accepted is in use."""

import json
import sqlite3
from collections.abc import Sequence
from dataclasses import asdict, fields
from enum import StrEnum
from http import HTTPStatus
from statistics import fmean
from typing import NamedTuple

from pydantic import TypeAdapter

from drivers.files.times import utc_now
from pipeline.gradation.correlation import MappingForm, SievedLot, SizeMapping, Study, study
from service.base.errors import ProblemError, ProblemKind
from service.base.messages import Code, CodedFinding, findings_of, joined, message
from service.base.schema import OptionalTime, Time, served
from service.lots.laboratory import valid_sievings
from service.lots.lots import LotChoice, LotState, lots
from service.lots.stones import stones_of_lot
from service.store import audit
from service.store.schema import rows_by_name

MOST_LOTS = 1000
LEAST_LOTS = 5
"""Lots that a study must rest on to be accepted."""
LEAST_STONES = 100
"""Measured stones that each of them must have."""


class StudyState(StrEnum):
    """State of a correlation study."""

    DRAFT = "draft"
    """Made to be looked at; no figure uses it"""
    ACCEPTED = "accepted"
    """The newest accepted one of a product is in use"""
    WITHDRAWN = "withdrawn"
    """Taken back; the next older accepted one is in use, or raw curves alone"""


class NothingToStudyError(ProblemError):
    """No lot of the product has both stones and a sieving from which a size follows."""

    kinds = (ProblemKind("nothing-to-study", HTTPStatus.CONFLICT, "No lot was both sieved and measured"),)


class UnknownCorrelationError(ProblemError):
    """The product has no study of this version."""

    kinds = (ProblemKind("unknown-correlation", HTTPStatus.NOT_FOUND, "No such correlation study"),)


class CorrelationConflictError(ProblemError):
    """A study cannot be accepted: it has obstacles, or was withdrawn."""

    kinds = (ProblemKind("correlation-conflict", HTTPStatus.CONFLICT, "The study cannot be accepted"),)


@served
class CorrelationDocument:
    """One version of a study: how the instrument's sizes become those of the laboratory's sieves."""

    product: str
    """Id of the product"""
    version: int
    """Number of the study, from 1"""
    at: Time
    """When it was made, RFC 3339 UTC"""
    state: StudyState
    """`draft`: no figure uses it; `accepted`; `withdrawn`: taken back"""
    is_in_use: bool
    """True for the newest accepted one: curves of the product's lots are correlated by it"""
    obstacles: tuple[str, ...]
    """Why it cannot be accepted, in words; empty if it can"""
    obstacle_findings: tuple[CodedFinding, ...]
    """The same, as codes with their parameters"""
    accepted_at: OptionalTime
    """When it was accepted, RFC 3339 UTC; null if it never was"""
    accepted_by: str | None
    """Name of the key that accepted it; null before, and of studies of earlier versions, which were in use at once"""
    withdrawn_at: OptionalTime
    """When it was withdrawn, RFC 3339 UTC; null unless it was"""
    reason: str | None
    """Why it was withdrawn; null unless it was"""
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


class JudgedStudy(NamedTuple):
    """A study, and what keeps it from being accepted."""

    study: Study
    obstacles: tuple[str, ...]


STUDY = TypeAdapter(Study)
FINDINGS = TypeAdapter(tuple[CodedFinding, ...])


def study_of(connection: sqlite3.Connection, product: str, form: MappingForm) -> JudgedStudy:
    """Study the lots of a product that were sieved; takes long, so not on the writer's connection.

    Void lots and void sievings do not count, nor lots with fewer than `LEAST_STONES` measured stones where others have
    enough. Several sievings of a lot count as their mean. Raises `NothingToStudyError` if no lot has both stones and a
    sieving that tell a size.
    """
    names = [
        each.lot
        for each in lots(connection, LotChoice(product=product), MOST_LOTS)
        if each.state is not LotState.VOID
    ]
    sieved = {
        name: SievedLot(lot=stones_of_lot(connection, name).lot, passing=passing)
        for name in names
        if (passing := _mean_passing(connection, name))
    }
    measured = {name: each for name, each in sieved.items() if each.lot.n_measured}
    enough = {name: each for name, each in measured.items() if each.lot.n_measured >= LEAST_STONES}
    chosen = enough or measured
    try:
        found = study(list(chosen.values()), form)
    except ValueError as err:
        raise NothingToStudyError(f"product {product}: {err}") from err
    few = [
        message(Code.STUDY_SMALL_LOT, lot=name, stones=each.lot.n_measured, least=LEAST_STONES)
        for name, each in chosen.items()
        if name not in enough
    ]
    return JudgedStudy(found, (*few, *_obstacles(found)))


def keep_study(
    connection: sqlite3.Connection, product: str, found: JudgedStudy, who: str
) -> CorrelationDocument:
    """Store a study as the newest version of the product's, a draft."""
    (version,) = connection.execute(
        "SELECT coalesce(max(version), 0) + 1 FROM correlations WHERE product = ?", (product,)
    ).fetchone()
    connection.execute(
        "INSERT INTO correlations (product, version, at, document, state, obstacles, findings)"
        " VALUES (?, ?, ?, ?, ?, ?, ?)",
        (
            product,
            version,
            utc_now(),
            json.dumps(asdict(found.study)),
            StudyState.DRAFT,
            json.dumps(found.obstacles),
            FINDINGS.dump_json(findings_of(joined(found.obstacles))).decode(),
        ),
    )
    kept = _version_of(connection, product, version)
    audit.note(connection, who, "correlation", product, after=asdict(kept))
    return kept


def accept_study(connection: sqlite3.Connection, product: str, version: int, who: str) -> CorrelationDocument:
    """Accept a study: curves are correlated by the newest accepted one. An accepted one is returned as it is.

    Raises `UnknownCorrelationError` if there is none, `CorrelationConflictError` if it has obstacles or was withdrawn.
    """
    before = _version_of(connection, product, version)
    if before.state is StudyState.ACCEPTED:
        return before
    if before.state is StudyState.WITHDRAWN:
        raise CorrelationConflictError(f"study {version} of {product} was withdrawn: make another one")
    if before.obstacles:
        raise CorrelationConflictError(f"study {version} of {product}: {'; '.join(before.obstacles)}")
    changed = {"state": StudyState.ACCEPTED, "accepted_at": utc_now(), "accepted_by": who}
    return _changed(connection, before, changed, who, "correlation accepted")


def withdraw_study(
    connection: sqlite3.Connection, product: str, version: int, reason: str, who: str
) -> CorrelationDocument:
    """Withdraw a study: the next older accepted one is in use again, or raw curves alone.

    A withdrawn one is returned as it is. Raises `UnknownCorrelationError` if there is none.
    """
    before = _version_of(connection, product, version)
    if before.state is StudyState.WITHDRAWN:
        return before
    changed = {"state": StudyState.WITHDRAWN, "withdrawn_at": utc_now(), "reason": reason}
    return _changed(connection, before, changed, who, "correlation withdrawn")


def correlations(connection: sqlite3.Connection, product: str) -> list[CorrelationDocument]:
    """Return all versions of a product's study, the newest first."""
    rows = connection.execute(
        "SELECT product, version, at, document, state, obstacles, findings, accepted_at, accepted_by, withdrawn_at,"
        " reason,"
        " version IS (SELECT max(version) FROM correlations WHERE product = ?1 AND state = 'accepted') AS is_in_use"
        " FROM correlations WHERE product = ?1 ORDER BY version DESC",
        (product,),
    )
    found = []
    for row in rows_by_name(rows):
        document = STUDY.validate_json(row.pop("document"))
        figures = asdict(document)
        figures |= figures.pop("mapping") | {"factor": document.mapping.factor}
        row["state"], row["is_in_use"] = StudyState(row["state"]), bool(row["is_in_use"])
        row["obstacles"] = tuple(json.loads(row["obstacles"]))
        coded = row.pop("findings")
        # those made before codes are as they were said
        told = findings_of(joined(row["obstacles"]))
        row["obstacle_findings"] = told if coded is None else FINDINGS.validate_json(coded)
        found.append(CorrelationDocument(**row | figures))
    return found


def correlation_in_use(connection: sqlite3.Connection, product: str) -> CorrelationDocument | None:
    """Return the newest accepted study of a product; None if there is none: curves are raw then."""
    return next((each for each in correlations(connection, product) if each.is_in_use), None)


def _changed(
    connection: sqlite3.Connection,
    before: CorrelationDocument,
    changed: dict[str, str],
    who: str,
    action: str,
) -> CorrelationDocument:
    """Store a change of a study, note it in the audit, and return the study after it."""
    names = ", ".join(f"{name} = ?" for name in changed)
    connection.execute(
        f"UPDATE correlations SET {names} WHERE product = ? AND version = ?",  # noqa: S608 - of this module
        (*changed.values(), before.product, before.version),
    )
    after = _version_of(connection, before.product, before.version)
    audit.note(connection, who, action, before.product, before=asdict(before), after=asdict(after))
    return after


def _version_of(connection: sqlite3.Connection, product: str, version: int) -> CorrelationDocument:
    for each in correlations(connection, product):
        if each.version == version:
            return each
    raise UnknownCorrelationError(f"product {product} has no correlation study {version}")


def _mean_passing(connection: sqlite3.Connection, lot: str) -> dict[float, float]:
    """Return the passing by sieve, the mean of the lot's sievings: portions of one lot are not several lots."""
    portions = [each.document.passing_percent for each in valid_sievings(connection, lot)]
    sieves = {sieve_mm for passing in portions for sieve_mm in passing}
    return {mm: fmean(passing[mm] for passing in portions if mm in passing) for mm in sorted(sieves)}


def _obstacles(found: Study) -> Sequence[str]:
    """Return the obstacles that lie in the figures of a study."""
    obstacles = []
    if found.n_lots < LEAST_LOTS:
        obstacles.append(message(Code.STUDY_FEW_LOTS, lots=found.n_lots, least=LEAST_LOTS))
    if found.held_out_rmse is None:
        obstacles.append(message(Code.STUDY_UNCHECKED))
    elif found.held_out_rmse >= found.raw_rmse:
        figures = {"held_out_rmse": found.held_out_rmse, "raw_rmse": found.raw_rmse}
        obstacles.append(message(Code.STUDY_WORSE, **figures))
    return obstacles
