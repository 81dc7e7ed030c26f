"""Budgets of uncertainty: what they are made of adds up to what the intervals rest on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.stones import lot_with

from pipeline.gradation.budget import UncertaintyBudget
from pipeline.gradation.evaluation import Gradation, evaluate
from pipeline.gradation.stones import Lot


def crushed(n: int, seed: int = 1, *, sd_mm: float = 0.1, flaky: float = 0.3) -> Lot:
    """Return stones of a crusher about 11 mm, some of them flaky, some long."""
    rng = np.random.default_rng(seed)
    sizes_mm = np.exp(rng.normal(np.log(11), 0.2, n))
    thin = np.where(rng.random(n) < flaky, 0.4, 0.8)
    long = np.where(rng.random(n) < flaky, 3.5, 1.5)
    return lot_with(
        sizes_mm,
        volume_mm3=0.5 * sizes_mm**3,
        min_feret_mm=thin * sizes_mm,
        max_feret_mm=long * thin * sizes_mm,
        volume_sd=0.02,
        sieve_size_sd_mm=sd_mm,
        feret_sd_mm=sd_mm,
    )


def budgets(found: Gradation) -> dict[str, UncertaintyBudget]:
    return {each.figure: each for each in found.budgets}


@given(st.integers(200, 500), st.integers(0, 50), st.sampled_from((0.0, 0.001)))
def test_causes_add_up_to_what_the_interval_rests_on(n: int, seed: int, scale_sd: float) -> None:
    found = evaluate(crushed(n, seed), (), scale_sd=scale_sd)
    figures = {
        "d50_mm": found.quantiles_exact_mm[50],
        "flakiness_percent": found.indices.flakiness_percent,
        "shape_percent": found.indices.shape_percent,
    }
    assert list(budgets(found)) == list(figures)
    for name, each in budgets(found).items():
        figure = figures[name]
        assert figure.low is not None and figure.high is not None
        squares = each.sampling**2 + each.instrument**2 + each.scale**2
        assert each.combined**2 == pytest.approx(squares)
        half = (figure.high - figure.low) / 2
        assert each.interval_factor * each.combined == pytest.approx(half), name
        assert each.value == pytest.approx(figure.value)
        assert each.expanded == each.coverage_factor * each.combined == 2 * each.combined
    assert (budgets(found)["d50_mm"].scale > 0) == (scale_sd > 0)


def test_of_equal_stones_it_is_that_of_the_textbook() -> None:
    """Share p of n equal stones without errors: the standard error is sqrt(p (1 - p) / n) of about n + 4 stones."""
    n, p = 1000, 0.2
    sizes_mm = np.full(n, 11.0)
    thin = np.where(np.arange(n) < p * n, 0.4, 0.8)
    found = budgets(evaluate(lot_with(sizes_mm, volume_mm3=700.0, min_feret_mm=thin * 11), ()))
    each = found["flakiness_percent"]
    assert each.value == pytest.approx(20)
    assert each.combined == pytest.approx(100 * np.sqrt(p * (1 - p) / n), rel=0.01)
    assert (each.instrument, each.scale) == (0, 0)
    assert found["d50_mm"].combined == 0, "stones of one size"


def test_no_flaky_stone_among_a_hundred_is_not_a_flakiness_without_doubt() -> None:
    each = budgets(evaluate(crushed(100, flaky=0.0, sd_mm=0.0), ()))["flakiness_percent"]
    assert each.value == 0
    assert 0.5 < each.combined < 3
    assert each.instrument == pytest.approx(0, abs=0.05)


def test_sixteen_times_the_stones_quarter_the_sampling_and_leave_the_scale() -> None:
    few, many = (budgets(evaluate(crushed(n), (), scale_sd=0.001))["d50_mm"] for n in (1000, 16_000))
    assert few.sampling / many.sampling == pytest.approx(4, rel=0.2)
    assert few.scale == pytest.approx(many.scale, rel=0.3)
    assert many.scale == pytest.approx(0.001 * many.value, rel=0.3), "a size is as wrong as the scale"


def test_few_stones_have_a_wider_interval_than_k_says() -> None:
    few, many = (budgets(evaluate(crushed(n), ()))["d50_mm"].interval_factor for n in (10, 5000))
    assert few > 2.2
    assert many == pytest.approx(1.96, abs=0.01)


def test_without_stones_there_is_none() -> None:
    assert evaluate(Lot(), ()).budgets == ()
