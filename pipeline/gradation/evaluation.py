"""The gradation of a lot: curve, quantiles and indices, each with its uncertainty."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from pipeline.gradation.budget import UncertaintyBudget, budgets_of
from pipeline.gradation.curve import (
    PERCENTS,
    CurvePoint,
    Inverse,
    SizeQuantile,
    curve_of,
    exact_mm,
    interpolated_mm,
    quantile,
)
from pipeline.gradation.estimates import NOT_MEASURED, Estimate
from pipeline.gradation.estimators import effective_number, sample_of
from pipeline.gradation.indices import (
    EN_933_3,
    GRAPHIC_PERCENTS,
    FlakinessFraction,
    ShapeIndices,
    indices_of,
)
from pipeline.gradation.sieves import OF_THE_RIG, MeasuredRange
from pipeline.gradation.stones import Lot, Unmeasured, unmeasured_mass


@dataclass(frozen=True, slots=True, kw_only=True)
class Gradation:
    """Gradation of a lot: all figures of its stones that a report prints."""

    n_stones: int
    volume_mm3: float
    n_effective: float
    curve: tuple[CurvePoint, ...]  # by rising sieve
    quantiles_interpolated_mm: Mapping[float, Estimate]  # D10...D90 by percent: log-linear between the sieves
    quantiles_exact_mm: Mapping[float, Estimate]  # the same from the stones themselves
    indices: ShapeIndices
    budgets: Sequence[UncertaintyBudget]
    unmeasured: Unmeasured
    measured: MeasuredRange
    scale_sd: float

    def passing(self, sieve_mm: float) -> Estimate:
        """Return the passing by mass at a sieve of the curve."""
        return next(point.by_mass for point in self.curve if point.sieve_mm == sieve_mm)


def evaluate(
    lot: Lot,
    apertures_mm: Sequence[float],
    *,
    measured: MeasuredRange = OF_THE_RIG,
    scale_sd: float = 0.0,
    fractions: Sequence[FlakinessFraction] = EN_933_3,
    percents: Collection[float] = PERCENTS,
) -> Gradation:
    """Return the gradation of a lot at any sieves; equal to the last digit for any order of its stones.

    `scale_sd` is the relative standard deviation of all lengths, by the calibration (`length_sd_percent` / 100).
    `fractions` are those of the flakiness index, `percents`, each above 0 and below 100, those of the sizes D_p. Masses
    are volumes times one density, which cancels in percentages.
    """
    sample = sample_of(lot, scale_sd)
    lot = sample.lot
    curve = curve_of(sample, apertures_mm, measured)
    passing = {point.sieve_mm: point.by_mass.value for point in curve if point.by_mass.value is not None}

    def quantiles(inverse: Inverse, percents: Collection[float]) -> dict[float, SizeQuantile | None]:
        return {percent: quantile(sample, percent, inverse, measured) for percent in percents}

    from_stones = Inverse(size_mm=lambda percent: exact_mm(lot, percent))
    exact = quantiles(from_stones, {*percents, *PERCENTS, *GRAPHIC_PERCENTS})
    interpolated = quantiles(
        Inverse(
            size_mm=lambda percent: interpolated_mm(passing, percent),
            low=min(passing.values(), default=100.0),
            high=max(passing.values(), default=0.0),
        ),
        percents,
    )
    volumes_mm3 = lot.column("volume_mm3")
    return Gradation(
        n_stones=lot.n_measured,
        volume_mm3=float(volumes_mm3.sum()),
        n_effective=effective_number(volumes_mm3),
        curve=curve,
        quantiles_interpolated_mm=_sizes(interpolated, percents),
        quantiles_exact_mm=_sizes(exact, percents),
        indices=indices_of(sample, exact, fractions, apertures_mm, measured),
        budgets=tuple(budgets_of(sample, exact[50], fractions, measured)),
        unmeasured=unmeasured_mass(lot, measured.max_mm),
        measured=measured,
        scale_sd=scale_sd,
    )


def _sizes(
    quantiles: Mapping[float, SizeQuantile | None], percents: Collection[float]
) -> dict[float, Estimate]:
    found = {percent: quantiles[percent] for percent in sorted(percents)}
    return {percent: NOT_MEASURED if of is None else of.size_mm for percent, of in found.items()}
