"""The two estimators of all figures: the share of the stones that have a property, and the ratio of two sums.

The variance of a share with weights w is the sum of w² E[(I - P)²]. A stone near the limit has the property (I = 1)
with a probability; so the variance parts into what the stones scatter and what their measuring leaves open.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from pipeline.arrays import Values
from pipeline.gradation.estimates import (
    NOT_MEASURED,
    Errors,
    Estimate,
    estimate,
    standard_errors_to_either_end,
)
from pipeline.gradation.stones import Lot

FAR_SDS = 8.0
"""Standard deviations beyond which a stone's error does not take it over a limit."""


class Basis(StrEnum):
    """Quantity that a share refers to."""

    MASS = "mass"
    NUMBER = "number"


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """A lot in canonical order, as the figures are estimated from it; made by `sample_of`."""

    lot: Lot
    as_measured: Lot  # the same, its measures taken for the truth
    larger: Lot  # the same, had all lengths been measured larger by their common standard deviation
    smaller: Lot

    def weights(self, basis: Basis) -> tuple[Values, Values]:
        """Return the weight of each stone, and its relative standard deviation."""
        volumes, sds = self.lot.column("volume_mm3"), self.lot.column("volume_sd")
        return (volumes, sds) if basis is Basis.MASS else (np.ones_like(volumes), np.zeros_like(sds))

    def near(self, low_mm: float, high_mm: float) -> "Sample":
        """Return the sample of the stones that may lie between two sieves: no other one counts there."""
        is_near = np.zeros(self.lot.n_measured, bool)
        for lot in (self.lot, self.larger, self.smaller):
            sizes_mm, reach_mm = lot.column("sieve_size_mm"), FAR_SDS * lot.column("sieve_size_sd_mm")
            is_near |= (sizes_mm + reach_mm > low_mm) & (sizes_mm - reach_mm <= high_mm)
        return self.where(is_near)

    def where(self, is_wanted: NDArray[np.bool_]) -> "Sample":
        """Return the sample of some of the stones."""
        return Sample(
            lot=self.lot.where(is_wanted),
            as_measured=self.as_measured.where(is_wanted),
            larger=self.larger.where(is_wanted),
            smaller=self.smaller.where(is_wanted),
        )


def sample_of(lot: Lot, scale_sd: float = 0.0) -> Sample:
    """Return the sample of a lot; `scale_sd` is the relative standard deviation that all lengths have in common."""
    lot = lot.canonical()
    larger, smaller = (lot.scaled(1 + sign * scale_sd) if scale_sd else lot for sign in (1, -1))
    return Sample(lot=lot, as_measured=lot.without_errors(), larger=larger, smaller=smaller)


class Chances(NamedTuple):
    """For each stone, the probability that it counts at all, and that it counts and has the property."""

    counts: Values
    has: Values

    def share(self, weights: Values) -> float:
        """Return the weighted share of those that count, 0..1; 0 when none does."""
        return _quotient(weights * self.has, weights * self.counts)

    def scatter(self, share: float) -> Values:
        """Return by how much each stone is expected to differ from the share."""
        return self.has - share * self.counts

    def open_variance(self, share: float, weight_sds: Values) -> Values:
        """Return the variance about that: of what is not certain, and of the weights, which have relative errors."""
        has_not, counts_not = 1 - self.has, 1 - self.counts
        uncertain = self.has * (has_not - 2 * share * counts_not) + share**2 * self.counts * counts_not
        return uncertain + (weight_sds * self.scatter(share)) ** 2


class Share(NamedTuple):
    """A share, 0..1, with its errors, its interval, and what that is made of."""

    value: float
    errors: Errors
    interval: tuple[float, float]
    interval_errors: Errors  # those of stones that happened not to fall included
    reach: float  # of the interval to either side of its centre, in all of these errors
    n_stones: int
    n_effective: float


Property = Callable[[Lot], Chances]
"""What a share is the share of; without errors of measuring its chances are 0 and 1."""


def chance_up_to(values: Values, sds: Values, limit: float) -> Values:
    """Return the probability that each value is at most the limit, given its normal error."""
    chances = (values <= limit).astype(float)
    near = np.flatnonzero(np.abs(limit - values) < FAR_SDS * sds)
    chances[near] = ndtr((limit - values[near]) / sds[near])
    return chances


def share_percent(
    sample: Sample,
    property_: Property,
    basis: Basis = Basis.MASS,
    *,
    unseen_weight: float | None = None,
    min_stones: int = 0,
) -> Estimate:
    """Return the share of the stones that have a property, in percent of those that count.

    `unseen_weight` is that of stones that might have fallen (see `_interval`), by default the mean over the mass.
    """
    weights, sds = sample.weights(basis)
    return weighted_share_percent(
        sample, property_, weights, sds, unseen_weight=unseen_weight, min_stones=min_stones
    )


def weighted_share_percent(
    sample: Sample,
    property_: Property,
    weights: Values,
    weight_sds: Values,
    *,
    unseen_weight: float | None = None,
    min_stones: int = 0,
) -> Estimate:
    """Return such a share where each stone has a weight of its own, with a relative standard deviation."""
    share = share_of(sample, property_, weights, weight_sds, unseen_weight=unseen_weight)
    if share is None:
        return NOT_MEASURED
    low, high = share.interval
    return estimate(
        100 * share.value,
        (100 * low, 100 * high),
        share.errors.times(100),
        share.n_stones,
        share.n_effective,
        min_stones,
    )


