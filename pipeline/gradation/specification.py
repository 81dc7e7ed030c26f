"""Specifications of a product, and the verdict on a lot: conforms, does not, or undecided, and for how long."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from math import ceil, hypot, log, sqrt

from pipeline.gradation.estimates import (
    MIN_EFFECTIVE,
    NOT_MEASURED,
    Estimate,
    State,
    standard_errors_to_either_end,
)
from pipeline.gradation.evaluation import Gradation
from pipeline.schema import SCHEMA

UNPROVEN_PERCENT = 2.0
"""Mass that may be retained, at the upper end of the interval, where 100 % must pass: no number of stones proves that
all do. A test portion of EN 933-1, some 900 stones, tells as much, and the wider categories tolerate it."""


class Verdict(StrEnum):
    """Whether a figure meets its limits, the gravest first; a word of the REST contract."""

    DOES_NOT_CONFORM = "does_not_conform"
    """The 95 % interval is outside of the limits."""
    INSUFFICIENT = "insufficient"
    """Too few stones for any verdict."""
    UNDECIDED = "undecided"
    """The interval reaches over a limit: more stones are needed."""
    CONFORMS = "conforms"
    """The interval is inside."""
    NOT_MEASURED = "not_measured"
    """Not in the range of sizes that is measured."""


@dataclass(frozen=True, slots=True)
class Range:
    """Limits of a specification, percent."""

    __pydantic_config__ = SCHEMA

    min_percent: float
    """Least percent that is allowed"""
    max_percent: float
    """Greatest percent that is allowed"""
    declared_max_percent: float | None = None
    """Greatest percent where the supplier declares the product's typical grading, as EN 13043 and EN 12620 ask where
    more than 99 % passes the upper size D; null: `max_percent`, whatever is declared"""

    def __post_init__(self) -> None:
        if not 0 <= self.min_percent <= self.max_percent <= 100:
            raise ValueError(
                f"limits must rise from 0 to 100 %, not {self.min_percent:g} to {self.max_percent:g}"
            )
        if not self.max_percent <= self.greatest_percent <= 100:
            raise ValueError(
                f"with a declaration up to {self.greatest_percent:g} %, between {self.max_percent:g} and 100"
            )

    @property
    def greatest_percent(self) -> float:
        """Greatest percent that conforms, if need be with a declaration."""
        return self.max_percent if self.declared_max_percent is None else self.declared_max_percent


@dataclass(frozen=True, slots=True, kw_only=True)
class Specification:
    """Limits of a product: of the passing by sieve, and of the indices."""

    name: str
    source: str
    is_general: bool = False  # values are general knowledge of the source, not compared with its text
    passing: Mapping[float, Range]  # by aperture in mm
    flakiness: Range | None = None
    shape: Range | None = None
    step_percent: float = (
        1.0  # results are rounded to it before they are compared, as the standards report them
    )


def with_declaration(specification: Specification, declared: Mapping[float, Range]) -> Specification:
    """Return the specification of a product whose typical grading is declared: what is declared must hold as well.

    `declared`: typical passing less and plus its tolerance, by aperture in mm (EN 13043 and EN 12620, clauses on the
    typical grading); where more than 99 % pass D, it is the declaration that these ask for.

    Raises
    ------
    ValueError
        No passing would meet both; names the sieve.
    """
    passing = dict(specification.passing)
    for sieve_mm, tolerated in declared.items():
        allowed = passing.get(sieve_mm, tolerated)
        low = max(allowed.min_percent, tolerated.min_percent)
        high = min(allowed.greatest_percent, tolerated.max_percent)
        if low > high:
            limits = f"{allowed.min_percent:g} to {allowed.greatest_percent:g} %"
            raise ValueError(f"{sieve_mm:g} mm: what is declared lies outside of the limits {limits}")
        passing[sieve_mm] = Range(low, high)
    return replace(specification, passing=passing)


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """The verdict on one figure."""

    __pydantic_config__ = SCHEMA

    verdict: Verdict
    """By the 95 % interval: inside the limits, outside, or neither for certain"""
    limits: Range
    """What the specification allows"""
    more_stones: int | None = None
    """Stones until it is expected to be decided; null: decided, or never"""
    more_s: float | None = None
    """Seconds that these take at the present rate"""
    asks_declaration: bool = False
    """More passes than `limits.max_percent`: conforms only with the supplier's declaration of the typical grading"""


@dataclass(frozen=True, slots=True, kw_only=True)
class LotJudgement:
    """The verdict on a lot: the gravest of all figures that were measured."""

    verdict: Verdict
    is_partial: bool  # some figures of the specification were not measured
    passing: Mapping[float, Decision]  # by aperture in mm
    flakiness: Decision | None
    shape: Decision | None
    more_stones: int | None  # until the last figure is expected to be decided


def judge(specification: Specification, gradation: Gradation, stones_per_s: float = 0.0) -> LotJudgement:
    """Return the verdict; a sieve that the gradation was not evaluated at was not measured."""
    found = {point.sieve_mm: point.by_mass for point in gradation.curve}
    indices = gradation.indices
    return judge_figures(specification, found, indices.flakiness_percent, indices.shape_percent, stones_per_s)


