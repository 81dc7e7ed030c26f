"""Vectors E1 to E3 of the domain notes, and how many stones decide."""

import numpy as np
import pytest
from support.stones import lot_of_sizes

from pipeline.gradation.estimates import NOT_MEASURED, Errors, Estimate, estimate
from pipeline.gradation.evaluation import evaluate
from pipeline.gradation.specification import (
    Category,
    CategoryLimit,
    Range,
    Specification,
    Verdict,
    judge,
    judge_figure,
    judge_figures,
    specification_of,
    with_declaration,
)

NO_57 = Specification(
    name="57",
    source="ASTM C33",
    passing={
        37.5: Range(100, 100),
        25.0: Range(95, 100),
        12.5: Range(25, 60),
        4.75: Range(0, 10),
        2.36: Range(0, 5),
    },
)
G2 = {37.5: 100.0, 25.0: 98.0, 19.0: 75.0, 12.5: 45.0, 9.5: 25.0, 4.75: 5.0, 2.36: 2.0}


def around(value: float, half: float = 0.0, *, n_effective: float = 1e6, systematic: float = 0.0) -> Estimate:
    return estimate(
        value, (value - half, value + half), Errors(half / 1.96, 0.0, systematic), 1000, n_effective
    )


def judged(**of_12_5: float) -> Verdict:
    passing = {sieve_mm: around(percent) for sieve_mm, percent in G2.items()}
    if of_12_5:
        passing[12.5] = around(**of_12_5)
    return judge_figures(NO_57, passing).verdict


def test_vector_e1() -> None:
    assert judged() is Verdict.CONFORMS


def test_vector_e2() -> None:
    assert judged(value=62.0, half=4.0) is Verdict.UNDECIDED


def test_vector_e3() -> None:
    assert judged(value=70.0, half=4.0) is Verdict.DOES_NOT_CONFORM


def test_a_sieve_that_was_not_measured_leaves_a_verdict_in_part() -> None:
    passing = {sieve_mm: around(percent) for sieve_mm, percent in G2.items()} | {2.36: NOT_MEASURED}
    found = judge_figures(NO_57, passing)
    assert (found.verdict, found.is_partial) == (Verdict.CONFORMS, True)
    assert found.passing[2.36].verdict is Verdict.NOT_MEASURED
    assert judge_figures(NO_57, {}).verdict is Verdict.NOT_MEASURED


def test_one_figure_outside_decides_whatever_is_open() -> None:
    passing = {25.0: around(50.0, 1.0), 12.5: around(62.0, 4.0), 4.75: around(5.0, n_effective=20)}
    found = judge_figures(NO_57, passing)
    assert found.verdict is Verdict.DOES_NOT_CONFORM
    assert found.passing[12.5].verdict is Verdict.UNDECIDED
    assert found.passing[4.75].verdict is Verdict.INSUFFICIENT


def test_indices_have_verdicts() -> None:
    specification = Specification(
        name="mine", source="here", passing={}, flakiness=Range(0, 15), shape=Range(0, 20)
    )
    found = judge_figures(specification, {}, flakiness=around(10.0, 2.0), shape=around(30.0, 2.0))
    assert found.flakiness is not None
    assert found.shape is not None
    assert found.flakiness.verdict is Verdict.CONFORMS
    assert found.shape.verdict is found.verdict is Verdict.DOES_NOT_CONFORM


def test_figures_are_compared_as_they_are_reported() -> None:
    assert judge_figure(around(60.4), Range(0, 60), 1.0).verdict is Verdict.CONFORMS
    assert judge_figure(around(60.4), Range(0, 60), 0.1).verdict is Verdict.DOES_NOT_CONFORM


def test_that_all_stones_pass_is_never_proven_but_bounded() -> None:
    """The standards ask that 100 % pass 1.4 D and 2 D."""
    limits = Range(100, 100)
    sizes_mm = np.random.default_rng(4).uniform(8, 16, 2000)

    def after(n: int) -> Estimate:
        return evaluate(lot_of_sizes(sizes_mm[:n]), (22.4,)).passing(22.4)

    found = judge_figure(after(300), limits, 1.0)
    assert found.verdict is Verdict.UNDECIDED
    assert found.more_stones is not None
    assert judge_figure(after(300 + found.more_stones + 30), limits, 1.0).verdict is Verdict.CONFORMS
    assert judge_figure(around(99.0, 0.2), limits, 1.0).verdict is Verdict.DOES_NOT_CONFORM
    assert judge_figure(around(99.4, 0.2), limits, 1.0).verdict is Verdict.UNDECIDED


def test_four_times_the_stones_halve_the_interval() -> None:
    found = judge_figure(around(58.5, 4.0), Range(0, 60), 1.0)
    assert found.more_stones == 3000
    assert found.more_s is None
    assert judge_figure(around(58.5, 4.0), Range(0, 60), 1.0, stones_per_s=4.0).more_s == 750