def share_of(
    sample: Sample,
    property_: Property,
    weights: Values,
    weight_sds: Values,
    *,
    unseen_weight: float | None = None,
) -> Share | None:
    """Return the share of the stones that have a property, None if no stone counts."""
    as_measured, chances = property_(sample.as_measured), property_(sample.lot)
    total, n_stones = float(np.sum(weights * as_measured.counts)), int(as_measured.counts.sum())
    if not n_stones:
        return None
    value, n_effective = as_measured.share(weights), effective_number(weights * as_measured.counts)
    mean, parts = chances.share(weights), weights / total
    errors = Errors(
        sampling=sqrt(np.sum((parts * chances.scatter(mean)) ** 2)),
        measuring=sqrt(np.sum(parts**2 * chances.open_variance(mean, weight_sds))),
        systematic=_systematic(lambda lot: property_(lot).share(weights), sample),
    )
    unseen_part = 1 / n_effective if unseen_weight is None else unseen_weight / total
    found = _interval(value, chances, parts, weight_sds, unseen_part, errors.systematic, n_effective)
    return Share(value, errors, *found, n_stones, n_effective)


def _interval(
    value: float,
    chances: Chances,
    parts: Values,
    weight_sds: Values,
    unseen_part: float,
    systematic: float,
    n_effective: float,
) -> tuple[tuple[float, float], Errors, float]:
    """Return the interval of a share, 0..1, with its errors and Student's t: Agresti and Coull's, with weights.

    It is as if two more stones with the property and two without it had fallen. So it has a width where all stones or
    none have the property, and covers the heavy ones that happened not to fall. A stone counts for what its absence
    would change (the jackknife), more than its weight. Where a few stones make up the variance it is less certain than
    the effective number says: the degrees of freedom are the geometric mean of that and of Satterthwaite's. Its centre
    lies towards one half: of a handful of stones the share itself may lie beyond an end, which then reaches to it.
    """
    n_unseen = standard_errors_to_either_end(n_effective - 1) ** 2 / 2  # two with the property, two without
    larger = 1 + 2 * n_unseen * unseen_part
    centre, parts = (value + n_unseen * unseen_part) / larger, parts / larger
    scatter, open_variance = chances.scatter(centre), chances.open_variance(centre, weight_sds)
    sampled, measured = (parts / (1 - parts) * scatter) ** 2, parts**2 * open_variance
    seen = sampled + measured
    unseen = (unseen_part / larger) ** 2 * np.array([centre**2, (1 - centre) ** 2])
    variance = float(seen.sum() + n_unseen * unseen.sum())
    satterthwaite = variance**2 / float(np.sum(seen**2) + n_unseen * np.sum(unseen**2))
    reach = standard_errors_to_either_end(sqrt(n_effective * satterthwaite))
    half = reach * hypot(sqrt(variance), systematic)
    interval = min(max(centre - half, 0.0), value), max(min(centre + half, 1.0), value)
    by_sampling = sqrt(float(sampled.sum() + n_unseen * unseen.sum()))
    return interval, Errors(by_sampling, sqrt(float(measured.sum())), systematic), reach


def ratio_of_sums(sample: Sample, terms: Callable[[Lot], tuple[Values, Values]]) -> Estimate:
    """Return sum A / sum B over the stones, as `terms` gives A and B of each; NaN leaves a stone out.

    Random errors of measuring scatter the terms too, so the scatter found already contains them.
    """
    sample = sample.where(~np.isnan(np.add(*terms(sample.lot))))
    lot = sample.lot
    above, below = terms(lot)
    total = float(below.sum())
    if not total:
        return NOT_MEASURED
    value = _quotient(above, below)
    scatter = sqrt(np.sum((above - value * below) ** 2)) / total
    sizes_mm, sds_mm = lot.column("sieve_size_mm"), lot.column("sieve_size_sd_mm")
    larger, smaller = (terms(lot.with_sizes(sizes_mm + sign * sds_mm)) for sign in (1, -1))
    changes = ((larger[0] - smaller[0]) - value * (larger[1] - smaller[1])) / 2
    measuring = min(sqrt(np.sum(changes**2)) / total, scatter)
    errors = Errors(
        sampling=sqrt(scatter**2 - measuring**2),
        measuring=measuring,
        systematic=_systematic(lambda of: _quotient(*terms(of)), sample),
    )
    n_effective = effective_number(below)
    half = standard_errors_to_either_end(n_effective - 1) * errors.joined
    return estimate(value, (value - half, value + half), errors, lot.n_measured, n_effective)


def effective_number(weights: Values) -> float:
    """Return (sum w)² / sum w²."""
    return _quotient(np.square(weights.sum(keepdims=True)), np.sum(weights**2, keepdims=True))


def _quotient(above: Values, below: Values) -> float:
    """Return the quotient of the sums, 0 when there is nothing to divide by."""
    total = float(below.sum())
    return float(above.sum()) / total if total else 0.0


def _systematic(figure: Callable[[Lot], float], sample: Sample) -> float:
    """Return by how much a figure changes with the scale of all lengths, one standard deviation of it."""
    if sample.larger is sample.smaller:
        return 0.0
    return abs(figure(sample.larger) - figure(sample.smaller)) / 2
