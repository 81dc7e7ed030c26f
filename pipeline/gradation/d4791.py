"""Flat, elongated, and flat and elongated particles (ASTM D4791): of the whole lot, and size by size.

The standard tests each size fraction that holds a tenth of the mass or more, on about a hundred particles of it, by
mass or by number. What it says of the whole sample is the mean over these fractions, weighted by their masses.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Values
from pipeline.gradation.estimates import Estimate, State
from pipeline.gradation.estimators import Basis, Sample, share_percent, weighted_share_percent
from pipeline.gradation.proportions import chance_between, exceeds
from pipeline.gradation.sieves import MeasuredRange

RATIOS = (2, 3, 4, 5)
MIN_STONES = 100
MIN_MASS_PERCENT = 10.0
"""Share of the mass from which on a size fraction is tested."""


class ParticleForm(StrEnum):
    """Form of a particle by two of its dimensions."""

    FLAT = "flat"
    """Width to thickness, method A."""
    ELONGATED = "elongated"
    """Length to width, method A."""
    FLAT_AND_ELONGATED = "flat_and_elongated"
    """Length to thickness, method B."""


DIMENSIONS = {
    ParticleForm.FLAT: ("width_mm", "thickness_mm"),
    ParticleForm.ELONGATED: ("length_mm", "width_mm"),
    ParticleForm.FLAT_AND_ELONGATED: ("length_mm", "thickness_mm"),
}

Shares = Mapping[ParticleForm, Mapping[int, Mapping[Basis, Estimate]]]
"""Percent of the particles that have a form, by the ratio that is exceeded, by mass and by number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FormFraction:
    """The particles between two neighbouring sieves."""

    size: MeasuredRange
    mass_percent: float  # of the measured mass
    n_stones: int
    shares: Shares


@dataclass(frozen=True, slots=True, kw_only=True)
class D4791:
    """Shape of a lot by ASTM D4791."""

    whole: Shares  # of all measured particles together
    fractions: tuple[FormFraction, ...]  # by rising size, those that the standard tests
    weighted: Shares  # the mean over these, weighted by their masses


def d4791_of(sample: Sample, apertures_mm: Sequence[float], measured: MeasuredRange) -> D4791:
    """Return the shares of all forms; size fractions lie between neighbouring apertures that are measured."""
    fractions = tuple(_fractions(sample, apertures_mm, measured))
    return D4791(
        whole=_shares_within(sample, measured), fractions=fractions, weighted=_weighted(sample, fractions)
    )


def _shares(share: Callable[[ParticleForm, int, Basis], Estimate]) -> Shares:
    return {
        form: {ratio: {basis: share(form, ratio, basis) for basis in Basis} for ratio in RATIOS}
        for form in ParticleForm
    }


def _shares_within(sample: Sample, size: MeasuredRange) -> Shares:
    def share(form: ParticleForm, ratio: int, basis: Basis) -> Estimate:
        return share_percent(sample, exceeds(*DIMENSIONS[form], ratio, [size]), basis, min_stones=MIN_STONES)

    return _shares(share)


def _fractions(
    sample: Sample, apertures_mm: Sequence[float], measured: MeasuredRange
) -> Iterator[FormFraction]:
    volumes_mm3 = sample.lot.column("volume_mm3")
    sieves_mm = sorted({sieve_mm for sieve_mm in apertures_mm if sieve_mm in measured})
    for size in (MeasuredRange(min_mm=low_mm, max_mm=high_mm) for low_mm, high_mm in pairwise(sieves_mm)):
        is_inside = _is_inside(sample, size)
        if not is_inside.any():
            continue
        mass_percent = 100 * float(volumes_mm3[is_inside].sum() / volumes_mm3.sum())
        if mass_percent >= MIN_MASS_PERCENT:
            yield FormFraction(
                size=size,
                mass_percent=mass_percent,
                n_stones=int(is_inside.sum()),
                shares=_shares_within(sample.near(size.min_mm, size.max_mm), size),
            )


def _weighted(sample: Sample, fractions: Sequence[FormFraction]) -> Shares:
    """Return the mean over the fractions: a share in which each stone stands for a mean stone of its fraction."""
    sizes = [fraction.size for fraction in fractions]
    by_mass = sample.weights(Basis.MASS)
    weights = {Basis.MASS: by_mass, Basis.NUMBER: (_mean_masses(sample, sizes), np.zeros_like(by_mass[0]))}

    spans = _joined(sizes)

    def share(form: ParticleForm, ratio: int, basis: Basis) -> Estimate:
        mean = weighted_share_percent(sample, exceeds(*DIMENSIONS[form], ratio, spans), *weights[basis])
        parts = [fraction.shares[form][ratio][basis].state for fraction in fractions]
        return replace(mean, state=State.INSUFFICIENT) if State.INSUFFICIENT in parts else mean

    return _shares(share)


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
