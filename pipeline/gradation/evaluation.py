"""The gradation of a lot: curve, quantiles and indices, each with its uncertainty."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.gradation.estimates import Estimate
from pipeline.gradation.sieves import OF_THE_RIG, MeasuredRange
from pipeline.gradation.stones import Lot, UnmeasuredMass


@dataclass(frozen=True, slots=True, kw_only=True)
class CurvePoint:
    """Passing at one sieve, in percent: by mass and by number of stones."""

    sieve_mm: float
    by_mass: Estimate
    by_number: Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class Indices:
    """Figures of shape and of the whole curve, named by their standards; shares in percent."""

    fineness_modulus: Estimate  # ASTM C136
    uniformity: Estimate  # Cu = D60 / D10, from the quantiles of the stones
    curvature: Estimate  # Cc = D30² / (D10 D60), likewise
    d32_mm: Estimate  # ISO 9276-2, of the sieve size
    d43_mm: Estimate
    flakiness: Estimate  # FI, EN 933-3
    shape: Estimate  # SI, EN 933-4
    needle_flaky: Estimate  # JTG 3432 T 0312
    flat: Mapping[int, Mapping[str, Estimate]]  # D4791 A by ratio, then "mass" or "number"
    elongated: Mapping[int, Mapping[str, Estimate]]  # D4791 A
    flat_and_elongated: Mapping[int, Mapping[str, Estimate]]  # D4791 B


@dataclass(frozen=True, slots=True, kw_only=True)
class Gradation:
    """What a lot is: everything that a report prints of its stones."""

    n_stones: int
    volume_mm3: float
    n_effective: float
    curve: tuple[CurvePoint, ...]  # by rising sieve
    quantiles_interpolated_mm: Mapping[int, Estimate]  # D10...D90 by percent: log-linear between the sieves
    quantiles_exact_mm: Mapping[int, Estimate]  # the same from the stones themselves
    indices: Indices
    unmeasured: UnmeasuredMass
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
) -> Gradation:
    """Return the gradation of a lot at any sieves; equal to the last digit in whatever order its stones were folded.

    `scale_sd` is the relative standard deviation of all lengths, by the calibration (`length_sd_percent` / 100).
    Masses are volumes times one density, which cancels in every percentage.
    """
    raise NotImplementedError
