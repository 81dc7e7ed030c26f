"""Vectors F1 and F2 of the domain notes; F3 is with `test_d4791`."""

from contextlib import nullcontext
from math import nan

import numpy as np
import pytest
from support.stones import box, lot_with, round_stone

from pipeline.arrays import Values
from pipeline.gradation.estimates import State
from pipeline.gradation.estimators import ratio_of_sums, sample_of
from pipeline.gradation.evaluation import evaluate
from pipeline.gradation.indices import ShapeIndices
from pipeline.gradation.sieves import OF_THE_RIG, MeasuredRange
from pipeline.gradation.stones import MEASURES, OPTIONAL, UNKNOWN, Lot, Stone, lot_of

F1 = [
    box((9.0, 19.0, 40.0), 19.0),
    box((11.0, 19.0, 40.0), 19.0),
    box((6.0, 12.0, 20.0), 12.0),
    box((4.0, 9.0, 15.0), 9.0),
]


def indices(stones: list[Stone], measured: MeasuredRange = OF_THE_RIG) -> ShapeIndices:
    return evaluate(lot_of(stones), (), measured=measured).indices


def test_vector_f1() -> None:
    found = indices(F1)
    assert found.flakiness_percent.value == pytest.approx(51.3, abs=0.05)
    assert found.shape_percent.value == 100


def test_vector_f2_the_length_of_a_box_is_its_diagonal() -> None:
    found = indices([box((10.0, 14.0, 28.0), 14.0)])
    assert found.shape_percent.value == found.needle_flaky_percent.value == 100


def test_a_slot_as_wide_as_the_stone_is_passed_and_a_sieve_belongs_to_the_fraction_below() -> None:
    assert indices([round_stone(16.0, min_feret_mm=8.0)]).flakiness_percent.value == 100
    assert indices([round_stone(16.01, min_feret_mm=10.01)]).flakiness_percent.value == 0


def test_only_fractions_that_are_measured_whole_count() -> None:
    stones = [round_stone(9.0, 1.0, min_feret_mm=1.0), round_stone(18.0, 1.0), round_stone(38.0, 9.0)]
    assert indices(stones, MeasuredRange(max_mm=36.0)).flakiness_percent.value == 50
    assert indices(stones, MeasuredRange(min_mm=9.0, max_mm=36.0)).flakiness_percent.value == 0


def test_a_stone_near_the_slot_is_flaky_with_a_probability() -> None:
    found = indices([round_stone(14.0, min_feret_mm=7.999, feret_sd_mm=0.1)] * 100).flakiness_percent
    assert found.value == 100
    assert found.measuring_se == pytest.approx(5, rel=0.05), "each of a hundred is about as likely not"


def test_too_few_particles_are_insufficient() -> None:
    assert indices([round_stone(10.0)] * 99).needle_flaky_percent.state is State.INSUFFICIENT
    assert indices([round_stone(10.0)] * 100).needle_flaky_percent.state is State.MEASURED


def test_a_ratio_is_of_the_stones_that_have_the_measure() -> None:
    def width(lot: Lot) -> tuple[Values, Values]:
        return lot.column("width_mm"), np.ones(lot.n_measured)

    sizes_mm = np.array([30.0] * 40 + [10.0, 20.0] * 30)
    lot = lot_with(sizes_mm, width_mm=np.where(sizes_mm == 30, UNKNOWN, sizes_mm))
    found = ratio_of_sums(sample_of(lot, scale_sd=0.001), width)
    assert found.value == pytest.approx(15), "its mean"
    assert (found.sampling_se, found.systematic_se) == pytest.approx((5 / 60**0.5, 0.015))
    assert (found.n_stones, found.n_effective, found.state) == (60, pytest.approx(60), State.MEASURED)
    assert found == ratio_of_sums(sample_of(lot.where(sizes_mm != 30), scale_sd=0.001), width)
    assert evaluate(lot, ()).indices.d43_mm.n_stones == 100, "other figures are of all stones"
    assert ratio_of_sums(sample_of(lot.where(sizes_mm == 30)), width).state is State.NOT_MEASURED


@pytest.mark.parametrize("name", MEASURES)
def test_a_stone_lacks_no_measure_but_an_optional_one(name: str) -> None:
    with nullcontext() if name in OPTIONAL else pytest.raises(ValueError, match=name):
        round_stone(10.0, **{name: nan})


def test_a_scale_of_lengths_changes_each_measure_by_its_unit() -> None:
    lot = lot_of([round_stone(10.0, 500.0, volume_sd=0.01, feret_sd_mm=0.1)]).scaled(2.0)
    names = ("volume_mm3", "length_mm", "volume_sd", "feret_sd_mm")
    assert [lot.column(name)[0] for name in names] == [4000.0, 20.0, 0.01, 0.2]
