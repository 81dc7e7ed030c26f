"""Indices of shape and of the whole curve, each by its standard."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from math import exp, hypot, log, sqrt
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


GRAPHIC_PERCENTS = (5, 16, 25, 50, 75, 84, 95)
"""Percent of the mass that is coarser than each φ of Folk and Ward: 100 less the percent that passes."""
LOG_STEP = 1e-6
"""Step of the logarithm of a size over which slopes are taken."""


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
    graphic_mean_phi: Estimate
    """Folk and Ward (1957): Mz = (φ16 + φ50 + φ84) / 3, of the exact sizes; φ = -log2 of the size in mm, counted from
    the coarse end, as GRADISTAT prints them (Blott and Pye 2001)"""
    graphic_sorting_phi: Estimate
    """Folk and Ward: (φ84 - φ16) / 4 + (φ95 - φ5) / 6.6"""
    graphic_skewness: Estimate
    """Folk and Ward: (φ16 + φ84 - 2 φ50) / 2 (φ84 - φ16) + (φ5 + φ95 - 2 φ50) / 2 (φ95 - φ5); above 0: a fine tail"""
    graphic_kurtosis: Estimate
    """Folk and Ward: (φ95 - φ5) / 2.44 (φ75 - φ25); 1 of a lognormal gradation"""
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
    quantiles: Mapping[float, SizeQuantile | None],
    fractions: Sequence[FlakinessFraction],
    apertures_mm: Sequence[float],
    measured: MeasuredRange,
) -> ShapeIndices:
    """Return all indices, over the sizes that are measured and that the standard is for.

    `fractions` are those of the flakiness index; those of ASTM D4791 lie between neighbouring apertures.
    """
    d10, d30, d60 = (quantiles.get(percent) for percent in (10, 30, 60))
    graphic = [
        _of_sizes(figure, [quantiles.get(100 - percent) for percent in GRAPHIC_PERCENTS])
        for figure in (_graphic_mean, _graphic_sorting, _graphic_skewness, _graphic_kurtosis)
    ]
    tested = tuple(fractions_of(sample, apertures_mm, measured))
    return ShapeIndices(
        fineness_modulus=ratio_of_sums(sample, _fineness(measured)),
        uniformity=_power_product(((d60, 1), (d10, -1))),
        curvature=_power_product(((d30, 2), (d10, -1), (d60, -1))),
        graphic_mean_phi=graphic[0],
        graphic_sorting_phi=graphic[1],
        graphic_skewness=graphic[2],
        graphic_kurtosis=graphic[3],
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


def _power_product(factors: Sequence[tuple[SizeQuantile | None, int]]) -> Estimate:
    """Return a product of powers of quantiles, whose interval is symmetric on a logarithmic scale."""
    powers = np.array([power for _, power in factors])
    found = _of_sizes(lambda logs: float(powers @ logs), [quantile for quantile, _ in factors])
    if found.value is None or found.low is None or found.high is None:
        return NOT_MEASURED
    value, interval = exp(found.value), (exp(found.low), exp(found.high))
    return estimate(value, interval, found.errors.times(value), found.n_stones, found.n_effective)


def _of_sizes(figure: Callable[[Values], float], sizes: Sequence[SizeQuantile | None]) -> Estimate:
    """Return a figure of the logarithms of sizes D_p; as their stones are the same, what moves one may move others."""
    known = [size for size in sizes if size is not None]
    logs = np.log([size.size_mm.value or np.nan for size in known])
    if len(known) < len(sizes):
        return NOT_MEASURED
    with np.errstate(divide="ignore", invalid="ignore"):  # of stones of one size
        value = figure(logs)
        slopes = np.array(
            [figure(logs + step) - figure(logs - step) for step in LOG_STEP * np.eye(len(logs))]
        )
    slopes /= 2 * LOG_STEP
    if not np.isfinite([value, *slopes]).all():
        return NOT_MEASURED
    influence = sum(slope * size.log_influence for slope, size in zip(slopes, known, strict=True))
    scale_sd = float(np.mean([size.log_errors.systematic for size in known]))
    errors = Errors(
        sampling=sqrt(float(np.sum(np.square(influence)))),
        measuring=hypot(*(slopes * [size.log_errors.measuring for size in known])),
        systematic=abs(float(slopes.sum()))
        * scale_sd,  # a scale that is common to all stones cancels in ratios
    )
    of = known[0].size_mm
    half = standard_errors_to_either_end(of.n_effective - 1) * errors.joined
    return estimate(value, (value - half, value + half), errors, of.n_stones, of.n_effective)


def _graphic_mean(logs: Values) -> float:
    return float(_phi(logs)[[1, 3, 5]].mean())


def _graphic_sorting(logs: Values) -> float:
    phi5, phi16, _, _, _, phi84, phi95 = _phi(logs)
    return float((phi84 - phi16) / 4 + (phi95 - phi5) / 6.6)


def _graphic_skewness(logs: Values) -> float:
    phi5, phi16, _, phi50, _, phi84, phi95 = _phi(logs)
    inner = (phi16 + phi84 - 2 * phi50) / (2 * (phi84 - phi16))
    return float(inner + (phi5 + phi95 - 2 * phi50) / (2 * (phi95 - phi5)))


def _graphic_kurtosis(logs: Values) -> float:
    phi5, _, phi25, _, phi75, _, phi95 = _phi(logs)
    return float((phi95 - phi5) / (2.44 * (phi75 - phi25)))


def _phi(logs: Values) -> Values:
    """Return Krumbein's φ of natural logarithms of sizes in mm."""
    return -logs / log(2)
