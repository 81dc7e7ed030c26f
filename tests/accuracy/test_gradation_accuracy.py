"""A lot of a few rendered stones, beside the same stones as they are; `gradation.py` prints the same for 300."""

from dataclasses import replace

import numpy as np
import pytest
from accuracy.gradation import PAIRS
from support.lot_comparison import comparison, missed
from support.rendered_lots import ALL_CAMERAS, Row, body, measured_rows

from pipeline.gradation.evaluation import evaluate
from pipeline.gradation.stones import Fate, Stone, UnmeasuredStone, lot_of
from service.lots.standards import read_standards

SEED = 5
N_STONES, N_JOBS = 12, 1
N_DRAWN = 60
NEAR_MM = 0.1
"""A stone so near to a sieve may fall on either side of it."""
MAX_POINTS = 1.0

pytestmark = pytest.mark.timeout(600)


@pytest.fixture(scope="module")
def rendered() -> list[Row]:
    return measured_rows(N_STONES, SEED, N_JOBS, PAIRS[:2])


@pytest.fixture(scope="module")
def drawn() -> list[Row]:
    """Stones that were measured without any error."""
    stones = [body(number, SEED) for number in range(N_DRAWN)]
    return [
        Row(number=number, form=it.name, true=true, found={ALL_CAMERAS: true})
        for number, (it, true) in enumerate(stones)
    ]


@pytest.mark.full
@pytest.mark.parametrize("cameras", [ALL_CAMERAS, *map(" ".join, PAIRS[:2])])
def test_passing_of_rendered_stones_is_that_of_the_true_ones(rendered: list[Row], cameras: str) -> None:
    found = comparison(rendered, cameras)
    assert not found.rejected
    truth = lot_of(row.true for row in rendered)
    for name, figures in found.passing.items():
        for figure, sieve_mm in zip(figures, measured_sieves_mm(name), strict=True):
            low, high = (evaluate(truth, [sieve_mm + near]).curve[0] for near in (-NEAR_MM, NEAR_MM))
            least = (low.by_mass.value or 0.0) - MAX_POINTS
            greatest = (100.0 if high.by_mass.value is None else high.by_mass.value) + MAX_POINTS
            assert least <= (figure.found.value or 0.0) <= greatest, f"{name}, {figure.name}"


def measured_sieves_mm(name: str) -> list[float]:
    return [mm for mm in read_standards().sieve_sets[name].apertures_mm if 4 <= mm <= 40]


@pytest.mark.full
def test_rendered_stones_are_as_large_and_as_flaky_as_the_true_ones(rendered: list[Row]) -> None:
    for row in rendered:
        found = row.found[ALL_CAMERAS]
        assert isinstance(found, Stone)
        said = f"{row.form} {row.number}"
        assert found.sieve_size_mm == pytest.approx(row.true.sieve_size_mm, abs=NEAR_MM), said
        assert found.max_feret_mm == pytest.approx(row.true.max_feret_mm, abs=0.25), said
        assert found.min_feret_mm == pytest.approx(row.true.min_feret_mm, abs=0.5), said
        assert found.volume_mm3 == pytest.approx(row.true.volume_mm3, rel=0.05), said


@pytest.mark.full
def test_the_bench_finds_no_fault_with_perfect_stones(drawn: list[Row]) -> None:
    found = comparison(drawn)
    assert missed(found) == []
    assert set(found.agreement_percent.values()) == {100.0}
    assert max(abs(figure.difference) for figure in found.figures) < 1e-9


@pytest.mark.full
def test_the_bench_finds_stones_that_are_measured_too_large_or_too_thick(drawn: list[Row]) -> None:
    larger = [with_found(row, sieve_size_mm=1.03 * row.true.sieve_size_mm) for row in drawn]
    assert any("true class of r20" in said for said in missed(comparison(larger)))
    assert any("16 mm differs" in said for said in missed(comparison(larger)))
    thicker = [with_found(row, min_feret_mm=1.3 * row.true.min_feret_mm) for row in drawn]
    assert any("flakiness index differs" in said for said in missed(comparison(thicker)))
    assert not any("mm differs" in said for said in missed(comparison(thicker)))


@pytest.mark.full
def test_stones_that_are_not_measured_are_left_out_of_the_truth_and_counted(drawn: list[Row]) -> None:
    heaviest = max(drawn, key=lambda row: row.true.volume_mm3)
    lost = UnmeasuredStone(fate=Fate.REJECTED, reason="clipped")
    found = comparison([replace(row, found={ALL_CAMERAS: lost}) if row is heaviest else row for row in drawn])
    assert missed(found) == []
    assert found.rejected == {"clipped": 1}
    masses = np.array([row.true.volume_mm3 for row in drawn])
    assert found.rejected_mass_percent == pytest.approx(100 * masses.max() / masses.sum())


def with_found(row: Row, **measures: float) -> Row:
    return replace(row, found={ALL_CAMERAS: replace(row.true, **measures)})
