"""The curve: percent passing at any sieve, and the sizes that a percentage passes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import log

import numpy as np

from pipeline.arrays import Values
from pipeline.gradation.estimates import NOT_MEASURED, Errors, Estimate
from pipeline.gradation.estimators import Basis, Chances, Property, Sample, chance_up_to, share_percent
from pipeline.gradation.sieves import MeasuredRange
from pipeline.gradation.stones import Lot

PERCENTS = (10, 30, 50, 60, 90)
"""Percentages whose sizes D10...D90 are given, where no others are asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePoint:
    """Passing at one sieve, in percent: by mass and by number of stones."""

    sieve_mm: float
    by_mass: Estimate
    by_number: Estimate


def passes(sieve_mm: float) -> Property:
    """Return the property of passing a sieve: a stone as large as the aperture does."""

    def chances(lot: Lot) -> Chances:
        sizes_mm, sds_mm = lot.column("sieve_size_mm"), lot.column("sieve_size_sd_mm")
        return Chances(np.ones_like(sizes_mm), chance_up_to(sizes_mm, sds_mm, sieve_mm))

    return chances


def curve_of(
    sample: Sample, apertures_mm: Sequence[float], measured: MeasuredRange
) -> tuple[CurvePoint, ...]:
    """Return the passing at each sieve; outside of the measured range there is none."""
    points = []
    for sieve_mm in sorted(set(apertures_mm)):
        by_mass = by_number = NOT_MEASURED
        if sieve_mm in measured:
            by_mass = passing_percent(sample, sieve_mm)
            by_number = share_percent(sample, passes(sieve_mm), Basis.NUMBER)
        points.append(CurvePoint(sieve_mm=sieve_mm, by_mass=by_mass, by_number=by_number))
    return tuple(points)


def passing_percent(sample: Sample, sieve_mm: float) -> Estimate:
    """Return the passing by mass; stones that might have fallen are as large as the sieve, at most as the largest."""
    if not sample.lot.n_measured:
        return NOT_MEASURED
    return share_percent(sample, passes(sieve_mm), unseen_weight=unseen_at(sample, sieve_mm))


def unseen_at(sample: Sample, sieve_mm: float) -> float:
    """Return the volume of a stone that might have fallen, as large as a sieve, at most as the largest, mm³."""
    volumes, sizes_mm = sample.lot.column("volume_mm3"), sample.lot.column("sieve_size_mm")
    unseen_mm = min(sieve_mm, float(sizes_mm.max()))
    return float(np.mean(volumes / sizes_mm**3)) * unseen_mm**3


def influence(lot: Lot, sieve_mm: float) -> Values:
    """Return by how many percent each stone, in the lot's order, has changed the passing of a sieve."""
    volumes = lot.column("volume_mm3")
    has = lot.column("sieve_size_mm") <= sieve_mm
    total, passing = float(volumes.sum()), float(volumes[has].sum())
    others = np.maximum(total - volumes, np.finfo(float).tiny)
    return 100 * (passing / total - (passing - volumes * has) / others)


def retained_to_passing(retained_g: Mapping[float, float], pan_g: float) -> dict[float, float]:
    """Return percent passing by rising aperture, from the grams found on each sieve and in the pan."""
    if min((pan_g, *retained_g.values())) < 0:
        raise ValueError("retained masses must not be negative")
    total_g = pan_g + sum(retained_g.values())
    if not total_g:
        raise ValueError("no mass was retained on any sieve")
    passing, below_g = {}, pan_g
    for sieve_mm in sorted(retained_g):
        passing[sieve_mm] = 100 * below_g / total_g
        below_g += retained_g[sieve_mm]
    return passing


def interpolated_mm(passing: Mapping[float, float], percent: float) -> float | None:
    """Return the size that `percent` pass: log-linear between neighbouring sieves, None beyond the curve's ends."""
    sieves_mm = sorted(passing)
    for low_mm, high_mm in pairwise(sieves_mm):
        low, high = passing[low_mm], passing[high_mm]
        if low < percent <= high or (low == percent and low < high):
            return float(low_mm * (high_mm / low_mm) ** ((percent - low) / (high - low)))
    return None


def exact_mm(lot: Lot, percent: float) -> float | None:
    """Return the size of the stone of a canonical lot with which `percent` of the mass is reached."""
    return (
        value_at(lot.column("sieve_size_mm"), lot.column("volume_mm3"), percent) if lot.n_measured else None
    )


def value_at(values: Values, weights: Values, percent: float) -> float:
    """Return the value of some, one or more, rising ones with which `percent` of their weights is reached."""
    shares = np.cumsum(weights)
    index = np.searchsorted(shares, percent / 100 * shares[-1])
    return float(values[min(int(index), len(shares) - 1)])


@dataclass(frozen=True, slots=True, kw_only=True)
class Inverse:
    """The sizes of a curve by percent, from the lowest to the highest percent that it reaches."""

    size_mm: Callable[[float], float | None]
    low: float = 0.0
    high: float = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeQuantile:
    """A size D_p, with what Cu and Cc need of it: the errors of ln D_p."""

    size_mm: Estimate
    log_influence: Values  # by how much each stone moves ln D_p
    log_errors: Errors


def quantile_estimate(
    share: Estimate, value: float, interval: tuple[float, float], errors: Errors
) -> Estimate:
    """Return the estimate of a quantile from that of the share up to it."""
    return replace(
        share,
        value=value,
        low=min(interval[0], value),
        high=max(interval[1], value),
        standard_error=errors.joined,
        sampling_se=errors.sampling,
        measuring_se=errors.measuring,
        systematic_se=errors.systematic,
    )


def quantile(
    sample: Sample, percent: float, inverse: Inverse, measured: MeasuredRange
) -> SizeQuantile | None:
    """Return the size that `percent` pass; its interval holds the sizes that the interval of its passing reaches to.

    None: the curve does not reach that far, or the size is not measured.
    """
    size_mm = inverse.size_mm(percent) if inverse.low <= percent <= inverse.high else None
    if size_mm is None or size_mm not in measured:
        return None
    passing = passing_percent(sample, size_mm)
    if passing.low is None or passing.high is None:
        return None
    low_mm, high_mm = (
        inverse.size_mm(min(max(end, inverse.low), inverse.high)) or size_mm
        for end in (passing.low, passing.high)
    )
    low_mm, high_mm = min(low_mm, size_mm), max(high_mm, size_mm)
    log_per_percent = log(high_mm / low_mm) / (passing.high - passing.low)
    log_errors = passing.errors.times(log_per_percent)
    has, volumes = passes(size_mm)(sample.lot).has, sample.lot.column("volume_mm3")
    parts = volumes / volumes.sum()
    return SizeQuantile(
        size_mm=quantile_estimate(passing, size_mm, (low_mm, high_mm), log_errors.times(size_mm)),
        log_influence=-100 * log_per_percent * parts * (has - float(parts @ has)),
        log_errors=log_errors,
    )
