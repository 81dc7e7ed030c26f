"""Vectors G1 and G2 of the domain notes, and what must hold for the curve of any stones."""

import random

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm
from support.stones import lot_of_masses, round_stone

from pipeline.gradation.curve import influence, interpolated_mm, retained_to_passing
from pipeline.gradation.estimates import State
from pipeline.gradation.evaluation import Gradation, evaluate
from pipeline.gradation.indices import INDICES, fineness_modulus
from pipeline.gradation.sieves import ALL_SIZES, LeastPortions, MeasuredRange, SieveSet
from pipeline.gradation.stones import Fate, Lot, Stone, UnmeasuredStone, fold, lot_of, merge

SIEVES = (4.0, 6.3, 8.0, 10.0, 12.5, 16.0, 20.0, 31.5)
RETAINED_G = {31.5: 0.0, 20.0: 50.0, 16.0: 150.0, 12.5: 250.0, 10.0: 250.0, 8.0: 150.0, 6.3: 100.0, 4.0: 40.0}
PAN_G = 10.0
G1_PASSING = (1.0, 5.0, 15.0, 30.0, 55.0, 80.0, 95.0, 100.0)
G1_QUANTILES = {10: 7.099, 30: 10.0, 50: 11.954, 60: 13.133, 90: 18.567}
G2 = {37.5: 100.0, 25.0: 98.0, 19.0: 75.0, 12.5: 45.0, 9.5: 25.0, 4.75: 5.0, 2.36: 2.0}

MEASURED = st.builds(
    lambda size, volume, sd, thin: round_stone(
        size, volume, sieve_size_sd_mm=sd, feret_sd_mm=sd, min_feret_mm=thin * size, volume_sd=0.02
    ),
    st.floats(1, 40),
    st.floats(1, 5e4),
    st.sampled_from((0.0, 0.1)),
    st.floats(0.2, 1),
)
UNMEASURED = st.builds(
    UnmeasuredStone,
    fate=st.sampled_from((Fate.REJECTED, Fate.LOST)),
    reason=st.sampled_from(("clipped", "crash")),
)
STONES = st.lists(st.one_of(MEASURED, MEASURED, UNMEASURED), min_size=1, max_size=30)


def values(gradation: Gradation) -> list[float | None]:
    return [point.by_mass.value for point in gradation.curve]


def test_vector_g1_from_the_retained_masses_of_a_laboratory() -> None:
    passing = retained_to_passing(RETAINED_G, PAN_G)
    assert tuple(passing) == SIEVES
    assert tuple(passing.values()) == pytest.approx(G1_PASSING)
    found = {percent: interpolated_mm(passing, percent) for percent in G1_QUANTILES}
    assert found == pytest.approx(G1_QUANTILES, abs=1e-3)
    d10, d30, d60 = (found[percent] or 0.0 for percent in (10, 30, 60))
    assert d60 / d10 == pytest.approx(1.850, abs=5e-4)
    assert d30**2 / (d10 * d60) == pytest.approx(1.073, abs=5e-4)


def test_vector_g1_from_stones() -> None:
    retained_g = {2.0: 10, 4.1: 40, 6.4: 100, 8.1: 150, 10.1: 250, 12.6: 250, 16.1: 150, 20.1: 50}
    found = evaluate(lot_of_masses(list(retained_g), list(retained_g.values())), SIEVES)
    assert values(found) == pytest.approx(G1_PASSING)
    quantiles = {percent: of.value for percent, of in found.quantiles_interpolated_mm.items()}
    assert quantiles == pytest.approx(G1_QUANTILES, abs=1e-3)
    exact = {percent: of.value for percent, of in found.quantiles_exact_mm.items()}
    assert exact == {10: 6.4, 30: 8.1, 50: 10.1, 60: 12.6, 90: 16.1}, "the stones' own sizes"
    assert found.indices.uniformity.value == pytest.approx(12.6 / 6.4)
    assert found.indices.curvature.value == pytest.approx(8.1**2 / (6.4 * 12.6))


def graphic(found: Gradation) -> list[float | None]:
    indices = found.indices
    return [
        each.value
        for each in (
            *(indices.graphic_mean_phi, indices.graphic_sorting_phi),
            *(indices.graphic_skewness, indices.graphic_kurtosis),
        )
    ]


