"""Compare two lots, or one lot as two algorithm versions measured it: each figure, and by how much it differs.

Repeated runs of one sample are compared by repeatability and reproducibility (ISO 5725-2).
"""

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from http import HTTPStatus
from typing import Any

from pydantic import Field

from pipeline.gradation.curve import passes
from pipeline.gradation.differences import Difference, difference_of_lots, difference_of_versions, significant
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.influences import Influences, share_influences, size_influences
from pipeline.gradation.repeatability import Repeatability, repeatability
from pipeline.gradation.sieves import MeasuredRange
from service.base.errors import InvalidRequestError, ProblemError, ProblemKind
from service.base.schema import served
from service.base.status import Report
from service.lots.evaluation import figures_of
from service.lots.figures import SHARES, LotFigures, named_figures
from service.lots.laboratory import valid_sievings
from service.lots.lots import LotDocument, LotState, find_lot, lots_of_sample
from service.lots.products import find_product
from service.lots.stones import Choice, Stones, stones_of_lot
from service.lots.yardsticks import Request


@dataclass(frozen=True, slots=True)
class Side:
    """A side of a comparison: a lot, in the newest revisions of its stones or in those by one version."""

    lot: str
    algorithm_version: str | None = None


class ComparedFigure(Report):
    """One figure of both, in the unit at the end of its name."""

    figure: str = Field(
        description="Such as `passing_8_mm_percent`, `d50_mm` (from the stones themselves), `flakiness_percent`"
    )
    a: Estimate = Field(description="Of the first")
    b: Estimate = Field(description="Of the second")
    difference: float | None = Field(default=None, description="b less a; null where one has no value")
    low: float | None = Field(default=None, description="Lower end of the 95 % interval of the difference")
    high: float | None = Field(default=None, description="Upper end of it")
    is_significant: bool | None = Field(
        description="More than chance, by Holm's method over all figures; null: not measured, or too few stones"
    )


class ComparedSide(Report):
    """One of the two that are compared."""

    lot: str = Field(description="Id of the lot")
    algorithm_version: str | None = Field(
        description="Version by which alone stones were taken; null: each stone in its newest revision"
    )
    measured: int = Field(description="Stones with a body and its measures")
    calibration_ids: list[str] = Field(description="Calibrations that they were measured with")


class LotComparison(Report):
    """How two lots differ, or one lot as two versions measured it; both by the product of the first."""

    a: ComparedSide = Field(description="The first")
    b: ComparedSide = Field(description="The second")
    is_paired: bool = Field(
        description="True for one lot: stone by stone, so that only what the versions do differently counts. False: two"
        " lots, each of which might have had other stones. What both calibrations share cancels in either case"
    )
    sieve_set: str = Field(description="Sieves that were used for both")
    figures: list[ComparedFigure] = Field(
        description="Passing by rising sieve, then sizes, then indices of shape"
    )


def compare_lots(connection: sqlite3.Connection, a: Side, b: Side, request: Request) -> LotComparison | None:
    """Return the comparison by the product of the first, or by any sieves; None if there is no such lot.

    Raises `UnknownYardstickError` as `yardstick_of` does, and `UnknownChoiceError` as `stones_of_lot` does.
    """
    record = find_lot(connection, a.lot)
    if record is None or find_lot(connection, b.lot) is None:
        return None
    product = find_product(connection, record.product, record.product_version)
    stones = [
        stones_of_lot(connection, side.lot, Choice(algorithm_version=side.algorithm_version or None))
        for side in (a, b)
    ]
    found = [figures_of(each, request, product, record) for each in stones]
    is_paired = a.lot == b.lot
    first, second = (
        ComparedSide(**asdict(side), measured=each.measured, calibration_ids=each.calibration_ids)
        for side, each in zip((a, b), found, strict=True)
    )
    return LotComparison(
        a=first,
        b=second,
        is_paired=is_paired,
        sieve_set=found[0].sieve_set,
        figures=compared_figures(stones, found, request.measured, is_paired=is_paired),
    )


def ends_of(difference: Difference | None) -> dict[str, Any]:
    """Return the fields of an answer that say how large a difference is."""
    if difference is None:
        return {}
    return {"difference": difference.value, "low": difference.low, "high": difference.high}


def compared_figures(
    stones: Sequence[Stones], found: Sequence[LotFigures], measured: MeasuredRange, *, is_paired: bool
) -> list[ComparedFigure]:
    """Return the figures of two lots side by side; `is_paired`: of the same stones, measured twice."""
    named = [named_figures(each) for each in found]
    sieves_mm = [step.sieve_mm for step in found[0].curve]
    percents = [each.percent for each in found[0].quantiles]
    first, second = (dict(_influences(each, sieves_mm, percents, measured)) for each in stones)
    differences: dict[str, Difference] = {}
    for name, a in first.items():
        b = second[name]
        if a is not None and b is not None:
            differences[name] = (
                difference_of_versions(a, b, *(each.measured_ids for each in stones))
                if is_paired
                else difference_of_lots(a, b)
            )
    judged = {name: each.p_value for name, each in differences.items() if each.can_be_judged}
    clear = significant(judged)
    return [
        ComparedFigure(
            figure=name,
            a=named[0][name],
            b=named[1][name],
            **ends_of(differences.get(name)),
            is_significant=name in clear if name in judged else None,
        )
        for name in first
    ]


