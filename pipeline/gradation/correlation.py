"""Correlation study: how the sizes of the instrument become those of a laboratory's sieves, checked on unseen lots."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pipeline.arrays import Values
from pipeline.gradation.stones import Lot

STEEP_PERCENT = (5.0, 95.0)
"""Passing between which a curve is steep enough to tell a size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SievedLot:
    """A lot that the instrument measured and a laboratory sieved."""

    lot: Lot
    passing: Mapping[float, float]  # the laboratory's, percent by aperture in mm


@dataclass(frozen=True, slots=True, kw_only=True)
class SizeMapping:
    """A rising mapping from the instrument's size to the sieve's: knots, straight between on logarithmic scales.

    Beyond its ends the ratio of the end stays; so a single knot is one factor for all sizes.
    """

    instrument_mm: tuple[float, ...]
    sieve_mm: tuple[float, ...]
    relative_se: tuple[float | None, ...]  # of each knot's sieve size, from lot to lot; None with one lot

    @property
    def factor(self) -> float:
        """Sieve's size by the instrument's, the mean of the knots."""
        return float(np.exp(np.mean(np.log(self.sieve_mm) - np.log(self.instrument_mm))))

    def __call__(self, sizes_mm: Values) -> Values:
        """Return the sieve sizes."""
        knots = np.log(self.instrument_mm)
        log_ratios = np.log(self.sieve_mm) - knots
        sizes = np.log(sizes_mm)
        between = np.interp(sizes, knots, np.log(self.sieve_mm))
        beyond = sizes + np.interp(sizes, knots, log_ratios)
        return np.exp(np.where((sizes < knots[0]) | (sizes > knots[-1]), beyond, between))


class MappingForm(StrEnum):
    """What the mapping may be."""

    FACTOR = "factor"
    MONOTONE = "monotone"


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A mapping, and by how many points of passing curves miss the laboratory's, over all sieves of all lots."""

    form: MappingForm
    mapping: SizeMapping
    n_lots: int
    n_points: int  # sizes that were matched
    raw_rmse: float  # without a mapping
    raw_bias: float
    rmse: float  # with it, on the lots that it was fitted to
    held_out_rmse: float | None  # each lot by the mapping of the others; None with one lot
    held_out_bias: float | None


def study(lots: Sequence[SievedLot], form: MappingForm) -> Study:
    """Return the mapping that these lots support, judged on lots that it was not fitted to.

    Raises
    ------
    ValueError
        No lot has a sieve that between 5 and 95 % pass.
    """
    points = [_matched(sieved) for sieved in lots]
    fit = _factor if form is MappingForm.FACTOR else _monotone
    mapping = fit(points)
    rest = [[*points[:i], *points[i + 1 :]] for i in range(len(lots))]
    raw = np.concatenate([_misses(sieved, lambda sizes_mm: sizes_mm) for sieved in lots])
    fitted = np.concatenate([_misses(sieved, mapping) for sieved in lots])
    can_hold_out = all(any(len(of) for of in others) for others in rest)
    held_out = (
        np.concatenate([_misses(sieved, fit(others)) for sieved, others in zip(lots, rest, strict=True)])
        if can_hold_out
        else None
    )
    return Study(
        form=form,
        mapping=mapping,
        n_lots=len(lots),
        n_points=sum(map(len, points)),
        raw_rmse=_rms(raw),
        raw_bias=float(raw.mean()),
        rmse=_rms(fitted),
        held_out_rmse=None if held_out is None else _rms(held_out),
        held_out_bias=None if held_out is None else float(held_out.mean()),
    )


def correlated(lot: Lot, mapping: SizeMapping) -> Lot:
    """Return the lot with the sizes that sieves would find; lengths and volumes stay as measured."""
    return lot.with_sizes(mapping(lot.column("sieve_size_mm")))


def _matched(sieved: SievedLot) -> dict[float, float]:
    """Return the instrument's size in mm, by the aperture that the same mass passes."""
    lot = sieved.lot.canonical()
    volumes = lot.column("volume_mm3")
    percents = 100 * (np.cumsum(volumes) - volumes / 2) / volumes.sum()
    log_sizes = np.log(lot.column("sieve_size_mm"))
    low, high = STEEP_PERCENT
    return {
        sieve_mm: float(np.exp(np.interp(percent, percents, log_sizes)))
        for sieve_mm, percent in sieved.passing.items()
        if low <= percent <= high
    }


def _factor(points: Sequence[Mapping[float, float]]) -> SizeMapping:
    log_ratios = [
        float(np.mean([np.log(sieve_mm / size_mm) for sieve_mm, size_mm in of.items()]))
        for of in points
        if of
    ]
    if not log_ratios:
        raise ValueError("no lot has a sieve that between 5 and 95 % pass")
    factor = float(np.exp(np.mean(log_ratios)))
    return SizeMapping(instrument_mm=(1.0,), sieve_mm=(factor,), relative_se=(_standard_error(log_ratios),))


def _monotone(points: Sequence[Mapping[float, float]]) -> SizeMapping:
    """Return a knot for each sieve; one that would lie below a smaller sieve's is left out."""
    knots: list[tuple[float, float, float | None]] = []
    for sieve_mm in sorted({sieve_mm for of in points for sieve_mm in of}):
        logs = [float(np.log(of[sieve_mm])) for of in points if sieve_mm in of]
        size_mm = float(np.exp(np.mean(logs)))
        if not knots or size_mm > knots[-1][0]:
            knots.append((size_mm, sieve_mm, _standard_error(logs)))
    if not knots:
        raise ValueError("no lot has a sieve that between 5 and 95 % pass")
    instrument_mm, sieves_mm, relative_se = zip(*knots, strict=True)
    return SizeMapping(instrument_mm=instrument_mm, sieve_mm=sieves_mm, relative_se=relative_se)


def _standard_error(values: Sequence[float]) -> float | None:
    """Return the standard error of the mean of independent lots; of a single one it is not known."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None


def _misses(sieved: SievedLot, mapping: Callable[[Values], Values]) -> Values:
    """Return by how many points the instrument's curve lies above the laboratory's, sieve by sieve."""
    sizes_mm, volumes = mapping(sieved.lot.column("sieve_size_mm")), sieved.lot.column("volume_mm3")
    return np.array(
        [
            100 * float(volumes[sizes_mm <= sieve_mm].sum() / volumes.sum()) - percent
            for sieve_mm, percent in sieved.passing.items()
        ]
    )


def _rms(values: Values) -> float:
    return float(np.sqrt(np.mean(values**2)))