def test_folk_and_ward_of_a_lognormal_gradation() -> None:
    """With z84 = 0.99446, z95 = 1.64485, z75 = 0.67449 of the normal distribution; Mz is its mean."""
    mean_phi, sd_phi = -3.4, 0.5
    sizes_mm = 2.0 ** -(mean_phi + sd_phi * norm.ppf((np.arange(4000) + 0.5) / 4000))
    found = evaluate(lot_of_masses(list(sizes_mm), [1.0] * 4000), SIEVES)
    sorting = sd_phi * (2 * 0.99446 / 4 + 2 * 1.64485 / 6.6)
    assert graphic(found) == pytest.approx([mean_phi, sorting, 0.0, 1.64485 / (2.44 * 0.67449)], abs=2e-3)
    mean = found.indices.graphic_mean_phi
    assert mean.sampling_se == pytest.approx(sd_phi / np.sqrt(4000), rel=0.15)


def test_folk_and_ward_of_a_fine_tail() -> None:
    """φ5 to φ95 of -4, -3.8, -3.7, -3.5, -3.1, -2.8, -2: by hand Mz -3.3667, σI 0.5530, SkI 0.4500, KG 1.3661."""
    edges = {5: -4.0, 16: -3.8, 25: -3.7, 50: -3.5, 75: -3.1, 84: -2.8, 95: -2.0}
    masses = np.diff([*edges, 100])
    sizes_mm = [2.0**-phi for phi in edges.values()]
    # the stone at each φ holds what lies between it and the next finer one; those beyond 5 % are larger
    found = evaluate(lot_of_masses([*sizes_mm, 2.0**4.5], [*masses.astype(float), 5.0]), SIEVES)
    assert graphic(found) == pytest.approx([-3.3667, 0.5530, 0.4500, 1.3661], abs=1e-4)


def test_folk_and_ward_of_stones_of_one_size_has_no_tails() -> None:
    found = evaluate(lot_of_masses([10.0] * 5, [1.0] * 5), SIEVES).indices
    assert found.graphic_mean_phi.value == pytest.approx(-np.log2(10))
    assert (found.graphic_skewness.value, found.graphic_kurtosis.value) == (None, None)


def test_vector_g2_fineness_modulus() -> None:
    assert fineness_modulus(G2) == pytest.approx(6.93)
    with pytest.raises(ValueError, match=r"needs the sieves 4\.75, 19 mm"):
        fineness_modulus({2.36: 2.0, 9.5: 25.0, 37.5: 100.0})


def test_fineness_modulus_of_stones_is_that_of_their_curve() -> None:
    lot = lot_of_masses([5.0, 9.5, 12.0, 20.0], [1.0, 2.0, 3.0, 4.0])
    found = evaluate(lot, (4.75,)).indices.fineness_modulus
    assert found.value == pytest.approx(fineness_modulus({4.75: 0, 9.5: 30, 19: 60, 37.5: 100}))


def test_mean_sizes() -> None:
    found = evaluate(lot_of_masses([5.0, 10.0], [1.0, 1.0]), ()).indices
    assert found.d32_mm.value == pytest.approx((125 + 1000) / (25 + 100))
    assert found.d43_mm.value == pytest.approx((625 + 10000) / (125 + 1000))


def test_standard_error_and_effective_number_are_those_of_the_formula() -> None:
    rng = np.random.default_rng(1)
    sizes, masses = rng.uniform(5, 30, 200), rng.uniform(1, 5, 200)
    found = evaluate(lot_of_masses(list(sizes), list(masses)), (12.5,)).curve[0]
    parts, is_in = masses / masses.sum(), sizes <= 12.5
    share = float(parts @ is_in)
    assert found.by_mass.value == pytest.approx(100 * share)
    assert found.by_mass.sampling_se == pytest.approx(100 * np.sqrt(np.sum((parts * (is_in - share)) ** 2)))
    assert found.by_mass.measuring_se == found.by_mass.systematic_se == 0
    assert found.by_mass.n_effective == pytest.approx(masses.sum() ** 2 / np.sum(masses**2))
    assert found.by_number.value == pytest.approx(100 * is_in.mean())
    assert found.by_number.n_effective == pytest.approx(200)


