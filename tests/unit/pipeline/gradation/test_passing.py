"""Vector G1 of the domain notes, and what must hold for any set of stones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.gradation.passing import gradation, quantile_mm

STONES = st.lists(st.tuples(st.floats(1, 40), st.floats(1, 5e4)), min_size=1, max_size=40)


def test_vector_g1() -> None:
    sieves = [4.0, 6.3, 8.0, 10.0, 12.5, 16.0, 20.0, 31.5]
    retained_g = {2.0: 10, 4.1: 40, 6.4: 100, 8.1: 150, 10.1: 250, 12.6: 250, 16.1: 150, 20.1: 50}
    curve = gradation(list(retained_g), [float(m) for m in retained_g.values()], sieves)
    assert curve.passing_percent == pytest.approx((1, 5, 15, 30, 55, 80, 95, 100))
    expected = {"D10": 7.099, "D30": 10.0, "D50": 11.954, "D60": 13.133, "D90": 18.567}
    assert curve.quantiles_mm == pytest.approx(expected, abs=1e-3)


@given(STONES, st.floats(0.1, 10))
def test_curve_rises_to_the_coarsest_stone_and_ignores_density_and_order(
    stones: list[tuple[float, float]], density: float
) -> None:
    sizes, volumes = (list(column) for column in zip(*stones, strict=True))
    curve = gradation(sizes, volumes)
    assert list(curve.passing_percent) == sorted(curve.passing_percent)
    assert curve.passing_percent[-1] == pytest.approx(100)
    heavier = gradation(sizes[::-1], [density * volume for volume in volumes[::-1]])
    assert heavier.passing_percent == pytest.approx(curve.passing_percent)


def test_a_stone_as_large_as_the_aperture_passes() -> None:
    assert gradation([8.0, 16.0], [1.0, 1.0], [8.0, 16.0]).passing_percent == (50.0, 100.0)


def test_no_stones_make_an_empty_curve() -> None:
    curve = gradation([], [])
    assert curve.n_stones == 0
    assert set(curve.quantiles_mm.values()) == {None}


def test_quantile_outside_of_the_curve_is_not_invented() -> None:
    assert quantile_mm([4.0, 8.0], [20.0, 90.0], 10) is None
    assert quantile_mm([4.0, 8.0], [20.0, 90.0], 95) is None
    assert quantile_mm([4.0, 8.0], [0.0, 100.0], 50) == pytest.approx(np.sqrt(32))


@pytest.mark.parametrize(("sizes", "volumes"), [([1.0], []), ([0.0], [1.0]), ([1.0], [-1.0])])
def test_impossible_stones_are_refused(sizes: list[float], volumes: list[float]) -> None:
    with pytest.raises(ValueError, match="sieve size"):
        gradation(sizes, volumes)
