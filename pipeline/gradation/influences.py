"""Figures with the influence of each stone on them, so that two groups of stones can be compared.

The influence of a stone is what it adds to a figure, to first order (the infinitesimal jackknife). Influences add up to
zero, and the sum of their squares is the variance that the figure has from sample to sample.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Values
from pipeline.gradation.curve import Inverse, exact_mm, quantile
from pipeline.gradation.estimators import Property, effective_number, sample_of
from pipeline.gradation.sieves import MeasuredRange
from pipeline.gradation.stones import Lot

PAUSE_S = 300.0
"""A longer time without any stone is a standstill, over which no rate is taken."""
S_A_MINUTE = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Influences:
    """A figure, and by how much each stone moves it, in the order of the stones."""

    value: float
    of_stones: Values
    n_effective: float  # so many equal stones would tell as much
    unseen_variance: float = 0.0  # of a share: left open by rare stones that happened not to fall

    @property
    def variance(self) -> float:
        """Variance of the figure, if stones fall independently of each other."""
        return float(np.sum(self.of_stones**2)) + self.unseen_variance


def share_influences(lot: Lot, property_: Property) -> Influences | None:
    """Return the share by mass of the stones that have a property, percent; None when none counts."""
    chances, volumes = property_(lot.without_errors()), lot.column("volume_mm3")
    weights = volumes * chances.counts
    total = float(weights.sum())
    if not total:
        return None
    share, n_effective = chances.share(volumes), effective_number(weights)
    influences = volumes * chances.scatter(share) / total
    # Agresti and Caffo: as if of two more equal stones one had the property, so that a share of 0 is not certain
    adjusted = (share * n_effective + 1) / (n_effective + 2)
    least_variance = adjusted * (1 - adjusted) / (n_effective + 2)
    return Influences(
        value=100 * share,
        of_stones=100 * influences,
        n_effective=n_effective,
        unseen_variance=100**2 * max(least_variance - float(np.sum(influences**2)), 0.0),
    )


def size_influences(lot: Lot, percent: float, measured: MeasuredRange) -> Influences | None:
    """Return the size that so many percent of the mass pass, mm; None when it is not measured."""
    sample = sample_of(lot)
    found = quantile(sample, percent, Inverse(size_mm=lambda share: exact_mm(sample.lot, share)), measured)
    if found is None or found.size_mm.value is None:
        return None
    influences = np.empty(lot.n_measured)
    influences[lot.order()] = found.size_mm.value * found.log_influence
    return Influences(value=found.size_mm.value, of_stones=influences, n_effective=found.size_mm.n_effective)


def rate_influences(times_s: Values) -> Influences | None:
    """Return the number of stones a minute while the crusher runs, from their times; None without two in a row."""
    gaps_s = np.diff(times_s)
    gaps_s = gaps_s[gaps_s <= PAUSE_S]
    total_s = float(gaps_s.sum())
    if not total_s:
        return None
    rate_hz = len(gaps_s) / total_s
    return Influences(
        value=S_A_MINUTE * rate_hz,
        of_stones=S_A_MINUTE * (1 - rate_hz * gaps_s) / total_s,
        n_effective=float(len(gaps_s)),
    )