@given(STONES, st.floats(0.1, 10))
def test_vector_f4_percentages_ignore_density_and_order(
    stones: list[Stone | UnmeasuredStone], density: float
) -> None:
    found = evaluate(lot_of(stones), SIEVES, measured=ALL_SIZES, scale_sd=0.001)
    known = [value for value in values(found) if value is not None]
    assert known == sorted(known)
    lot = lot_of(reversed(stones))
    heavier = lot.measures.copy()
    heavier[0] *= density
    other = evaluate(Lot(measures=heavier, counts=lot.counts), SIEVES, measured=ALL_SIZES, scale_sd=0.001)
    assert values(other) == pytest.approx(values(found))
    for mine, theirs in (
        (found.indices.flakiness_percent, other.indices.flakiness_percent),
        (found.indices.shape_percent, other.indices.shape_percent),
        (found.indices.fineness_modulus, other.indices.fineness_modulus),
    ):
        assert theirs.value == pytest.approx(mine.value)
        assert (theirs.low, theirs.high) == pytest.approx((mine.low, mine.high), abs=1e-6)


@given(STONES, st.integers(0, 30), st.integers(0, 1000))
def test_folded_and_merged_equal_the_batch_to_the_last_digit(
    stones: list[Stone | UnmeasuredStone], cut: int, seed: int
) -> None:
    batch = evaluate(lot_of(stones), SIEVES, scale_sd=0.001)
    folded = Lot()
    for stone in stones:
        folded = fold(folded, stone)
    shuffled = random.Random(seed).sample(stones, len(stones))  # noqa: S311 - an order
    merged = merge(lot_of(shuffled[cut:]), lot_of(shuffled[:cut]))
    assert repr(evaluate(folded, SIEVES, scale_sd=0.001)) == repr(batch)
    assert repr(evaluate(merged, SIEVES, scale_sd=0.001)) == repr(batch)


@given(STONES)
def test_a_share_lies_in_its_own_interval(stones: list[Stone | UnmeasuredStone]) -> None:
    """The interval of four stones that all pass a sieve was 32.7 to 82.1 %, which leaves 100 % out."""
    for point in evaluate(lot_of(stones), SIEVES, measured=ALL_SIZES).curve:
        found = point.by_mass
        if found.value is not None and found.low is not None and found.high is not None:
            assert found.low <= found.value <= found.high


def test_a_stone_as_large_as_the_aperture_passes() -> None:
    assert values(evaluate(lot_of_masses([8.0, 16.0], [1.0, 1.0]), (8.0, 16.0))) == [50.0, 100.0]


def test_outside_of_its_range_nothing_is_measured_and_never_zero() -> None:
    found = evaluate(lot_of_masses([8.0] * 60, [1.0] * 60), (2.0, 4.0, 16.0, 45.0))
    assert [point.by_mass.state for point in found.curve] == [
        State.NOT_MEASURED,
        State.MEASURED,
        State.MEASURED,
        State.NOT_MEASURED,
    ]
    assert values(found) == [None, 0.0, 100.0, None]
    fine = evaluate(lot_of_masses([2.0] * 60, [1.0] * 60), (2.0, 4.0))
    assert fine.quantiles_exact_mm[50].state is State.NOT_MEASURED


def test_no_stones_have_no_figures() -> None:
    found = evaluate(lot_of([UnmeasuredStone(fate=Fate.LOST, reason="crash")]), SIEVES)
    assert found.n_stones == 0
    assert {point.by_mass.state for point in found.curve} == {State.NOT_MEASURED}
    assert {of.state for of in found.quantiles_exact_mm.values()} == {State.NOT_MEASURED}
    assert found.unmeasured.n_stones == 1
    assert found.unmeasured.at_most_percent is None


def test_few_stones_are_insufficient_and_their_interval_is_wide() -> None:
    found = evaluate(lot_of_masses([8.0] * 10, [1.0] * 10), (10.0,)).passing(10.0)
    assert found.state is State.INSUFFICIENT
    assert found.value == 100
    assert found.low is not None
    assert found.low < 80


def test_what_was_not_measured_is_bounded() -> None:
    lot = lot_of(
        [round_stone(10.0)] * 99
        + [
            UnmeasuredStone(fate=Fate.REJECTED, reason="clipped"),
            UnmeasuredStone(fate=Fate.LOST, reason="crash"),
        ]
    )
    found = evaluate(lot, (), measured=MeasuredRange(max_mm=30.0)).unmeasured
    assert found.by_reason == {"lost: crash": 1, "rejected: clipped": 1}
    assert found.expected_percent == pytest.approx(100 * 2 / 99)
    assert found.at_most_percent == pytest.approx(100 * 2 * 27 / 99), "spheres as large as the field"


