"""Vector G3 of the domain notes: 95 % of the intervals hold the truth, by simulation with fixed seeds."""

from dataclasses import dataclass
from functools import partial
from math import log

import numpy as np
import pytest
from scipy.stats import norm
from support.stones import lot_of_sizes

from pipeline.gradation.curve import Inverse, exact_mm, passing_percent, quantile
from pipeline.gradation.estimators import sample_of
from pipeline.gradation.evaluation import evaluate
from pipeline.gradation.sieves import ALL_SIZES
from pipeline.gradation.stones import MEASURES, Lot


@dataclass(frozen=True)
class LogNormal:
    """Sizes of falling stones; by mass, as that is size cubed, they are log-normal too."""

    median_mm: float
    gsd: float
    sieves_mm: tuple[float, ...]

    def sizes_mm(self, n: int, rng: np.random.Generator) -> np.ndarray:
        return np.exp(rng.normal(log(self.median_mm), log(self.gsd), n))

    def passing_percent(self, sieve_mm: float) -> float:
        spread = log(self.gsd)
        return float(100 * norm.cdf((log(sieve_mm / self.median_mm) - 3 * spread**2) / spread))

    def quantile_mm(self, percent: float) -> float:
        spread = log(self.gsd)
        return float(self.median_mm * np.exp(3 * spread**2 + spread * norm.ppf(percent / 100)))


GRADATIONS = {
    "narrow 10/20": LogNormal(13.0, 1.25, (10.0, 12.5, 16.0, 20.0)),
    "wide 4/32": LogNormal(8.0, 1.6, (8.0, 11.2, 16.0, 20.0)),
    "middle 8/16": LogNormal(10.0, 1.35, (8.0, 10.0, 12.5, 16.0)),
}
ERRORS = {"exact": (0.0, 0.0), "as measured": (0.008, 0.025), "far worse": (0.025, 0.05)}
"""Random errors of sieve size and volume, one standard deviation, relative."""


def coverage(name: str, errors: str, n: int, n_lots: int) -> dict[float, float]:
    """Return in how many percent of lots the interval of each sieve holds the true passing."""
    gradation, (size_sd, volume_sd) = GRADATIONS[name], ERRORS[errors]
    rng = np.random.default_rng(20)
    held = dict.fromkeys(gradation.sieves_mm, 0)
    for seed in range(n_lots):
        sizes_mm = gradation.sizes_mm(n, rng)
        lot = lot_of_sizes(sizes_mm, size_sds_mm=size_sd * sizes_mm, volume_sd=volume_sd, seed=seed)
        for sieve_mm in held:
            found = passing_percent(sample_of(lot), sieve_mm)
            assert found.low is not None
            assert found.high is not None
            held[sieve_mm] += found.low <= gradation.passing_percent(sieve_mm) <= found.high
    return {sieve_mm: 100 * n_held / n_lots for sieve_mm, n_held in held.items()}


def test_intervals_hold_the_truth() -> None:
    for name in GRADATIONS:
        for percent in coverage(name, "as measured", 300, 200).values():
            assert 90 <= percent <= 99, "of 200 lots, four standard deviations beside 95"


@pytest.mark.full
@pytest.mark.parametrize("n", [300, 1000])
@pytest.mark.parametrize("errors", ERRORS)
@pytest.mark.parametrize("name", GRADATIONS)
def test_intervals_hold_the_truth_in_95_percent_of_lots(name: str, errors: str, n: int) -> None:
    found = coverage(name, errors, n, 2000)
    assert all(93 <= percent <= 97 for percent in found.values()), found


@pytest.mark.full
@pytest.mark.parametrize("name", GRADATIONS)
def test_intervals_of_quantiles_hold_the_truth(name: str) -> None:
    gradation, n_lots, held = GRADATIONS[name], 1000, dict.fromkeys((10, 50, 60), 0)
    rng = np.random.default_rng(21)
    for _ in range(n_lots):
        sample = sample_of(lot_of_sizes(gradation.sizes_mm(300, rng)))
        inverse = Inverse(size_mm=partial(exact_mm, sample.lot))
        for percent in held:
            found = quantile(sample, percent, inverse, ALL_SIZES)
            assert found is not None
            low_mm, high_mm = found.size_mm.low or 0.0, found.size_mm.high or 0.0
            held[percent] += low_mm <= gradation.quantile_mm(percent) <= high_mm
    assert all(92 <= 100 * n_held / n_lots <= 98 for n_held in held.values()), held


@pytest.mark.full
@pytest.mark.parametrize("name", GRADATIONS)
def test_where_hardly_a_stone_is_retained_intervals_are_rather_too_wide(name: str) -> None:
    gradation, n_lots, held = GRADATIONS[name], 1000, 0
    rng, sieve_mm = np.random.default_rng(22), GRADATIONS[name].quantile_mm(93.0)
    for _ in range(n_lots):
        found = passing_percent(sample_of(lot_of_sizes(gradation.sizes_mm(300, rng))), sieve_mm)
        held += (found.low or 0.0) <= 93.0 <= (found.high or 0.0)
    assert 100 * held / n_lots >= 90, held


def shaped_lot(n: int, sd_mm: float, rng: np.random.Generator) -> Lot:
    """Return stones of which some are flaky and some elongated, as measured with errors of `sd_mm`."""
    sizes_mm = GRADATIONS["narrow 10/20"].sizes_mm(n, rng)
    lot = lot_of_sizes(sizes_mm, size_sds_mm=np.full(n, sd_mm), seed=int(rng.integers(2**31)))
    measures = lot.measures.copy()
    for name, mean, spread in (("min_feret_mm", 0.72, 0.15), ("max_feret_mm", 1.5, 0.35)):
        true_mm = sizes_mm * np.clip(rng.normal(mean, spread, n), 0.3, 3.5)
        measures[MEASURES.index(name)] = true_mm + sd_mm * rng.standard_normal(n)
    return Lot(measures=measures)


@pytest.mark.full
@pytest.mark.parametrize("sd_mm", [0.0, 0.08])
def test_intervals_of_the_shape_indices_hold_the_truth(sd_mm: float) -> None:
    rng, n_lots = np.random.default_rng(23), 600
    truth = evaluate(shaped_lot(300_000, 0.0, rng), ()).indices
    held = {"flakiness_percent": 0, "shape_percent": 0}
    for _ in range(n_lots):
        found = evaluate(shaped_lot(300, sd_mm, rng), ()).indices
        for name in held:
            interval, value = getattr(found, name), getattr(truth, name).value
            held[name] += interval.low <= value <= interval.high
    assert all(92.5 <= 100 * n_held / n_lots <= 97.5 for n_held in held.values()), held
