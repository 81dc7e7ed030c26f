"""Distributions of shape: closed forms, and what must hold for the stones of any lot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.stones import lot_with, round_stone

from pipeline.arrays import Values
from pipeline.gradation.distributions import EDGES, Distribution, distribution_of
from pipeline.gradation.estimates import State
from pipeline.gradation.estimators import sample_of
from pipeline.gradation.stones import OPTIONAL, UNKNOWN, lot_of

KNOWN = st.floats(0, 1.2, allow_subnormal=False)
STONES = st.lists(st.tuples(st.one_of(KNOWN, KNOWN, st.just(UNKNOWN)), st.floats(1, 1e4)), max_size=40)


def of(values: Values, volumes_mm3: Values | float = 100.0, measure: str = "sphericity") -> Distribution:
    lot = lot_with(np.linspace(8, 16, len(values)), volume_mm3=volumes_mm3, **{measure: values})
    return distribution_of(sample_of(lot, 0.001), measure)


def quantiles(found: Distribution) -> list[float | None]:
    return [each.value.value for each in found.quantiles]


def test_every_measure_of_shape_that_a_stone_has_is_distributed() -> None:
    assert set(EDGES) == set(OPTIONAL)


def test_of_even_values_and_equal_masses() -> None:
    n = 4000
    found = of((np.arange(n) + 0.5) / n)
    assert quantiles(found) == pytest.approx([0.1, 0.5, 0.9], abs=1 / n)
    assert found.mean.value == pytest.approx(0.5)
    assert found.mean.sampling_se == pytest.approx(np.sqrt(1 / 12 / n), rel=0.01)
    shares = [each.mass_percent for each in found.classes]
    assert shares == pytest.approx([5.0] * 20)
    assert shares == pytest.approx([each.number_percent for each in found.classes])
    median = found.quantiles[1].value
    assert (median.low, median.high) == pytest.approx(
        (0.5 - 0.98 / np.sqrt(n), 0.5 + 0.98 / np.sqrt(n)), abs=1e-3
    )
    assert median.systematic_se == 0, "a larger scale changes no ratio"
    assert (found.n_stones, found.n_unmeasured) == (n, 0)


def test_it_is_weighted_by_mass() -> None:
    found = of(np.array([0.61, 0.72, 0.83, UNKNOWN]), np.array([5.0, 4.0, 1.0, 90.0]))
    classes = [(each.lower, each.upper, each.mass_percent, each.number_percent) for each in found.classes]
    one_in_three = pytest.approx(100 / 3)
    assert [each for each in classes if each[2]] == [
        (0.6, 0.65, pytest.approx(50), one_in_three),
        (0.7, 0.75, pytest.approx(40), one_in_three),
        (0.8, 0.85, pytest.approx(10), one_in_three),
    ]
    assert len(classes) == 5, "from the first to the last that has stones"
    assert quantiles(found) == [0.61, 0.61, 0.72]
    assert found.mean.value == pytest.approx(0.5 * 0.61 + 0.4 * 0.72 + 0.1 * 0.83)
    assert (found.n_stones, found.n_unmeasured) == (3, 1)
    assert found.quantiles[1].value.state is State.INSUFFICIENT


def test_of_identical_stones() -> None:
    found = of(np.full(100, 0.7))
    assert quantiles(found) == [0.7] * 3
    assert [(each.lower, each.mass_percent) for each in found.classes] == [(0.7, pytest.approx(100))]
    assert found.quantiles[0].value.standard_error == 0


@pytest.mark.parametrize("n", [0, 3])
def test_without_the_measure_there_is_no_figure(n: int) -> None:
    found = of(np.full(n, UNKNOWN))
    assert (found.n_stones, found.n_unmeasured, found.classes) == (0, n, ())
    assert {each.value.state for each in found.quantiles} == {State.NOT_MEASURED}
    assert found.mean.value is None


def test_the_last_class_has_what_lies_beyond_it() -> None:
    found = of(np.array([99.0, 9_900.0, 10_000.0, 1e9]), measure="angularity")
    first, last = found.classes[0], found.classes[-1]
    assert (first.lower, first.upper, first.number_percent) == (0, 200, 25)
    assert (last.lower, last.upper, last.number_percent) == (9800, 10_000, 75)


@given(STONES)
def test_of_any_stones(stones: list[tuple[float, float]]) -> None:
    lot = lot_of(round_stone(10.0, mass, convexity=value) for value, mass in stones)
    found = distribution_of(sample_of(lot), "convexity")
    assert found.n_stones + found.n_unmeasured == len(stones)
    if not found.n_stones:
        return
    for shares in zip(*((each.mass_percent, each.number_percent) for each in found.classes), strict=True):
        assert sum(shares) == pytest.approx(100)
        assert min(shares) >= 0
    assert quantiles(found) == sorted(quantiles(found))
    known = [value for value, _ in stones if not np.isnan(value)]
    for each in found.quantiles:
        assert each.value.value in known
        assert each.value.low <= each.value.value <= each.value.high
    reverse = lot_of(round_stone(10.0, mass, convexity=value) for value, mass in stones[::-1])
    assert distribution_of(sample_of(reverse), "convexity") == found


def test_intervals_of_the_median_hold_the_truth_in_95_of_100_lots() -> None:
    rng, n_lots, hits = np.random.default_rng(5), 400, 0
    for _ in range(n_lots):
        shape, size_mm = rng.beta(8, 3, 150), np.exp(rng.normal(2.4, 0.25, 150))
        lot = lot_with(size_mm, volume_mm3=size_mm**3, sphericity=shape)
        median = distribution_of(sample_of(lot), "sphericity").quantiles[1].value
        hits += median.low <= 0.7414 <= median.high  # the median of the beta distribution
    assert 0.93 <= hits / n_lots <= 0.985