def test_a_stone_near_the_sieve_passes_with_a_probability() -> None:
    clear = lot_of([round_stone(8.0, sieve_size_sd_mm=0.1)] * 50 + [round_stone(12.0)] * 50)
    near = lot_of([round_stone(9.9, sieve_size_sd_mm=0.1)] * 50 + [round_stone(12.0)] * 50)
    assert evaluate(clear, (10.0,)).passing(10.0).measuring_se == pytest.approx(0, abs=1e-6)
    found = evaluate(near, (10.0,)).passing(10.0)
    assert found.measuring_se is not None
    assert found.measuring_se > 1


def test_an_error_of_the_scale_does_not_average_out() -> None:
    errors = []
    for n in (400, 6_400):
        sizes_mm = list(np.linspace(6, 16, n))
        found = evaluate(lot_of_masses(sizes_mm, [1.0] * n), (10.0,), scale_sd=0.01).passing(10.0)
        errors.append(found.errors)
        assert found.errors.systematic == pytest.approx(1.0, rel=0.05), "10 % of the mass a mm, 0.1 mm"
    assert errors[1].sampling == pytest.approx(errors[0].sampling / 4, rel=0.01)


def test_influences_name_the_stones_that_matter() -> None:
    lot = lot_of_masses([5.0, 12.0, 8.0], [1.0, 6.0, 3.0])
    assert influence(lot, 10.0) == pytest.approx([40 - 100 / 3, 40 - 100, 40 - 100 / 7])


def test_quantile_outside_of_the_curve_is_not_invented() -> None:
    assert interpolated_mm({4.0: 20.0, 8.0: 90.0}, 10) is None
    assert interpolated_mm({4.0: 20.0, 8.0: 90.0}, 95) is None
    assert interpolated_mm({4.0: 0.0, 8.0: 100.0}, 50) == pytest.approx(np.sqrt(32))


@pytest.mark.parametrize(
    ("size", "volume"), [(0.0, 1.0), (1.0, -1.0), (float("nan"), 1.0), (1.0, float("inf"))]
)
def test_impossible_stones_are_refused(size: float, volume: float) -> None:
    with pytest.raises(ValueError, match="must be positive"):
        round_stone(size, volume)


@pytest.mark.parametrize(
    ("retained_g", "pan_g", "problem"),
    [({4.0: -1.0}, 0.0, "negative"), ({4.0: 0.0}, 0.0, "no mass"), ({}, 0.0, "no mass")],
)
def test_impossible_masses_are_refused(retained_g: dict[float, float], pan_g: float, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        retained_to_passing(retained_g, pan_g)


@pytest.mark.parametrize("apertures_mm", [(), (0.0, 1.0), (2.0, 1.0), (1.0, 1.0)])
def test_impossible_sieves_are_refused(apertures_mm: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="'mine'"):
        SieveSet(name="mine", source="here", apertures_mm=apertures_mm)


def test_least_test_portions_between_the_sizes_of_the_table() -> None:
    portions = LeastPortions(source="EN 933-1", kg_by_size_mm={8.0: 0.6, 16.0: 2.6, 32.0: 10.0})
    assert portions.least_kg(16.0) == pytest.approx(2.6)
    assert 0.6 < portions.least_kg(11.2) < 2.6
    assert portions.least_kg(4.0) == pytest.approx(0.6), "the table's end"


@given(st.lists(MEASURED, min_size=2, max_size=30), st.sampled_from((0.0, 0.002)))
def test_the_standard_error_of_every_figure_is_that_of_its_causes(
    stones: list[Stone], scale_sd: float
) -> None:
    found = evaluate(lot_of(stones), SIEVES, scale_sd=scale_sd)
    indices = (getattr(found.indices, name) for name in INDICES)
    sizes = (*found.quantiles_exact_mm.values(), *found.quantiles_interpolated_mm.values())
    for figure in (*(point.by_mass for point in found.curve), *sizes, *indices):
        if figure.value is not None:
            causes = (figure.sampling_se, figure.measuring_se, figure.systematic_se)
            assert figure.standard_error == pytest.approx(np.hypot.reduce(np.array(causes, float)))
