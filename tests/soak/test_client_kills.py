"""Kills of the daemon and of its client, or of the bridge, while stones fall: the bench `client_kills.py`, short."""

from pathlib import Path

import pytest
from soak.client_kills import killed_again_and_again
from support.extents import Extent, first_quick


@pytest.mark.full
@pytest.mark.parametrize("is_bridge", [False, True], ids=["client", "bridge"])
@pytest.mark.parametrize("n_kills", first_quick([4, 50], Extent.NIGHT))
@pytest.mark.timeout(900)
def test_the_client_has_each_result_once_whoever_is_killed(
    n_kills: int, is_bridge: bool, tmp_path: Path
) -> None:
    tally = killed_again_and_again(tmp_path, n_kills, is_bridge=is_bridge)
    assert min(tally.kills.values()) >= 1
    assert sum(result["outcome"] == "measured" for result in tally.results) >= 1