def judge_figures(
    specification: Specification,
    passing: Mapping[float, Estimate],
    flakiness: Estimate = NOT_MEASURED,
    shape: Estimate = NOT_MEASURED,
    stones_per_s: float = 0.0,
) -> LotJudgement:
    """Return the verdict on a curve and indices of any origin."""

    def judged(figure: Estimate, limits: Range) -> Decision:
        return judge_figure(figure, limits, specification.step_percent, stones_per_s)

    by_sieve = {
        sieve_mm: judged(passing.get(sieve_mm, NOT_MEASURED), limits)
        for sieve_mm, limits in specification.passing.items()
    }
    of_flakiness = None if specification.flakiness is None else judged(flakiness, specification.flakiness)
    of_shape = None if specification.shape is None else judged(shape, specification.shape)
    all_ = [*by_sieve.values(), *(found for found in (of_flakiness, of_shape) if found is not None)]
    verdicts = {found.verdict for found in all_}
    return LotJudgement(
        verdict=next(verdict for verdict in Verdict if verdict in verdicts | {Verdict.NOT_MEASURED}),
        is_partial=Verdict.NOT_MEASURED in verdicts,
        passing=by_sieve,
        flakiness=of_flakiness,
        shape=of_shape,
        more_stones=max((found.more_stones for found in all_ if found.more_stones is not None), default=None),
    )


def judge_figure(figure: Estimate, limits: Range, step_percent: float, stones_per_s: float = 0.0) -> Decision:
    """Return the verdict on one figure, by its interval; without a rate, no time until it is decided."""
    if figure.value is None or figure.low is None or figure.high is None:
        return Decision(verdict=Verdict.NOT_MEASURED, limits=limits)
    low, high = limits.min_percent - step_percent / 2, limits.greatest_percent + step_percent / 2
    low_end = 100 - UNPROVEN_PERCENT if limits.min_percent == 100 else low
    if figure.state is State.INSUFFICIENT:
        verdict = Verdict.INSUFFICIENT
    elif figure.high < low or high < figure.low:
        verdict = Verdict.DOES_NOT_CONFORM
    elif low <= figure.value and low_end <= figure.low and figure.high <= high:
        verdict = Verdict.CONFORMS
    else:
        verdict = Verdict.UNDECIDED
    more_stones = None
    if verdict in (Verdict.INSUFFICIENT, Verdict.UNDECIDED):
        more_stones = _more_stones(figure, low_end if figure.value >= low else low, high)
    more_s = None if more_stones is None or stones_per_s <= 0 else more_stones / stones_per_s
    asks_declaration = limits.max_percent + step_percent / 2 < figure.value <= high
    return Decision(
        verdict=verdict,
        limits=limits,
        more_stones=more_stones,
        more_s=more_s,
        asks_declaration=asks_declaration,
    )


def _more_stones(figure: Estimate, low: float, high: float) -> int | None:
    """Number of further stones that shrink the interval off the limits that it reaches over, if the figure stays.

    Random errors fall with the root of the number of stones, what stones that did not fall would change with the number
    itself; systematic errors stay.
    """
    if figure.value is None or figure.low is None or figure.high is None:
        return None
    reach_of = standard_errors_to_either_end(figure.n_effective - 1)
    stays = (reach_of * figure.errors.systematic) ** 2
    factor = MIN_EFFECTIVE / max(figure.n_effective, 1.0)
    for limit in (low, high):
        end = figure.low if limit < figure.value else figure.high
        if abs(end - figure.value) <= abs(limit - figure.value):
            continue
        if (limit - figure.value) ** 2 <= stays:
            return None
        margin, reach = (sqrt((size - figure.value) ** 2 - stays) for size in (limit, end))
        random = min(reach_of * hypot(figure.errors.sampling, figure.errors.measuring), reach)
        # root of: (reach - random) x² + random x = margin, with x² the present number of stones by the one needed
        root = 2 * margin / (random + sqrt(random**2 + 4 * (reach - random) * margin))
        factor = max(factor, 1 / root**2)
    return max(ceil(figure.n_stones * (factor - 1)), 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class CategoryLimit:
    """Limits of the passing at a multiple of a product's lower size d or upper size D."""

    is_upper: bool
    factor: float
    limits: Range


@dataclass(frozen=True, slots=True, kw_only=True)
class Category:
    """Limits for any product d/D, as EN 13043 and EN 12620 give them."""

    name: str
    source: str
    passing: tuple[CategoryLimit, ...]
    is_general: bool = False


def specification_of(
    category: Category,
    lower_mm: float,
    upper_mm: float,
    apertures_mm: Iterable[float],
    *,
    flakiness: Range | None = None,
    shape: Range | None = None,
) -> Specification:
    """Return the specification of a product d/D; a size that no sieve has is that of the nearest of `apertures_mm`."""
    if not 0 < lower_mm < upper_mm:
        raise ValueError(f"a product needs 0 < d < D, not {lower_mm:g}/{upper_mm:g}")
    sieves_mm = tuple(apertures_mm)
    return Specification(
        name=f"{category.name} {lower_mm:g}/{upper_mm:g}",
        source=category.source,
        is_general=category.is_general,
        passing={
            nearest_mm(limit.factor * (upper_mm if limit.is_upper else lower_mm), sieves_mm): limit.limits
            for limit in category.passing
        },
        flakiness=flakiness,
        shape=shape,
    )


def nearest_mm(size_mm: float, apertures_mm: Iterable[float]) -> float:
    """Return the sieve nearest to a size, by their ratio."""
    return min(apertures_mm, key=lambda aperture_mm: abs(log(aperture_mm / size_mm)))
