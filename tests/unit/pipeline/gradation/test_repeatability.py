"""Repeatability and reproducibility by ISO 5725-2."""

import numpy as np
import pytest

from pipeline.gradation.repeatability import repeatability


def test_by_hand() -> None:
    found = repeatability([[10.0, 12.0], [14.0, 16.0]])
    assert found.mean == 13
    assert found.repeatability_sd == pytest.approx(np.sqrt(2))
    assert found.between_sd == pytest.approx(np.sqrt((16 - 2) / 2))
    assert found.reproducibility_sd == pytest.approx(3.0)
    assert found.repeatability_limit == pytest.approx(2.8 * np.sqrt(2))
    assert found.reproducibility_limit == pytest.approx(8.4)


def test_it_finds_what_runs_were_made_with() -> None:
    rng = np.random.default_rng(1)
    groups = [list(rng.normal(50 + rng.normal(0, 2), 1, rng.integers(3, 8))) for _ in range(400)]
    found = repeatability(groups)
    assert found.repeatability_sd == pytest.approx(1, rel=0.05)
    assert found.between_sd == pytest.approx(2, rel=0.1)


def test_one_group_has_no_reproducibility() -> None:
    found = repeatability([[1.0, 2.0, 3.0]])
    assert (found.repeatability_sd, found.reproducibility_sd, found.reproducibility_limit) == (
        1.0,
        None,
        None,
    )


def test_groups_that_differ_less_than_their_runs_have_no_scatter_of_their_own() -> None:
    assert repeatability([[1.0, 3.0], [1.0, 3.0]]).between_sd == 0


@pytest.mark.parametrize("groups", [[], [[]], [[1.0], [2.0]]])
def test_single_runs_repeat_nothing(groups: list[list[float]]) -> None:
    with pytest.raises(ValueError, match="two runs"):
        repeatability(groups)