def _influences(
    stones: Stones, sieves_mm: list[float], percents: list[float], measured: MeasuredRange
) -> Iterator[tuple[str, Influences | None]]:
    """Yield the figures by their names, each with the influences of the measured stones in their order."""
    for sieve_mm in sieves_mm:
        found = share_influences(stones.lot, passes(sieve_mm)) if sieve_mm in measured else None
        yield f"passing_{sieve_mm:g}_mm_percent", found
    for percent in percents:
        yield f"d{percent:g}_mm", size_influences(stones.lot, percent, measured)
    for name, property_of in SHARES.items():
        yield name, share_influences(stones.lot, property_of(measured))


class RunsTooFewError(ProblemError):
    """No two runs of the sample were made under equal conditions."""

    kinds = (ProblemKind("too-few-runs", HTTPStatus.CONFLICT, "The sample has too few runs to compare"),)


class Conditions(StrEnum):
    """Conditions that runs of one group have in common."""

    DAY = "day"
    """Opened on one day, UTC."""
    SAMPLER = "sampler"
    EQUIPMENT = "equipment"


class RunsOf(StrEnum):
    """Measurements that are compared."""

    INSTRUMENT = "instrument"
    """A closed lot is a run: the same stones dropped again."""
    LABORATORY = "laboratory"
    """Each sieving of these lots that counts is a run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChosenRuns:
    """Runs to compare: those of lots with a sample id, or of lots that are named."""

    sample_id: str | None = None
    lots: tuple[str, ...] = ()
    of: RunsOf = RunsOf.INSTRUMENT

    @property
    def named(self) -> str:
        """What they are called."""
        return f"sample {self.sample_id}" if self.sample_id is not None else f"lots {', '.join(self.lots)}"


@served
class Run:
    """A lot that is a run of the sample."""

    lot: str
    """Id of the lot."""
    sieving: int | None = None
    """Number of the sieving; null: the instrument's own measurement of the lot."""
    group: str
    """Runs of equal conditions have the same."""


@served
class SampleStudy:
    """Repeatability and reproducibility from repeated runs of one sample (ISO 5725-2)."""

    sample_id: str | None
    """Id of the laboratory sample; null where lots were chosen that have no common one."""
    product: str
    """Product of the newest run; all runs are judged by it."""
    product_version: int
    """Version of the product."""
    runs: list[Run]
    """Oldest first."""
    figures: Mapping[str, Repeatability]
    """By name, in the unit at its end; figures that every run has."""


def sample_study(
    connection: sqlite3.Connection, chosen: ChosenRuns, conditions: Conditions, request: Request
) -> SampleStudy | None:
    """Compare the closed lots of a sample, all by the product of the newest, or the sievings of them; None if none is.

    Raises `InvalidRequestError` if some of the named lots are not closed, `RunsTooFewError` if no two runs were made
    under equal conditions, and as `yardstick_of` does.
    """
    if chosen.sample_id is not None:
        lots = lots_of_sample(connection, chosen.sample_id)
    else:
        found_lots = (find_lot(connection, name) for name in dict.fromkeys(chosen.lots))
        lots = sorted((each for each in found_lots if each is not None), key=lambda each: each.opened_at)
    records = [each for each in lots if each.state is LotState.CLOSED]
    if not records:
        return None
    closed = {each.lot for each in records}
    if missing := [name for name in dict.fromkeys(chosen.lots) if name not in closed]:
        raise InvalidRequestError(f"lot: not closed, void or not there: {', '.join(missing)}")
    newest = records[-1]
    product = find_product(connection, newest.product, newest.product_version)
    if chosen.of is RunsOf.LABORATORY:
        runs, found = _sieved(connection, records, conditions)
    else:
        runs = [Run(lot=each.lot, group=_group(each, conditions)) for each in records]
        figures = [figures_of(stones_of_lot(connection, run.lot), request, product) for run in runs]
        found = [
            {name: each.value for name, each in named_figures(of_run).items() if each.value is not None}
            for of_run in figures
        ]
    names = [name for name in (found[-1] if found else ()) if all(name in values for values in found)]
    groups = {run.group: [each for each in range(len(runs)) if runs[each].group == run.group] for run in runs}
    try:
        if len(groups) == len(runs):
            raise ValueError("repeatability needs a group with two runs or more")
        compared = {
            name: repeatability([[found[each][name] for each in members] for members in groups.values()])
            for name in names
        }
    except ValueError as err:
        raise RunsTooFewError(f"{chosen.named}: {err}: a group has the same {conditions}") from err
    ids = {each.sample_id for each in records}
    return SampleStudy(
        sample_id=ids.pop() if len(ids) == 1 else None,
        product=newest.product,
        product_version=newest.product_version,
        runs=runs,
        figures=compared,
    )


def _sieved(
    connection: sqlite3.Connection, records: Sequence[LotDocument], conditions: Conditions
) -> tuple[list[Run], list[dict[str, float]]]:
    """Return the sievings of lots that count as runs, and the passing of each by the name of the figure."""
    runs, found = [], []
    for record in records:
        for each in valid_sievings(connection, record.lot):
            said = {Conditions.DAY: each.at[:10], Conditions.SAMPLER: each.document.by}
            group = said.get(conditions, record.equipment) or f"unknown, {each.sieving}"
            runs.append(Run(lot=record.lot, sieving=each.sieving, group=group))
            passing = each.document.passing_percent
            found.append({f"passing_{mm:g}_mm_percent": percent for mm, percent in passing.items()})
    return runs, found


def _group(record: LotDocument, conditions: Conditions) -> str:
    if conditions is Conditions.DAY:
        return record.opened_at[:10]
    said = record.sampler if conditions is Conditions.SAMPLER else record.equipment
    return said or f"unknown, {record.lot}"  # may equal no other
