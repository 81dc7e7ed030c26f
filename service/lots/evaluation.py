"""From the stones of a lot to its figures and its verdict; pure, so that any process may compute them."""

import sqlite3
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime, timedelta

from pydantic import BaseModel

from pipeline.frames import rfc3339
from pipeline.gradation.correlation import correlated
from pipeline.gradation.curve import curve_of
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.estimators import sample_of
from pipeline.gradation.evaluation import Gradation, evaluate
from pipeline.gradation.sieves import MeasuredRange
from pipeline.gradation.specification import Decision, LotJudgement, Verdict, judge
from pipeline.gradation.stones import Fate, Lot
from pipeline.uncertainty.evidence import LENGTH_SD_PERCENT
from service.lots.correlations import CorrelationDocument, correlation_in_use
from service.lots.figures import (
    CorrelatedCurve,
    CorrelatedStep,
    CurveStep,
    LotFigures,
    ProductDocument,
    Quantile,
)
from service.lots.lots import LotDocument, find_lot
from service.lots.products import Product, find_product
from service.lots.standards import read_standards
from service.lots.stones import ALL_STONES, Choice, Stones, stones_between, stones_of_lot
from service.lots.yardsticks import Request, Yardstick, yardstick_of

LEAST_PORTIONS = "en-933-1"
OF_STONES = (
    "since", "until", "by_body", "not_refined", "calibration_ids", "algorithm_versions", "is_simulated", "is_replay",
)  # fmt: skip
"""Figures of a lot that are said of its stones as they are."""
RATE_OVER_S = 60.0
"""Time over which the present rate of stones is taken."""


def lot_figures(
    connection: sqlite3.Connection, lot: str, request: Request, choice: Choice = ALL_STONES
) -> LotFigures | None:
    """Return the figures of a lot, or of a choice of its stones; None if there is no such lot.

    Raises `UnknownYardstickError` as `yardstick_of` does, and `UnknownChoiceError` as `stones_of_lot` does.
    """
    record = find_lot(connection, lot)
    if record is None:
        return None
    product = find_product(connection, record.product, record.product_version)
    stones = stones_of_lot(connection, lot, choice)
    in_use = correlation_in_use(connection, record.product)
    figures = figures_of(stones, request, product, record, stones_per_s(connection), in_use)
    asked = {"without": list(choice.without), "algorithm_version": choice.algorithm_version}
    return figures.model_copy(update=asked)


def window_figures(
    connection: sqlite3.Connection, since: str, until: str, request: Request, product: str | None
) -> LotFigures | None:
    """Return the figures of what fell within a time, by a product's newest version; None if that is unknown."""
    found = None if product is None else find_product(connection, product)
    if product is not None and found is None:
        return None
    stones = stones_between(connection, since, until)
    return figures_of(stones, request, found, rate_per_s=stones_per_s(connection))


def as_json(
    connection: sqlite3.Connection, make: Callable[..., BaseModel | None], *given: object
) -> str | None:
    """Return `make(connection, *given)` as JSON, for a process that has the connection; None if there is none."""
    found = make(connection, *given)
    return None if found is None else found.model_dump_json()


def stones_per_s(connection: sqlite3.Connection) -> float:
    """Return the rate of measured stones, 1/s, within the last minute."""
    since = rfc3339(datetime.now(UTC) - timedelta(seconds=RATE_OVER_S))
    (n_stones,) = connection.execute(
        # by the time of the result: a replay's stones fell long ago
        "SELECT count(*) FROM results JOIN stones USING (seq)"
        " WHERE json_extract(record, '$.recorded_at') >= ? AND stones.outcome = 'measured'",
        (since,),
    ).fetchone()
    return float(n_stones / RATE_OVER_S)


