"""Strangers at the door of a daemon that measures: the command `soak.attack`, short."""

from pathlib import Path

import pytest
from soak.attack import attack


@pytest.mark.parametrize("times", [1, pytest.param(10, marks=pytest.mark.night)])
@pytest.mark.timeout(900)
@pytest.mark.full
def test_nothing_that_a_stranger_sends_stops_it(times: int, tmp_path: Path) -> None:
    assert [each.n_requests > 0 for each in attack(tmp_path, times)] == 4 * [True]
