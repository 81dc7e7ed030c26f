"""Indices of shape and of the whole curve, each by its standard."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from math import exp, hypot, sqrt
from typing import NamedTuple

import numpy as np

from pipeline.arrays import Values
from pipeline.gradation.curve import SizeQuantile
from pipeline.gradation.d4791 import (
    FlatAndElongated,
    FlatAndElongatedFraction,
    forms_within,
    fractions_of,
    weighted_forms,
)
from pipeline.gradation.estimates import (
    NOT_MEASURED,
    Errors,
    Estimate,
    estimate,
    standard_errors_to_either_end,
)
from pipeline.gradation.estimators import (
    Chances,
    Property,
    Sample,
    chance_up_to,
    ratio_of_sums,
    share_percent,
)
from pipeline.gradation.proportions import chance_between, exceeds
from pipeline.gradation.sieves import MeasuredRange
from pipeline.gradation.stones import Lot
from pipeline.schema import SCHEMA


class FlakinessFraction(NamedTuple):
    """Stones between two sieves, and the width of the bars' slot that flaky ones of them pass."""

    low_mm: float
    high_mm: float
    slot_mm: float


EN_933_3 = tuple(
    FlakinessFraction(*fraction)
    for fraction in (
        (4.0, 5.0, 2.5),
        (5.0, 6.3, 3.15),
        (6.3, 8.0, 4.0),
        (8.0, 10.0, 5.0),
        (10.0, 12.5, 6.3),
        (12.5, 16.0, 8.0),
        (16.0, 20.0, 10.0),
        (20.0, 25.0, 12.5),
        (25.0, 31.5, 16.0),
        (31.5, 40.0, 20.0),
        (40.0, 50.0, 25.0),
        (50.0, 63.0, 31.5),
        (63.0, 80.0, 40.0),
        (80.0, 100.0, 50.0),
    )
)
"""Fractions of R 20 with slots of half their upper size, rounded (EN 933-3)."""
SHAPE_RANGE_MM = (4.0, 63.0)
MAX_CUBICAL = 3.0
"""Length by thickness beyond which a stone is non-cubical (EN 933-4), or a needle or a flake (JTG 3432 T 0312)."""
NEEDLE_RANGE_MM = (4.75, np.inf)
MIN_NEEDLE_STONES = 100
FINENESS_SIEVES_MM = (0.15, 0.3, 0.6, 1.18, 2.36, 4.75, 9.5, 19.0, 37.5, 75.0, 150.0)
"""Sieves of the fineness modulus, ASTM C125."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapeIndices:
    """Figures of the whole lot beside its curve."""

    __pydantic_config__ = SCHEMA

    fineness_modulus: Estimate
    """ASTM C136: percent retained on 0.15, 0.3 ... 150 mm, summed, / 100; stones below the measured range count as in
    the middle of its sieves"""
    uniformity: Estimate
    """Cu = D60 / D10, of the exact sizes"""
    curvature: Estimate
    """Cc = D30² / (D10 D60), of the exact sizes"""
    d32_mm: Estimate
    """ISO 9276-2, mean by surface of the sieve size d: sum d³ / sum d²"""
    d43_mm: Estimate
    """ISO 9276-2, mean by volume of the sieve size d: sum d⁴ / sum d³"""
    flakiness_percent: Estimate
    """FI, EN 933-3, 4 to 100 mm: mass with `min_feret_mm` up to the slot of its own fraction"""
    shape_percent: Estimate
    """SI, EN 933-4, 4 to 63 mm: mass with `max_feret_mm` > 3 `min_feret_mm`"""
    needle_flaky_percent: Estimate
    """JTG 3432 T 0312, above 4.75 mm: as SI, of 100 stones at the least"""
    flat_and_elongated: Sequence[FlatAndElongated]
    """ASTM D4791 at each ratio, of all particles together"""
    flat_and_elongated_fractions: Sequence[FlatAndElongatedFraction]
    """ASTM D4791 of each size fraction that holds 10 % of the mass or more, by rising size"""
    flat_and_elongated_weighted: Sequence[FlatAndElongated]
    """ASTM D4791 at each ratio, the mean over these fractions, weighted by their masses; `insufficient` where one of
    them is"""


INDICES = tuple(each.name for each in fields(ShapeIndices) if each.type is Estimate)
"""Those that are one number, each by its standard."""


def indices_of(
    sample: Sample,
    quantiles: Mapping[int, SizeQuantile | None],
    fractions: Sequence[FlakinessFraction],
    apertures_mm: Sequence[float],
    measured: MeasuredRange,
) -> ShapeIndices:
    """Return all indices, over the sizes that are measured and that the standard is for.

    `fractions` are those of the flakiness index; those of ASTM D4791 lie between neighbouring apertures.
    """
    d10, d30, d60 = (quantiles.get(percent) for percent in (10, 30, 60))

    tested = tuple(fractions_of(sample, apertures_mm, measured))
    return ShapeIndices(
        fineness_modulus=ratio_of_sums(sample, _fineness(measured)),
        uniformity=_power_product(((d60, 1), (d10, -1))),
        curvature=_power_product(((d30, 2), (d10, -1), (d60, -1))),
        d32_mm=ratio_of_sums(sample, _moments(3)),
        d43_mm=ratio_of_sums(sample, _moments(4)),
        flakiness_percent=share_percent(sample, is_flaky(measured, fractions)),
        shape_percent=share_percent(sample, is_non_cubical(measured)),
        needle_flaky_percent=share_percent(
            sample, is_non_cubical(measured, NEEDLE_RANGE_MM), min_stones=MIN_NEEDLE_STONES
        ),
        flat_and_elongated=forms_within(sample, measured),
        flat_and_elongated_fractions=tested,
        flat_and_elongated_weighted=weighted_forms(sample, tested),
    )


def fineness_modulus(passing: Mapping[float, float]) -> float:
    """Return the fineness modulus of a whole curve, percent passing by aperture; nothing passes sieves below it.

    Raises
    ------
    ValueError
        The curve lacks a sieve of the modulus between its own.
    """
    low_mm, high_mm = min(passing), max(passing)
    ends = {sieve_mm: 100.0 * (sieve_mm > high_mm) for sieve_mm in FINENESS_SIEVES_MM}
    missing = [mm for mm in FINENESS_SIEVES_MM if low_mm < mm < high_mm and mm not in passing]
    if missing:
        raise ValueError(f"the fineness modulus needs the sieves {', '.join(f'{mm:g}' for mm in missing)} mm")
    return sum(100 - passing.get(sieve_mm, ends[sieve_mm]) for sieve_mm in FINENESS_SIEVES_MM) / 100


def is_non_cubical(measured: MeasuredRange, sizes_mm: tuple[float, float] = SHAPE_RANGE_MM) -> Property:
    """Return the property of being longer than `MAX_CUBICAL` times the thickness, of the shape index EN 933-4."""
    return exceeds("max_feret_mm", "min_feret_mm", MAX_CUBICAL, [measured.within(*sizes_mm)])


def is_flaky(measured: MeasuredRange, fractions: Sequence[FlakinessFraction] = EN_933_3) -> Property:
    """Return the property of passing the slot of its own fraction, of the flakiness index EN 933-3."""
    whole = [of for of in fractions if of.low_mm in measured and of.high_mm in measured]

    def chances(lot: Lot) -> Chances:
        counts, has = np.zeros(lot.n_measured), np.zeros(lot.n_measured)
        for low_mm, high_mm, slot_mm in whole:
            inside = chance_between(lot, low_mm, high_mm)
            counts += inside
            has += inside * chance_up_to(lot.column("min_feret_mm"), lot.column("feret_sd_mm"), slot_mm)
        return Chances(counts, has)

    return chances


def _moments(power: int) -> Callable[[Lot], tuple[Values, Values]]:
    def terms(lot: Lot) -> tuple[Values, Values]:
        sizes_mm = lot.column("sieve_size_mm")
        return sizes_mm**power, sizes_mm ** (power - 1)

    return terms


def _fineness(measured: MeasuredRange) -> Callable[[Lot], tuple[Values, Values]]:
    """Return the terms of the fineness modulus: on how many of its sieves each stone has been retained.

    Of stones below the measured range it is not known; they are taken to lie in the middle of its sieves.
    """
    sieves_mm = np.array(FINENESS_SIEVES_MM)
    unknown = float(np.sum(sieves_mm < measured.min_mm)) / 2

    def terms(lot: Lot) -> tuple[Values, Values]:
        sizes_mm, volumes = lot.column("sieve_size_mm"), lot.column("volume_mm3")
        retained = np.where(
            sizes_mm > measured.min_mm, np.searchsorted(sieves_mm, sizes_mm).astype(float), unknown
        )
        return volumes * retained, volumes

    return terms


def _power_product(factors: tuple[tuple[SizeQuantile | None, int], ...]) -> Estimate:
    """Return a product of powers of quantiles; as its stones are the same, what moves one may move the others."""
    if any(quantile is None for quantile, _ in factors):
        return NOT_MEASURED
    known = [(quantile, power) for quantile, power in factors if quantile is not None]
    value = float(np.prod([(quantile.size_mm.value or 0.0) ** power for quantile, power in known]))
    influence = sum(power * quantile.log_influence for quantile, power in known)
    log_errors = Errors(
        sampling=sqrt(float(np.sum(np.square(influence)))),
        measuring=hypot(*(power * quantile.log_errors.measuring for quantile, power in known)),
        systematic=0.0,  # a scale that is common to all stones cancels
    )
    of = known[0][0].size_mm
    reach = exp(standard_errors_to_either_end(of.n_effective - 1) * log_errors.joined)
    return estimate(
        value, (value / reach, value * reach), log_errors.times(value), of.n_stones, of.n_effective
    )
