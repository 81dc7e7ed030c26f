"""A steady run of the whole live chain: the bench `steady.py`, short, and how it judges."""

from pathlib import Path

import numpy as np
import pytest
from soak.steady import MAX_RISE, Trend, run_steadily
from support.small_recording import write_small_recording

SECONDS = 1200.0


def trend(*, warm_up: float = 0.0, slope_an_hour: float = 0.0, noise: float = 0.0) -> Trend:
    """Return what samples of twenty minutes show of a quantity about 600."""
    at_s = np.linspace(0, SECONDS, 121)
    scattered = np.random.default_rng(1).normal(600, noise, len(at_s))
    values = scattered - warm_up * np.exp(-at_s / 60) + slope_an_hour * at_s / 3600
    return Trend(list(values), SECONDS, max_rise=30)


@pytest.mark.parametrize(
    ("samples", "grows"),
    [
        (trend(), False),
        (trend(warm_up=300, noise=20), False),
        (trend(slope_an_hour=100), False),  # 25 in a quarter of an hour
        (trend(slope_an_hour=-500), False),
        (trend(slope_an_hour=200, noise=20), True),
        (trend(slope_an_hour=4680), True),  # an image a second
    ],
)
def test_what_grows_is_told_from_the_warm_up_and_from_noise(samples: Trend, grows: bool) -> None:
    assert samples.grows is grows


def test_the_slope_is_that_of_an_hour() -> None:
    assert 3600 * trend(slope_an_hour=200).slope_per_s == pytest.approx(200)


@pytest.mark.night
def test_a_steady_run_has_one_outcome_for_each_stone_and_is_judged(tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    write_small_recording(recording, n_stones=6, n_backgrounds=1)
    run = run_steadily(tmp_path, recording, seconds=12, voxels=64, keep_raw=5)
    assert run.fallen >= 20
    assert not run.unbalanced
    assert run.trends.keys() == MAX_RISE.keys()
    assert all(min(trend.values) > 0 for trend in run.trends.values())
