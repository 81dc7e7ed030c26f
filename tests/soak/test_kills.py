"""Kills of the daemon while stones fall: the bench `kills.py`, short."""

from pathlib import Path

import pytest
from soak.kills import killed_again_and_again


@pytest.mark.parametrize(
    "n_kills", [1, pytest.param(5, marks=pytest.mark.full), pytest.param(20, marks=pytest.mark.night)]
)
@pytest.mark.timeout(900)
def test_every_stone_has_one_outcome_whenever_the_daemon_is_killed(n_kills: int, tmp_path: Path) -> None:
    balance = killed_again_and_again(tmp_path, n_kills)
    if n_kills > 1:  # with one it is chance what becomes of the stones
        assert balance.outcomes["measured"] >= 1
        assert balance.outcomes["lost, down"] >= 1
