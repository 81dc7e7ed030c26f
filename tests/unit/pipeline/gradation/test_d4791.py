"""Vector F3 of the domain notes, and flat and elongated particles size by size, computed by hand."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples
from support.stones import box, lot_with, round_stone

from pipeline.gradation.d4791 import DIMENSIONS, FlatAndElongated, FlatAndElongatedFraction
from pipeline.gradation.estimates import Estimate, State
from pipeline.gradation.estimators import Basis
from pipeline.gradation.evaluation import evaluate
from pipeline.gradation.indices import ShapeIndices
from pipeline.gradation.sieves import OF_THE_RIG, MeasuredRange
from pipeline.gradation.stones import Lot, Stone, lot_of, merge

BOTH = "flat_and_elongated_percent"
SIEVES = (4.75, 9.5, 12.5, 19.0, 25.0)


def d4791(stones: Sequence[Stone], measured: MeasuredRange = OF_THE_RIG) -> ShapeIndices:
    return evaluate(lot_of(stones), SIEVES, measured=measured).indices


def share(
    forms: Sequence[FlatAndElongated], ratio: int = 3, basis: Basis = Basis.NUMBER, form: str = BOTH
) -> Estimate:
    (at_ratio,) = (each for each in forms if each.ratio == ratio)
    found: Estimate = getattr(at_ratio, form)[basis]
    return found


def particle(size_mm: float, volume_mm3: float, *, long: bool = False) -> Stone:
    """Return a particle of a size; a long one is four times as long as it is thick."""
    return replace(round_stone(size_mm, volume_mm3), length_mm=4 * size_mm if long else size_mm)


BY_HAND = [
    *(particle(11.0, 1100.0) for _ in range(3)),
    particle(11.0, 700.0, long=True),  # 9.5 to 12.5 mm: 4000 mm3, 1 of 4 by number, 17.5 % by mass
    particle(15.0, 2000.0),
    particle(15.0, 2500.0),
    particle(15.0, 4500.0, long=True),  # 12.5 to 19 mm: 9000 mm3, 1 of 3, 50 %
    particle(20.0, 1000.0, long=True),  # 19 to 25 mm: 1000 of 14000 mm3, less than a tenth
]


def test_vector_f3() -> None:
    found = d4791([box((10.0, 20.0, 40.0), 20.0)]).flat_and_elongated
    for basis in Basis:
        assert share(found, 3, basis, "flat_percent").value == 0
        assert share(found, 3, basis, "elongated_percent").value == 0
        assert share(found, 3, basis).value == 100
        assert share(found, 5, basis).value == 0


def test_shares_by_mass_and_by_number_differ() -> None:
    found = d4791([box((2.5, 5.0, 10.0), 5.0), round_stone(10.0, 900.0)]).flat_and_elongated
    assert share(found).value == 50
    assert share(found, 3, Basis.MASS).value == pytest.approx(100 * 125 / 1025)


def test_the_vector_by_hand_is_tested_size_by_size() -> None:
    found = d4791(BY_HAND)
    assert [(each.lower_mm, each.upper_mm, each.n_stones) for each in found.flat_and_elongated_fractions] == [
        (9.5, 12.5, 4),
        (12.5, 19.0, 3),
    ]
    small, large = found.flat_and_elongated_fractions
    assert (small.mass_percent, large.mass_percent) == pytest.approx((100 * 4 / 14, 100 * 9 / 14))
    assert values(small) == pytest.approx((17.5, 25.0))
    assert values(large) == pytest.approx((50.0, 100 / 3))
    assert share(found.flat_and_elongated_weighted, 3, Basis.MASS).value == pytest.approx(
        (4 * 17.5 + 9 * 50) / 13
    )
    assert share(found.flat_and_elongated_weighted).value == pytest.approx((4 * 25 + 9 * 100 / 3) / 13)
    assert share(found.flat_and_elongated_weighted, 4).value == 0, "four times is not more than four times"
    assert share(found.flat_and_elongated).value == pytest.approx(100 * 3 / 8)


def sizes(found: ShapeIndices) -> list[tuple[float, float]]:
    return [(each.lower_mm, each.upper_mm) for each in found.flat_and_elongated_fractions]


def values(fraction: FlatAndElongatedFraction) -> tuple[float | None, float | None]:
    return share(fraction.forms, 3, Basis.MASS).value, share(fraction.forms).value


def test_a_stone_as_large_as_a_sieve_is_in_the_fraction_below_it() -> None:
    assert [each.upper_mm for each in d4791([particle(12.5, 1.0)]).flat_and_elongated_fractions] == [12.5]


def test_only_fractions_that_are_measured_whole_are_tested() -> None:
    found = d4791(BY_HAND, MeasuredRange(min_mm=4.0, max_mm=18.0))
    assert [each.upper_mm for each in found.flat_and_elongated_fractions] == [12.5]
    for form in DIMENSIONS:
        for basis in Basis:
            mean = share(found.flat_and_elongated_weighted, 3, basis, form)
            assert mean.value == share(found.flat_and_elongated_fractions[0].forms, 3, basis, form).value


def test_without_a_fraction_there_is_no_mean() -> None:
    found = evaluate(lot_of(BY_HAND), (8.0,)).indices
    assert found.flat_and_elongated_fractions == ()
    assert share(found.flat_and_elongated_weighted, 3, Basis.MASS).state is State.NOT_MEASURED
    assert share(d4791([]).flat_and_elongated, 3, Basis.MASS).state is State.NOT_MEASURED


def test_a_hundred_particles_of_each_size_are_needed() -> None:
    many, few = [particle(11.0, 1.0)] * 100, [particle(15.0, 1.0)] * 99
    found = d4791([*many, *few])
    states = [share(each.forms).state for each in found.flat_and_elongated_fractions]
    assert states == [State.MEASURED, State.INSUFFICIENT]
    assert share(found.flat_and_elongated_weighted).state is State.INSUFFICIENT
    assert share(found.flat_and_elongated).state is State.MEASURED
    enough = d4791([*many, *few, few[0]])
    assert share(enough.flat_and_elongated_weighted).state is State.MEASURED


@st.composite
def lots(draw: st.DrawFn) -> list[Stone]:
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    sd_mm = draw(st.sampled_from((0.0, 0.05, 0.5)))
    return [
        Stone(
            volume_mm3=float(rng.uniform(0.3, 0.7) * size_mm**3),
            sieve_size_mm=float(size_mm),
            max_feret_mm=float(3 * size_mm),
            min_feret_mm=float(0.4 * size_mm),
            length_mm=float(rng.uniform(1.5, 4) * size_mm),
            width_mm=float(rng.uniform(0.9, 1.5) * size_mm),
            thickness_mm=float(rng.uniform(0.3, 0.9) * size_mm),
            volume_sd=0.01,
            sieve_size_sd_mm=sd_mm,
            feret_sd_mm=sd_mm,
        )
        for size_mm in rng.uniform(4.0, 26.0, draw(st.integers(1, 60)))
    ]


@examples(0.3)
@given(stones=lots(), cut=st.integers(0, 60), seed=st.integers(0, 10**6))
def test_merged_equals_the_batch_to_the_last_digit(stones: list[Stone], cut: int, seed: int) -> None:
    shuffled = [stones[i] for i in np.random.default_rng(seed).permutation(len(stones))]
    merged = merge(lot_of(shuffled[cut:]), lot_of(shuffled[:cut]))
    batch, again = (evaluate(lot, SIEVES, scale_sd=0.001).indices for lot in (lot_of(stones), merged))
    assert repr(again) == repr(batch)


@examples(0.3)
@given(stones=lots())
def test_the_mean_is_that_of_the_fractions_and_within_its_interval(stones: list[Stone]) -> None:
    found = d4791(stones)
    masses = [each.mass_percent for each in found.flat_and_elongated_fractions]
    for form in DIMENSIONS:
        for basis in Basis:
            mean = share(found.flat_and_elongated_weighted, 3, basis, form)
            parts = [share(each.forms, 3, basis, form).value for each in found.flat_and_elongated_fractions]
            if not masses:
                assert mean.value is None
                continue
            assert mean.value == pytest.approx(np.average(np.array(parts, float), weights=masses), abs=1e-9)
            assert mean.low is not None
            assert mean.high is not None
            assert 0 <= mean.low <= mean.high <= 100


def fallen(n: int, rng: np.random.Generator) -> Lot:
    """Return stones of which the larger ones are long more often, measured with errors."""
    sizes_mm = np.exp(rng.normal(np.log(12.5), 0.25, n))
    is_long = rng.random(n) < np.clip(0.05 + 0.03 * (sizes_mm - 8), 0.02, 0.6)
    return lot_with(
        sizes_mm,
        volume_mm3=sizes_mm**3 * rng.uniform(0.35, 0.65, n),
        length_mm=np.where(is_long, 4.0, 2.0) * sizes_mm,
        volume_sd=0.01,
        sieve_size_sd_mm=0.03,
        feret_sd_mm=0.02,
    )


@pytest.mark.full
def test_the_intervals_of_the_mean_hold_the_truth() -> None:
    rng, n_lots, sieves_mm = (
        np.random.default_rng(24),
        600,
        (9.5, 12.5, 16.0, 22.0),
    )  # each with a fifth or more
    truth = evaluate(fallen(300_000, rng), sieves_mm).indices
    held = dict.fromkeys(Basis, 0)
    for _ in range(n_lots):
        found = evaluate(fallen(600, rng), sieves_mm).indices
        assert sizes(found) == sizes(truth)
        for basis in Basis:
            mean, true = (share(each.flat_and_elongated_weighted, 3, basis) for each in (found, truth))
            held[basis] += (mean.low or 0.0) <= (true.value or 0.0) <= (mean.high or 0.0)
    assert all(92.5 <= 100 * n_held / n_lots <= 98.0 for n_held in held.values()), held
