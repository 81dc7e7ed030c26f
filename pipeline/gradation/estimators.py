"""The two estimators of all figures: the share of the stones that have a property, and the ratio of two sums.

The variance of a share with weights w is the sum of w² E[(I - P)²]. A stone near the limit has the property (I = 1)
with a probability; so the variance parts into what the stones scatter and what their measuring leaves open.
"""

from collections.abc import Callable
from math import hypot, sqrt
from typing import NamedTuple

import numpy as np
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

    def open_variance(self, share: float) -> Values:
        """Return the variance about that: zero where the chances are 0 or 1."""
        has_not, counts_not = 1 - self.has, 1 - self.counts
        return self.has * (has_not - 2 * share * counts_not) + share**2 * self.counts * counts_not


Property = Callable[[Lot], Chances]
"""What a share is the share of; without errors of measuring its chances are 0 and 1."""


def chance_up_to(values: Values, sds: Values, limit: float) -> Values:
    """Return the probability that each value is at most the limit, given its normal error."""
    chances = (values <= limit).astype(float)
    near = np.flatnonzero(np.abs(limit - values) < FAR_SDS * sds)
    chances[near] = ndtr((limit - values[near]) / sds[near])
    return chances


def share_percent(
    lot: Lot,
    property_: Property,
    weights: Values,
    scale_sd: float,
    *,
    unseen_weight: float | None = None,
    min_stones: int = 0,
) -> Estimate:
    """Return the weighted share of the stones that have a property, in percent of those that count.

    The standard errors are the formula's. The interval is Agresti and Coull's: as if two more stones with the property
    and two without it had fallen, each of `unseen_weight`, by default the mean over the mass. So it has a width where
    all stones or none have the property, and it covers the heavy stones that happened not to fall. In it a stone counts
    for what its absence would change (the jackknife), which is more than its weight.
    """
    as_measured, chances = property_(lot.without_errors()), property_(lot)
    total, n_stones = float(np.sum(weights * as_measured.counts)), int(as_measured.counts.sum())
    if not n_stones:
        return NOT_MEASURED
    value, n_effective = as_measured.share(weights), effective_number(weights * as_measured.counts)
    systematic = _systematic(lambda at: property_(at).share(weights), lot, scale_sd)

    def errors(share: float, parts: Values, influences: Values) -> Errors:
        scatter = chances.scatter(share)
        open_variance = chances.open_variance(share) + (lot.column("volume_sd") * scatter) ** 2
        return Errors(
            sampling=float(np.sqrt(np.sum((influences * scatter) ** 2))),
            measuring=float(np.sqrt(np.sum(parts**2 * open_variance))),
            systematic=systematic,
        )

    unseen = total / n_effective if unseen_weight is None else unseen_weight
    z = standard_errors_to_either_end(n_effective)
    larger = total + z**2 * unseen
    centre, parts = (value * total + z**2 / 2 * unseen) / larger, weights / larger
    unseen_variance = z**2 / 2 * (unseen / larger) ** 2 * (centre**2 + (1 - centre) ** 2)
    half = z * hypot(errors(centre, parts, parts / (1 - parts)).joined, sqrt(unseen_variance))
    return estimate(
        100 * value,
        (100 * max(centre - half, 0.0), 100 * min(centre + half, 1.0)),
        errors(chances.share(weights), weights / total, weights / total).times(100),
        n_stones,
        n_effective,
        min_stones,
    )


def ratio_of_sums(lot: Lot, terms: Callable[[Lot], tuple[Values, Values]], scale_sd: float) -> Estimate:
    """Return sum A / sum B over the stones, as `terms` gives A and B of each.

    Random errors of measuring scatter the terms too, so the scatter found already contains them.
    """
    above, below = terms(lot)
    total = float(below.sum())
    if not total:
        return NOT_MEASURED
    value = _quotient(above, below)
    scatter = float(np.sqrt(np.sum((above - value * below) ** 2))) / total
    sizes_mm, sds_mm = lot.column("sieve_size_mm"), lot.column("sieve_size_sd_mm")
    larger, smaller = (terms(lot.with_sizes(sizes_mm + sign * sds_mm)) for sign in (1, -1))
    changes = ((larger[0] - smaller[0]) - value * (larger[1] - smaller[1])) / 2
    measuring = min(float(np.sqrt(np.sum(changes**2))) / total, scatter)
    errors = Errors(
        sampling=sqrt(scatter**2 - measuring**2),
        measuring=measuring,
        systematic=_systematic(lambda at: _quotient(*terms(at)), lot, scale_sd),
    )
    n_effective = effective_number(below)
    half = standard_errors_to_either_end(n_effective) * errors.joined
    return estimate(value, (value - half, value + half), errors, lot.n_measured, n_effective)


def effective_number(weights: Values) -> float:
    """Return (sum w)² / sum w²."""
    return _quotient(np.square(weights.sum(keepdims=True)), np.sum(weights**2, keepdims=True))


def _quotient(above: Values, below: Values) -> float:
    """Return the quotient of the sums, 0 when there is nothing to divide by."""
    total = float(below.sum())
    return float(above.sum()) / total if total else 0.0


def _systematic(figure: Callable[[Lot], float], lot: Lot, scale_sd: float) -> float:
    """Return by how much a figure changes with the scale of all lengths, one standard deviation of it."""
    if not scale_sd:
        return 0.0
    return abs(figure(lot.scaled(1 + scale_sd)) - figure(lot.scaled(1 - scale_sd))) / 2
