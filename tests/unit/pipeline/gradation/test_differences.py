"""Whether two groups of stones differ: false alarms and power by simulation, lots and versions, Holm."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import ttest_ind
from support.extents import first_quick
from support.stones import lot_with

from pipeline.arrays import Values
from pipeline.gradation.differences import (
    difference_in_time,
    difference_of_lots,
    difference_of_versions,
    significant,
)
from pipeline.gradation.evaluation import evaluate
from pipeline.gradation.indices import is_flaky, is_non_cubical
from pipeline.gradation.influences import (
    Influences,
    rate_influences,
    share_influences,
    size_influences,
)
from pipeline.gradation.sieves import OF_THE_RIG
from pipeline.gradation.stones import Lot

LONG_SHARE = 0.18


def falling(
    rng: np.random.Generator, n: int, long_share: float = LONG_SHARE, alike_over: float = 0.0
) -> tuple[Lot, Values]:
    """Return stones and the times at which they fell; neighbours are alike over so many stones (0: not at all)."""
    level = np.zeros(n)
    if alike_over:
        memory = np.exp(-1 / alike_over)
        level = lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.normal(size=n))
    sizes_mm = np.exp(rng.normal(np.log(11), 0.25, n) + 0.03 * level)
    is_long = rng.random(n) < np.clip(long_share + 0.03 * level, 0, 1)
    lot = lot_with(
        sizes_mm,
        max_feret_mm=sizes_mm * np.where(is_long, rng.uniform(1.9, 2.3, n), rng.uniform(1.2, 1.5, n)),
        min_feret_mm=sizes_mm * np.where(is_long, rng.uniform(0.5, 0.6, n), rng.uniform(0.6, 0.9, n)),
        volume_mm3=0.5 * sizes_mm**3 * np.exp(rng.normal(0, 0.2, n)),
        sieve_size_sd_mm=0.03,
        feret_sd_mm=0.03,
        volume_sd=0.01,
    )
    times_s = np.cumsum(rng.exponential(0.25, n) * np.exp(0.2 * level))
    return lot, times_s


def figures(stones: tuple[Lot, Values]) -> dict[str, Influences]:
    """Return the four figures that the diary is looked at with."""
    lot, times_s = stones
    found = {
        "d50": size_influences(lot, 50, OF_THE_RIG),
        "flakiness": share_influences(lot, is_flaky(OF_THE_RIG)),
        "shape": share_influences(lot, is_non_cubical(OF_THE_RIG)),
        "rate": rate_influences(times_s),
    }
    assert None not in found.values()
    return {name: each for name, each in found.items() if each is not None}


def found_changes(
    n_cases: int, least: int, most: int, after_share: float = LONG_SHARE, alike_over: float = 0.0
) -> list[set[str]]:
    """Return what is called significant, case by case, of groups of `least` to `most` stones."""
    cases = []
    for seed in range(n_cases):
        rng = np.random.default_rng(seed)
        n_before, n_after = rng.integers(least, most, 2)
        before = figures(falling(rng, int(n_before), alike_over=alike_over))
        after = figures(falling(rng, int(n_after), after_share, alike_over))
        differences = {name: difference_in_time(before[name], after[name]) for name in before}
        cases.append(significant({name: each.p_value for name, each in differences.items()}))
    return cases


@pytest.mark.parametrize(("n_cases", "alike_over"), first_quick([(150, 30.0), (150, 0.0)]))
def test_without_a_change_at_most_one_case_in_twenty_is_significant(n_cases: int, alike_over: float) -> None:
    alarms = sum(map(bool, found_changes(n_cases, 500, 4000, alike_over=alike_over)))
    assert alarms <= 0.05 * n_cases


@pytest.mark.full
@pytest.mark.parametrize("alike_over", [0.0, 30.0])
def test_false_alarms_of_many_cases(alike_over: float) -> None:
    cases = found_changes(1000, 300, 6000, alike_over=alike_over)
    assert sum(map(bool, cases)) <= 0.05 * len(cases)


def test_a_change_of_four_points_is_found_and_named() -> None:
    """Half an hour of four stones a second on either side."""
    cases = found_changes(40, 6000, 8000, LONG_SHARE + 0.044)
    assert sum("shape" in case for case in cases) >= 0.8 * len(cases)
    assert sum("rate" in case or "d50" in case for case in cases) <= 0.1 * len(cases)


def test_the_figures_are_those_of_the_report() -> None:
    lot, times_s = falling(np.random.default_rng(5), 800)
    found, report = figures((lot, times_s)), evaluate(lot, [8.0])
    assert found["d50"].value == report.quantiles_exact_mm[50].value
    assert found["shape"].value == pytest.approx(report.indices.shape_percent.value)
    assert found["flakiness"].value == pytest.approx(report.indices.flakiness_percent.value)
    for name, figure in {
        "shape": report.indices.shape_percent,
        "flakiness": report.indices.flakiness_percent,
    }.items():
        assert found[name].variance ** 0.5 == pytest.approx(figure.standard_error, rel=0.1)
    for each in found.values():
        assert each.of_stones.sum() == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("figure", [lambda lot: share_influences(lot, is_non_cubical(OF_THE_RIG))])
def test_influences_are_what_a_stone_adds(figure: Callable[[Lot], Influences | None]) -> None:
    lot, _ = falling(np.random.default_rng(6), 400)
    whole = figure(lot)
    assert whole is not None
    for place in (0, 17, 399):
        others = figure(lot.where(np.arange(400) != place))
        assert others is not None
        assert whole.value - others.value == pytest.approx(whole.of_stones[place], rel=0.05)


def test_equal_stones_are_compared_as_by_welch() -> None:
    rng = np.random.default_rng(7)
    first, second = rng.normal(10, 1, 200), rng.normal(10.2, 2, 300)
    lots = [
        Influences(value=each.mean(), of_stones=(each - each.mean()) / len(each), n_effective=len(each))
        for each in (first, second)
    ]
    found, expected = difference_of_lots(*lots), ttest_ind(second, first, equal_var=False)
    assert found.p_value == pytest.approx(expected.pvalue, rel=0.05)
    interval = expected.confidence_interval()
    assert (found.low, found.high) == pytest.approx((interval.low, interval.high), abs=0.01)


def test_a_rate_is_of_the_time_that_the_crusher_runs() -> None:
    times_s = np.concatenate([np.arange(0, 600, 0.5), 40_000 + np.arange(0, 600, 0.5)])
    rate = rate_influences(times_s)
    assert rate is not None
    assert rate.value == pytest.approx(120)
    assert rate_influences(np.array([0.0, 1000.0])) is None
    assert rate_influences(np.array([])) is None


def test_versions_of_one_lot_are_compared_stone_by_stone() -> None:
    lot, _ = falling(np.random.default_rng(8), 500)
    ids = [f"s{number}" for number in range(500)]
    first = size_influences(lot, 50, OF_THE_RIG)
    second = size_influences(lot.scaled(1.002), 50, OF_THE_RIG)
    assert first is not None
    assert second is not None
    paired = difference_of_versions(first, second, ids, ids)
    assert paired.value == pytest.approx(0.002 * first.value)
    assert paired.p_value < 0.01 < difference_of_lots(first, second).p_value
    same = difference_of_versions(first, first, ids, ids)
    assert (same.value, same.low, same.high, same.p_value) == (0, 0, 0, 1)
    shuffled = [str(number) for number in range(500)]  # no stone in common: two lots
    apart = difference_of_versions(first, second, ids, shuffled)
    assert apart.standard_error == pytest.approx(difference_of_lots(first, second).standard_error)


def test_no_flaky_stone_among_few_is_not_certain_to_be_none() -> None:
    lot, _ = falling(np.random.default_rng(9), 60, long_share=0.0)
    none = share_influences(lot, is_non_cubical(OF_THE_RIG))
    assert none is not None
    assert none.value == 0
    assert none.variance**0.5 > 1  # of 60 stones, percent


def test_holm_stops_at_the_first_that_is_not() -> None:
    assert significant({"a": 0.001, "b": 0.016, "c": 0.03, "d": 0.9}) == {"a", "b"}
    assert significant({"a": 0.02, "b": 0.02, "c": 0.02}) == set()
    assert significant({}) == set()
