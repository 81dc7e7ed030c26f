"""Kills of the daemon and of the reference client while stones fall: the bench `client_kills.py`, short."""

from pathlib import Path

import pytest
from soak.client_kills import killed_again_and_again

N_KILLS = 20


@pytest.mark.full  # several minutes
@pytest.mark.timeout(900)
def test_the_client_has_each_result_once_whoever_is_killed(tmp_path: Path) -> None:
    tally = killed_again_and_again(tmp_path, N_KILLS)
    assert min(tally.kills.values()) >= 1
    assert sum(result["outcome"] == "measured" for result in tally.results) >= 1
