"""Flat, elongated, and flat and elongated particles (ASTM D4791): of the whole lot, and size by size.

The standard tests each size fraction that holds a tenth of the mass or more, on about a hundred particles of it, by
mass or by number. What it says of the whole sample is the mean over these fractions, weighted by their masses.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Values
from pipeline.gradation.estimates import Estimate, State
from pipeline.gradation.estimators import Basis, Sample, share_percent, weighted_share_percent
from pipeline.gradation.proportions import chance_between, exceeds
from pipeline.gradation.sieves import MeasuredRange
from pipeline.schema import SCHEMA

RATIOS = (2, 3, 4, 5)
MIN_STONES = 100
MIN_MASS_PERCENT = 10.0
"""Share of the mass from which on a size fraction is tested."""


DIMENSIONS = {
    "flat_percent": ("width_mm", "thickness_mm"),
    "elongated_percent": ("length_mm", "width_mm"),
    "flat_and_elongated_percent": ("length_mm", "thickness_mm"),
}
"""Shares of `FlatAndElongated`, each with the two dimensions whose ratio it is judged by."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatAndElongated:
    """ASTM D4791 at one ratio, percent: by mass and by number."""

    __pydantic_config__ = SCHEMA

    ratio: int
    """Ratio of two dimensions that is judged by, such as 3 for 3:1"""
    flat_percent: Mapping[str, Estimate]
    """Method A: width to thickness above the ratio"""
    elongated_percent: Mapping[str, Estimate]
    """Method A: length to width above it"""
    flat_and_elongated_percent: Mapping[str, Estimate]
    """Method B: length to thickness above it"""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatAndElongatedFraction:
    """ASTM D4791 of the particles between two neighbouring sieves of the set, with a tenth of the mass or more."""

    __pydantic_config__ = SCHEMA

    lower_mm: float
    """Sieve that they are retained on, mm"""
    upper_mm: float
    """Sieve that they pass, mm"""
    mass_percent: float
    """Share of the measured mass that they are, %"""
    n_stones: int
    """How many they are; figures of fewer than 100 are `insufficient`"""
    forms: Sequence[FlatAndElongated]
    """At each ratio"""


def _forms(share: Callable[[str, int, Basis], Estimate]) -> tuple[FlatAndElongated, ...]:
    def by_basis(name: str, ratio: int) -> Mapping[str, Estimate]:
        return {str(basis): share(name, ratio, basis) for basis in Basis}

    return tuple(
        FlatAndElongated(ratio=ratio, **{name: by_basis(name, ratio) for name in DIMENSIONS})
        for ratio in RATIOS
    )


def forms_within(sample: Sample, size: MeasuredRange) -> tuple[FlatAndElongated, ...]:
    """Return the shares of all forms at each ratio, of the particles of these sizes."""

    def share(name: str, ratio: int, basis: Basis) -> Estimate:
        return share_percent(sample, exceeds(*DIMENSIONS[name], ratio, [size]), basis, min_stones=MIN_STONES)

    return _forms(share)


def fractions_of(
    sample: Sample, apertures_mm: Sequence[float], measured: MeasuredRange
) -> Iterator[FlatAndElongatedFraction]:
    """Yield the fractions that the standard tests, by rising size, between neighbouring apertures that are measured."""
    volumes_mm3 = sample.lot.column("volume_mm3")
    sieves_mm = sorted({sieve_mm for sieve_mm in apertures_mm if sieve_mm in measured})
    for size in (MeasuredRange(min_mm=low_mm, max_mm=high_mm) for low_mm, high_mm in pairwise(sieves_mm)):
        is_inside = _is_inside(sample, size)
        if not is_inside.any():
            continue
        mass_percent = 100 * float(volumes_mm3[is_inside].sum() / volumes_mm3.sum())
        if mass_percent >= MIN_MASS_PERCENT:
            yield FlatAndElongatedFraction(
                lower_mm=size.min_mm,
                upper_mm=size.max_mm,
                mass_percent=mass_percent,
                n_stones=int(is_inside.sum()),
                forms=forms_within(sample.near(size.min_mm, size.max_mm), size),
            )


def weighted_forms(
    sample: Sample, fractions: Sequence[FlatAndElongatedFraction]
) -> tuple[FlatAndElongated, ...]:
    """Return the mean over the fractions: a share in which each stone stands for a mean stone of its fraction."""
    sizes = [MeasuredRange(min_mm=each.lower_mm, max_mm=each.upper_mm) for each in fractions]
    by_mass = sample.weights(Basis.MASS)
    weights = {Basis.MASS: by_mass, Basis.NUMBER: (_mean_masses(sample, sizes), np.zeros_like(by_mass[0]))}

    spans = _joined(sizes)

    def share(name: str, ratio: int, basis: Basis) -> Estimate:
        mean = weighted_share_percent(sample, exceeds(*DIMENSIONS[name], ratio, spans), *weights[basis])
        at_ratio = (each for fraction in fractions for each in fraction.forms if each.ratio == ratio)
        parts = [getattr(each, name)[basis].state for each in at_ratio]
        return replace(mean, state=State.INSUFFICIENT) if State.INSUFFICIENT in parts else mean

    return _forms(share)


def _joined(sizes: Sequence[MeasuredRange]) -> list[MeasuredRange]:
    """Return rising ranges with those in one that touch, which is less to compute."""
    spans: list[MeasuredRange] = []
    for size in sizes:
        touches = spans and spans[-1].max_mm == size.min_mm
        low_mm = spans.pop().min_mm if touches else size.min_mm
        spans.append(MeasuredRange(min_mm=low_mm, max_mm=size.max_mm))
    return spans


def _mean_masses(sample: Sample, sizes: Sequence[MeasuredRange]) -> Values:
    """Return the mean volume of each stone's fraction; its own where it is in none for certain."""
    volumes_mm3 = sample.lot.column("volume_mm3")
    means_mm3 = volumes_mm3.copy()
    for is_inside in (_is_inside(sample, size) for size in sizes):
        means_mm3[is_inside] = volumes_mm3[is_inside].mean()
    return means_mm3


def _is_inside(sample: Sample, size: MeasuredRange) -> NDArray[np.bool_]:
    """Mark the stones that lie in a fraction, their measures taken for the truth."""
    return chance_between(sample.as_measured, size.min_mm, size.max_mm) > 0
