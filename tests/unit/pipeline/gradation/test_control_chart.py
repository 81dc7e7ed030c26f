"""Which verifications of a series are out of control."""

import numpy as np
import pytest

from pipeline.gradation.control_chart import control_chart


def test_limits_are_those_of_the_moving_range() -> None:
    found = control_chart([15.0, 15.1] * 5, centre=15.0)
    assert (found.centre, found.lower) == (15.0, pytest.approx(15 - 3 * 0.1 / 1.128))
    assert found.beyond_limits == found.shifted == ()


def test_a_sphere_that_is_measured_wrong_is_named() -> None:
    rng = np.random.default_rng(1)
    series = [*rng.uniform(14.98, 15.02, 30), 15.1]
    assert control_chart(series, n_baseline=30).beyond_limits == (30,)


def test_a_small_shift_shows_in_a_run() -> None:
    rng = np.random.default_rng(2)
    series = [*rng.normal(15, 0.01, 30), *rng.normal(15.015, 0.002, 12)]
    found = control_chart(series, n_baseline=30, centre=15.0)
    assert set(found.shifted) >= {38, 39, 40, 41}
    assert min(found.shifted) > 30


def test_a_few_values_have_no_limits() -> None:
    found = control_chart([15.0, 15.2, 14.9])
    assert (found.lower, found.upper, found.beyond_limits) == (None, None, ())
    with pytest.raises(ValueError, match="needs a value"):
        control_chart([])
