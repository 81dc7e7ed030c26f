"""Vector F3 of the domain notes, and flat and elongated particles size by size, computed by hand."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples
from support.stones import box, round_stone

from pipeline.gradation.d4791 import D4791, FormFraction, ParticleForm
from pipeline.gradation.estimates import State
from pipeline.gradation.estimators import Basis
from pipeline.gradation.evaluation import evaluate
from pipeline.gradation.sieves import OF_THE_RIG, MeasuredRange
from pipeline.gradation.stones import MEASURES, Lot, Stone, lot_of, merge

BOTH = ParticleForm.FLAT_AND_ELONGATED
SIEVES = (4.75, 9.5, 12.5, 19.0, 25.0)


def d4791(stones: Sequence[Stone], measured: MeasuredRange = OF_THE_RIG) -> D4791:
    return evaluate(lot_of(stones), SIEVES, measured=measured).indices.d4791


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
    found = d4791([box((10.0, 20.0, 40.0), 20.0)]).whole
    for basis in Basis:
        assert found[ParticleForm.FLAT][3][basis].value == found[ParticleForm.ELONGATED][3][basis].value == 0
        assert found[BOTH][3][basis].value == 100
        assert found[BOTH][5][basis].value == 0


def test_shares_by_mass_and_by_number_differ() -> None:
    of = d4791([box((2.5, 5.0, 10.0), 5.0), round_stone(10.0, 900.0)]).whole[BOTH][3]
    assert of[Basis.NUMBER].value == 50
    assert of[Basis.MASS].value == pytest.approx(100 * 125 / 1025)


def test_the_vector_by_hand_is_tested_size_by_size() -> None:
    found = d4791(BY_HAND)
    assert [(each.size.min_mm, each.size.max_mm, each.n_stones) for each in found.fractions] == [
        (9.5, 12.5, 4),
        (12.5, 19.0, 3),
    ]
    small, large = found.fractions
    assert (small.mass_percent, large.mass_percent) == pytest.approx((100 * 4 / 14, 100 * 9 / 14))
    assert values(small) == pytest.approx((17.5, 25.0))
    assert values(large) == pytest.approx((50.0, 100 / 3))
    assert found.weighted[BOTH][3][Basis.MASS].value == pytest.approx((4 * 17.5 + 9 * 50) / 13)
    assert found.weighted[BOTH][3][Basis.NUMBER].value == pytest.approx((4 * 25 + 9 * 100 / 3) / 13)
    assert found.weighted[BOTH][4][Basis.NUMBER].value == 0, "four times is not more than four times"
    assert found.whole[BOTH][3][Basis.NUMBER].value == pytest.approx(100 * 3 / 8)


def values(fraction: FormFraction) -> tuple[float | None, float | None]:
    of = fraction.shares[BOTH][3]
    return of[Basis.MASS].value, of[Basis.NUMBER].value


def test_a_stone_as_large_as_a_sieve_is_in_the_fraction_below_it() -> None:
    assert [each.size.max_mm for each in d4791([particle(12.5, 1.0)]).fractions] == [12.5]


def test_only_fractions_that_are_measured_whole_are_tested() -> None:
    found = d4791(BY_HAND, MeasuredRange(min_mm=4.0, max_mm=18.0))
    assert [each.size.max_mm for each in found.fractions] == [12.5]
    for form in ParticleForm:
        for basis in Basis:
            assert found.weighted[form][3][basis].value == found.fractions[0].shares[form][3][basis].value


def test_without_a_fraction_there_is_no_mean() -> None:
    found = evaluate(lot_of(BY_HAND), (8.0,)).indices.d4791
    assert found.fractions == ()
    assert found.weighted[BOTH][3][Basis.MASS].state is State.NOT_MEASURED
    assert d4791([]).whole[BOTH][3][Basis.MASS].state is State.NOT_MEASURED


def test_a_hundred_particles_of_each_size_are_needed() -> None:
    many, few = [particle(11.0, 1.0)] * 100, [particle(15.0, 1.0)] * 99
    found = d4791([*many, *few])
    states = [each.shares[BOTH][3][Basis.NUMBER].state for each in found.fractions]
    assert states == [State.MEASURED, State.INSUFFICIENT]
    assert found.weighted[BOTH][3][Basis.NUMBER].state is State.INSUFFICIENT
    assert found.whole[BOTH][3][Basis.NUMBER].state is State.MEASURED
    assert d4791([*many, *few, few[0]]).weighted[BOTH][3][Basis.NUMBER].state is State.MEASURED


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
    batch, again = (evaluate(lot, SIEVES, scale_sd=0.001).indices.d4791 for lot in (lot_of(stones), merged))
    assert repr(again) == repr(batch)


@examples(0.3)
@given(stones=lots())
def test_the_mean_is_that_of_the_fractions_and_within_its_interval(stones: list[Stone]) -> None:
    found = d4791(stones)
    masses = [each.mass_percent for each in found.fractions]
    for form in ParticleForm:
        for basis in Basis:
            mean = found.weighted[form][3][basis]
            parts = [each.shares[form][3][basis].value for each in found.fractions]
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
    columns = dict.fromkeys(MEASURES, sizes_mm) | {
        "volume_mm3": sizes_mm**3 * rng.uniform(0.35, 0.65, n),
        "length_mm": np.where(is_long, 4.0, 2.0) * sizes_mm,
        "volume_sd": np.full(n, 0.01),
        "sieve_size_sd_mm": np.full(n, 0.03),
        "feret_sd_mm": np.full(n, 0.02),
    }
    return Lot(measures=np.array([columns[name] for name in MEASURES], float))


@pytest.mark.full
def test_the_intervals_of_the_mean_hold_the_truth() -> None:
    rng, n_lots, sieves_mm = (
        np.random.default_rng(24),
        600,
        (9.5, 12.5, 16.0, 22.0),
    )  # each with a fifth or more
    truth = evaluate(fallen(300_000, rng), sieves_mm).indices.d4791
    held = dict.fromkeys(Basis, 0)
    for _ in range(n_lots):
        found = evaluate(fallen(600, rng), sieves_mm).indices.d4791
        assert [each.size for each in found.fractions] == [each.size for each in truth.fractions]
        for basis in Basis:
            mean, true = (each.weighted[BOTH][3][basis] for each in (found, truth))
            held[basis] += (mean.low or 0.0) <= (true.value or 0.0) <= (mean.high or 0.0)
    assert all(92.5 <= 100 * n_held / n_lots <= 98.0 for n_held in held.values()), held
