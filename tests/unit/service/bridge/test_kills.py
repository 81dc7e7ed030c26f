"""The bridge is killed again and again while results come: each is delivered, and is there once.

`tests/soak/client_kills.py` does the same beside a real daemon.
"""

import json
import random
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from soak.client_kills import stored
from support.eventually import eventually
from support.extents import Extent, first_quick
from support.fake_feed import FakeFeed, serving
from support.recording_outlet import DATABASE, start_bridge

LIFE_S = 2.0
"""Longest life of a bridge, of which its start takes the most."""


@pytest.fixture
def daemon() -> Iterator[FakeFeed]:
    with serving(FakeFeed()) as daemon:
        yield daemon


@pytest.mark.parametrize("n_kills", first_quick([3, 50], Extent.NIGHT))
def test_each_result_is_there_once_however_often_the_bridge_is_killed(
    n_kills: int, daemon: FakeFeed, tmp_path: Path
) -> None:
    cursor = tmp_path / "recorder/results.cursor"
    dice = random.Random(n_kills)  # noqa: S311 - nothing secret
    for _ in range(n_kills):
        bridge = start_bridge(daemon.url, tmp_path)
        end_s = time.monotonic() + dice.uniform(0, LIFE_S)
        while time.monotonic() < end_s:
            daemon.last_seq += 1
            time.sleep(0.02)
        bridge.kill()
        bridge.wait()
    bridge = start_bridge(daemon.url, tmp_path)
    try:
        eventually(lambda: cursor.exists() and json.loads(cursor.read_text())["after"] == daemon.last_seq)
        assert stored(tmp_path / DATABASE) == daemon.items(0)
        assert "bridge-recorder" in daemon.parked
        bridge.terminate()
        assert bridge.wait() == 0
    finally:
        bridge.kill()
        bridge.wait()
    assert "Traceback" not in (tmp_path / DATABASE).with_suffix(".log").read_text()
