"""Distributions of the measures of shape over the stones of a lot, by mass and by number."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

import numpy as np

from pipeline.arrays import Values
from pipeline.gradation.curve import quantile_estimate, value_at
from pipeline.gradation.estimates import NOT_MEASURED, Estimate
from pipeline.gradation.estimators import Chances, Property, Sample, ratio_of_sums, share_percent
from pipeline.gradation.stones import Lot
from pipeline.schema import SCHEMA

PERCENTS = (10, 50, 90)


class ShapeMeasure(StrEnum):
    """Measure of shape, as a result and `Stone` name it."""

    ELONGATION_RATIO = "elongation_ratio"
    FLATNESS_RATIO = "flatness_ratio"
    SPHERICITY = "sphericity"
    CONVEXITY = "convexity"
    ANGULARITY = "angularity"


OF_RATIOS = np.linspace(0, 1, 21).round(2)
EDGES: Mapping[ShapeMeasure, Values] = {
    **dict.fromkeys(ShapeMeasure, OF_RATIOS),
    ShapeMeasure.ANGULARITY: np.linspace(0, 10_000, 51),
}
"""Edges of the classes of each measure; what lies beyond belongs to the last one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureClass:
    """A class of a distribution: from its lower edge to before its upper one; the upmost has that, too."""

    __pydantic_config__ = SCHEMA

    lower: float
    """Lower edge"""
    upper: float
    """Upper edge"""
    mass_percent: float
    """Share of the mass"""
    number_percent: float
    """Share of the stones"""


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasureQuantile:
    """A value that a share of the mass does not exceed."""

    __pydantic_config__ = SCHEMA

    percent: int
    """Share of the mass, %: 50 is the median"""
    value: Estimate
    """From the stones themselves"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution:
    """Distribution of a measure over the stones of a lot, the mass of each by its volume.

    Intervals are of the sampling; the errors of each stone's measure have widened what it scatters already.
    """

    __pydantic_config__ = SCHEMA

    measure: ShapeMeasure
    """Field of a result"""
    n_stones: int
    """Stones that have the measure"""
    n_unmeasured: int
    """Measured stones of earlier versions that lack it: in none of the figures"""
    mean: Estimate
    """Mean by mass"""
    quantiles: Sequence[MeasureQuantile]
    """By rising percent"""
    classes: Sequence[MeasureClass]
    """From the first to the last that has stones, rising; none without stones"""


def up_to(measure: str, limit: float) -> Property:
    """Return the property of having at most this value of a measure."""

    def chances(lot: Lot) -> Chances:
        values = lot.column(measure)
        return Chances(np.ones_like(values), (values <= limit).astype(float))

    return chances


def distribution_of(sample: Sample, measure: ShapeMeasure) -> Distribution:
    """Return the distribution of a measure; stones that lack it are counted apart."""
    is_known = ~np.isnan(sample.lot.column(measure))
    known = sample.where(is_known)
    return Distribution(
        measure=measure,
        n_stones=known.lot.n_measured,
        n_unmeasured=sample.lot.n_measured - known.lot.n_measured,
        mean=ratio_of_sums(known, _moments(measure)),
        quantiles=[MeasureQuantile(percent=each, value=_quantile(known, measure, each)) for each in PERCENTS],
        classes=_classes(known.lot, measure) if known.lot.n_measured else (),
    )


def _moments(measure: str) -> Callable[[Lot], tuple[Values, Values]]:
    def terms(lot: Lot) -> tuple[Values, Values]:
        volumes = lot.column("volume_mm3")
        return volumes * lot.column(measure), volumes

    return terms


def _quantile(sample: Sample, measure: str, percent: float) -> Estimate:
    """Return the value that so many percent of the mass do not exceed; its interval is that of the share, inverted."""
    order = np.argsort(sample.lot.column(measure), kind="stable")
    values, volumes = sample.lot.column(measure)[order], sample.lot.column("volume_mm3")[order]
    if not len(values):
        return NOT_MEASURED
    value = value_at(values, volumes, percent)
    share = share_percent(sample, up_to(measure, value))
    low_percent, high_percent = share.low or 0.0, share.high or 0.0
    low, high = (value_at(values, volumes, end) for end in (low_percent, high_percent))
    errors = share.errors.times((high - low) / (high_percent - low_percent))
    return quantile_estimate(share, value, (low, high), errors)


def _classes(lot: Lot, measure: ShapeMeasure) -> list[MeasureClass]:
    edges, volumes = EDGES[measure], lot.column("volume_mm3")
    values = np.clip(lot.column(measure), edges[0], edges[-1])
    by_number, _ = np.histogram(values, edges)
    by_mass, _ = np.histogram(values, edges, weights=volumes)
    occupied = np.flatnonzero(by_number)
    shown = slice(occupied[0], occupied[-1] + 1)
    shares = zip(
        pairwise(edges.tolist()), 100 * by_mass / volumes.sum(), 100 * by_number / len(values), strict=True
    )
    return [
        MeasureClass(lower=lower, upper=upper, mass_percent=float(mass), number_percent=float(number))
        for (lower, upper), mass, number in list(shares)[shown]
    ]
