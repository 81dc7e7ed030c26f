"""Which values of a series are out of control, by vectors of the literature and vectors worked by hand."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.gradation.control_chart import (
    NELSON_RUN,
    TREND,
    WESTERN_ELECTRIC,
    Baseline,
    ControlChart,
    RuleName,
    RunsRule,
    baseline_of,
    control_chart,
)

STANDARD = Baseline(0.0, 1.0)
MONTGOMERY = (
    9.45, 7.99, 9.29, 11.66, 12.16, 10.18, 8.04, 11.46, 9.20, 10.34, 9.03, 11.47, 10.51, 9.40, 10.08,
    9.37, 10.62, 10.31, 8.52, 10.84, 10.90, 9.33, 12.29, 11.50, 10.60, 11.08, 10.38, 11.62, 11.31, 10.52,
)  # fmt: skip
"""Table 9.1 of Montgomery, Introduction to Statistical Quality Control: the last ten have a mean of 11, others 10."""


def places(found: ControlChart, rule: RuleName) -> list[int]:
    return [each.place for each in found.violations if each.rule is rule]


def test_limits_are_those_of_the_moving_range() -> None:
    assert baseline_of([15.0, 15.1] * 5, centre=15.0) == Baseline(15.0, pytest.approx(0.1 / 1.128))
    assert baseline_of([15.0, 15.1] * 5) == Baseline(pytest.approx(15.05), pytest.approx(0.1 / 1.128))


def test_a_few_values_have_no_limits() -> None:
    assert baseline_of([15.0, 15.2, 14.9, 15.0, 15.1, 15.0, 15.1]) is None


def test_the_ewma_is_that_of_the_book() -> None:
    """Montgomery, table 9.10 and its chart: lambda 0.1, L 2.7."""
    found = control_chart(MONTGOMERY, Baseline(10.0, 1.0))
    book = [9.945, 9.7495, 9.70355, 9.8992, 10.1253, 10.1307, 9.92167, 10.0755]
    np.testing.assert_allclose(found.ewma[:8], book, atol=5e-5)
    np.testing.assert_allclose(found.ewma[27:], [10.5731, 10.6468, 10.6341], atol=5e-5)
    np.testing.assert_allclose(found.ewma_reach[[0, 1, 29]], [0.27, 0.36, 0.62], atol=5e-3)
    assert places(found, RuleName.EWMA) == [28, 29]
    assert places(found, RuleName.BEYOND_LIMITS) == []
    assert {each.began for each in found.violations if each.rule is RuleName.EWMA} == {19}


@pytest.mark.parametrize(
    ("rule", "in_control", "out_of_control"),
    [
        (WESTERN_ELECTRIC[0], [0, 3.0], [0, 3.01]),
        (WESTERN_ELECTRIC[1], [2.1, 0, 0, 2.1, 2.0, -2.1], [2.1, 0, 2.1]),
        (WESTERN_ELECTRIC[1], [2.1, -2.1], [-2.1, -2.1]),
        (WESTERN_ELECTRIC[2], [1.1, 1.1, 0, 0, 1.1, 1.1, 1.0], [1.1, 1.1, 0, 1.1, 1.1]),
        (WESTERN_ELECTRIC[2], [1.1, 1.1, 1.1, -1.1, -1.1], [1.1, 1.1, 1.1, 1.1]),
        (WESTERN_ELECTRIC[3], [0.1] * 7 + [-0.1], [0.1] * 8),
        (WESTERN_ELECTRIC[3], [0.1] * 7 + [0.0] + [0.1] * 7, [-0.1] * 8),
        (NELSON_RUN, [0.1] * 8, [0.1] * 9),
        (TREND, [0, 0.1, 0.2, 0.3, 0.4, 0.4, 0.5], [0, 0.1, 0.2, 0.3, 0.4, 0.5]),
        (TREND, [0.4, 0.3, 0.2, 0.1, 0.0], [0.4, 0.3, 0.2, 0.1, 0.0, -0.1]),
    ],
    ids=lambda each: f"{each.name}-{each.n}" if isinstance(each, RunsRule) else "",
)
def test_a_rule_is_violated_with_the_last_value_and_not_before(
    rule: RunsRule, in_control: Sequence[float], out_of_control: Sequence[float]
) -> None:
    assert places(control_chart(in_control, STANDARD, rules=[rule]), rule.name) == []
    found = control_chart(out_of_control, STANDARD, rules=[rule])
    assert places(found, rule.name) == [len(out_of_control) - 1]


def test_a_pattern_began_with_its_first_value() -> None:
    found = control_chart([0, 1.1, -0.5, 1.1, 1.1, 1.1], STANDARD, rules=[WESTERN_ELECTRIC[2]])
    assert [(each.place, each.began) for each in found.violations] == [(5, 1)]
    found = control_chart([0, *np.linspace(-0.3, 0.3, 6)], STANDARD, rules=[TREND])
    assert [(each.place, each.began) for each in found.violations] == [(6, 1)]


series = st.lists(st.floats(-5, 5).map(lambda each: round(each, 2)), max_size=40)


@given(series)
def test_a_mirrored_series_violates_the_same_rules(values: list[float]) -> None:
    found = control_chart(values, STANDARD)
    mirrored = control_chart([-each for each in values], STANDARD)
    key = lambda each: (each.place, each.rule, each.began)  # noqa: E731 - of two sortings
    assert sorted(found.violations, key=key) == sorted(mirrored.violations, key=key)


@given(series, st.floats(-100, 100), st.floats(0.1, 10))
def test_no_rule_looks_ahead(values: list[float], centre: float, sd: float) -> None:
    baseline = Baseline(centre, sd)
    whole = control_chart([*values, centre + 9 * sd], baseline).violations
    assert (
        tuple(each for each in whole if each.place < len(values))
        == control_chart(values, baseline).violations
    )


def test_limits_are_as_wide_as_the_errors_of_each_value_ask_for() -> None:
    values, errors = [0.0, 4.0, 4.0], [0.0, 0.0, 1.5]
    found = control_chart(values, STANDARD, errors)
    np.testing.assert_allclose(found.sds, [1, 1, np.hypot(1, 1.5)])
    assert places(found, RuleName.BEYOND_LIMITS) == [1]
    rng = np.random.default_rng(3)
    errors = rng.uniform(0.5, 2.0, 4000)
    values = rng.normal(0, np.hypot(1.0, errors))
    assert baseline_of(values, errors) == Baseline(pytest.approx(0, abs=0.1), pytest.approx(1, abs=0.15))


def test_errors_that_explain_all_scatter_leave_none() -> None:
    found = baseline_of([10.0, 10.1] * 5, [1.0] * 10)
    assert found is not None
    assert found.sd == 0.0


def test_equal_values_are_in_control() -> None:
    values = [0.1 + 0.2] * 30
    baseline = baseline_of(values)
    assert baseline is not None
    assert control_chart([*values, 0.3], baseline).violations == ()


def test_the_ewma_begins_anew_when_the_cause_is_gone() -> None:
    found = control_chart([4.0] * 20 + [0.5, -0.5, 0.5], STANDARD, rules=[])
    assert places(found, RuleName.EWMA) == list(range(21))
    np.testing.assert_allclose(found.ewma[21:], [-0.05, 0.005])
    np.testing.assert_allclose(found.ewma_reach[[21, 22]], found.ewma_reach[[0, 1]])


@pytest.mark.parametrize(("shift", "share"), [(0.0, 0.042), (1.0, 0.776)])
def test_a_shift_shows_and_chance_seldom_does(shift: float, share: float) -> None:
    """Shares of series of ten values that give a signal of the EWMA, as its constants state them."""
    rng = np.random.default_rng(7)
    signals = [
        bool(places(control_chart(rng.normal(shift, 1, 10), STANDARD), RuleName.EWMA)) for _ in range(1000)
    ]
    assert np.mean(signals) == pytest.approx(share, abs=0.04)