def test_what_stones_cannot_decide_has_no_countdown() -> None:
    on_the_limit = judge_figure(around(60.5, 4.0), Range(0, 60), 1.0)
    systematic = judge_figure(around(58.5, 4.0, systematic=1.1), Range(0, 60), 1.0)
    decided = judge_figure(around(50.0, 4.0), Range(0, 60), 1.0)
    assert on_the_limit.more_stones is systematic.more_stones is decided.more_stones is None


def test_the_countdown_comes_true() -> None:
    rng = np.random.default_rng(3)
    sizes_mm = np.exp(rng.normal(np.log(13), np.log(1.25), 40_000))
    specification = Specification(name="mine", source="here", passing={16.0: Range(0, 62)})

    def after(n: int) -> tuple[Verdict, int | None]:
        found = judge(specification, evaluate(lot_of_sizes(sizes_mm[:n]), (16.0,)))
        return found.verdict, found.more_stones

    verdict, more = after(1000)
    assert verdict is Verdict.UNDECIDED
    assert more is not None
    verdict, more_then = after(1000 + more)
    assert verdict is Verdict.CONFORMS or (more_then is not None and more_then < more)
    assert after(40_000) == (Verdict.CONFORMS, None)


def test_too_few_stones_count_down_to_enough() -> None:
    found = judge_figure(around(10.0, 5.0, n_effective=20.0), Range(0, 60), 1.0)
    assert (found.verdict, found.more_stones) == (Verdict.INSUFFICIENT, 1500)


def test_a_category_is_a_specification_once_the_product_is_known() -> None:
    category = Category(
        name="GC90-10",
        source="EN 13043",
        passing=(
            CategoryLimit(is_upper=True, factor=1.4, limits=Range(100, 100)),
            CategoryLimit(is_upper=True, factor=1.0, limits=Range(90, 99)),
            CategoryLimit(is_upper=False, factor=0.5, limits=Range(0, 2)),
        ),
    )
    found = specification_of(category, 12.5, 31.5, (6.3, 12.5, 31.5, 45.0))
    assert (found.name, list(found.passing)) == ("GC90-10 12.5/31.5", [45.0, 31.5, 6.3])
    with pytest.raises(ValueError, match="0 < d < D"):
        specification_of(category, 16.0, 8.0, (8.0, 16.0))


AT_D = Range(85, 99, 100)
"""The limits of GC85-20 at D, percent: more than 99 asks for a declaration."""


@pytest.mark.parametrize(
    ("percent", "verdict", "asks"),
    [
        (100.0, Verdict.CONFORMS, True),
        (99.0, Verdict.CONFORMS, False),
        (80.0, Verdict.DOES_NOT_CONFORM, False),
    ],
)
def test_more_than_the_limit_conforms_with_a_declaration(
    percent: float, verdict: Verdict, asks: bool
) -> None:
    found = judge_figure(around(percent, 0.2), AT_D, 1.0)
    assert (found.verdict, found.asks_declaration) == (verdict, asks)


def test_stones_that_all_pass_the_upper_size_are_never_rejected() -> None:
    """With limits of 85 to 99 % and nothing else, some thousand good stones were rejected."""
    rng = np.random.default_rng(5)
    sizes_mm = np.exp(rng.normal(np.log(16), np.log(1.3), 30_000))
    sizes_mm = sizes_mm[sizes_mm < 28]
    for n, verdict in (
        (300, Verdict.UNDECIDED),
        (8_000, Verdict.CONFORMS),
        (len(sizes_mm), Verdict.CONFORMS),
    ):
        found = judge_figure(evaluate(lot_of_sizes(sizes_mm[:n]), (31.5,)).passing(31.5), AT_D, 1.0)
        assert found.verdict in (verdict, Verdict.CONFORMS), n
        assert found.asks_declaration


def test_what_is_declared_must_hold_within_the_limits() -> None:
    category = Specification(name="8/16", source="", passing={16: Range(85, 99, 100), 8: Range(0, 20)})
    found = with_declaration(category, {16: Range(97, 100), 11.2: Range(45, 75), 8: Range(5, 25)})
    assert found.passing == {16: Range(97, 100), 8: Range(5, 20), 11.2: Range(45, 75)}
    assert with_declaration(category, {}) == category
    with pytest.raises(ValueError, match="8 mm"):
        with_declaration(category, {8: Range(30, 40)})


def test_a_declaration_allows_no_less_than_the_limit_and_no_more_than_all() -> None:
    for declared in (98.0, 101.0):
        with pytest.raises(ValueError, match="with a declaration"):
            Range(85, 99, declared)


@pytest.mark.parametrize(("low", "high"), [(-1.0, 5.0), (5.0, 4.0), (0.0, 101.0), (float("nan"), 5.0)])
def test_impossible_limits_are_refused(low: float, high: float) -> None:
    with pytest.raises(ValueError, match="limits must rise"):
        Range(low, high)