def figures_of(
    stones: Stones,
    request: Request,
    product: Product | None = None,
    record: LotDocument | None = None,
    rate_per_s: float = 0.0,
    correlation: CorrelationDocument | None = None,
) -> LotFigures:
    """Return the figures of stones, with the verdict by the specification of their product or of the request."""
    yardstick = yardstick_of(product, request)
    specification, apertures_mm = yardstick.specification, yardstick.apertures_mm
    scale_sd = LENGTH_SD_PERCENT / 100
    gradation = evaluate(
        stones.lot,
        apertures_mm,
        measured=yardstick.measured,
        scale_sd=scale_sd,
        percents=yardstick.percents,
    )
    judgement = None if specification is None else judge(specification, gradation, rate_per_s)
    name = None if specification is None else specification.name
    upper_mm = None if product is None else product.upper_mm
    fates: Counter[Fate] = Counter()
    for (fate, _), n_stones in stones.lot.counts.items():
        fates[fate] += n_stones
    return LotFigures(
        lot=record,
        product=None
        if product is None
        else ProductDocument.model_validate(asdict(product) | {"specification": name}),
        **{name: getattr(stones, name) for name in OF_STONES},
        triggers=sum(fates.values()),
        measured=fates[Fate.MEASURED],
        rejected=fates[Fate.REJECTED],
        lost=fates[Fate.LOST],
        by_quality={word: n for (fate, word), n in stones.lot.counts.items() if fate is Fate.MEASURED},
        mass_kg=None if product is None else gradation.volume_mm3 * 1e-9 * product.density_kg_m3,
        n_effective=gradation.n_effective,
        sieve_set=yardstick.sieves.name,
        specification=name,
        specification_source=None if specification is None else specification.source,
        specification_is_general=specification is not None and specification.is_general,
        curve=_curve(gradation, judgement),
        correlated=None if correlation is None else _correlated(stones.lot, correlation, yardstick),
        quantiles=[
            Quantile(percent=percent, interpolated_mm=each, exact_mm=gradation.quantiles_exact_mm[percent])
            for percent, each in sorted(gradation.quantiles_interpolated_mm.items())
        ],
        indices=gradation.indices,
        flakiness_decision=None if judgement is None else judgement.flakiness,
        shape_decision=None if judgement is None else judgement.shape,
        verdict=None if judgement is None else judgement.verdict,
        is_partial=judgement is not None and judgement.is_partial,
        countdown=None if judgement is None else countdown(judgement),
        uncertainty=list(gradation.budgets),
        unmeasured=gradation.unmeasured,
        least_portion_kg=None
        if upper_mm is None
        else read_standards().least_portions[LEAST_PORTIONS].least_kg(upper_mm),
        scale_sd_percent=LENGTH_SD_PERCENT,
    )


def passing_of(lot: Lot, apertures_mm: Sequence[float], measured: MeasuredRange) -> dict[float, Estimate]:
    """Return the passing by mass at these sieves, percent."""
    sample = sample_of(lot, LENGTH_SD_PERCENT / 100)
    return {point.sieve_mm: point.by_mass for point in curve_of(sample, apertures_mm, measured)}


def countdown(judgement: LotJudgement) -> str:
    """Summarise decided and undecided figures: "16 mm: conforms; 4 mm (about 220 stones, 55 s more): undecided"."""
    named = [(f"{sieve_mm:g} mm", each) for sieve_mm, each in sorted(judgement.passing.items(), reverse=True)]
    named += [(name, each) for name, each in (("FI", judgement.flakiness), ("SI", judgement.shape)) if each]
    by_verdict: dict[Verdict, list[str]] = {}
    for name, each in named:
        by_verdict.setdefault(each.verdict, []).append(name + _remark(each))
    return "; ".join(
        f"{', '.join(names)}: {verdict.replace('_', ' ')}" for verdict, names in sorted(by_verdict.items())
    )


def _remark(decision: Decision) -> str:
    if decision.asks_declaration and decision.verdict is Verdict.CONFORMS:
        return " (with the typical grading declared)"
    if decision.more_stones is None:
        return ""
    seconds = "" if decision.more_s is None else f", {decision.more_s:.0f} s"
    return f" (about {decision.more_stones} stones{seconds} more)"


def _curve(gradation: Gradation, judgement: LotJudgement | None) -> list[CurveStep]:
    decisions = {} if judgement is None else judgement.passing
    return [
        CurveStep(
            sieve_mm=point.sieve_mm,
            passing_percent=point.by_mass,
            passing_by_number_percent=point.by_number,
            decision=decisions.get(point.sieve_mm),
        )
        for point in gradation.curve
    ]


def _correlated(lot: Lot, correlation: CorrelationDocument, yardstick: Yardstick) -> CorrelatedCurve:
    passing = passing_of(correlated(lot, correlation.mapping), yardstick.apertures_mm, yardstick.measured)
    return CorrelatedCurve(
        version=correlation.version,
        factor=correlation.factor,
        n_lots=correlation.n_lots,
        held_out_rmse=correlation.held_out_rmse,
        curve=[CorrelatedStep(sieve_mm=sieve_mm, passing_percent=each) for sieve_mm, each in passing.items()],
    )
