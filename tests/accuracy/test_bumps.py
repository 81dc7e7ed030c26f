"""The table of bumps, in short: named in time, and nobody else."""

import numpy as np
import pytest
from accuracy.bumps import SOON, Observed, bumps, exact_outlines, false_alarms, in_images

from pipeline.synthesis.background import WallKind
from pipeline.synthesis.exposure import LensPreset

EXACT = exact_outlines(noise_px=0.08)


def test_every_bump_is_named_in_time_and_no_other_camera() -> None:
    for found in bumps(31, EXACT, n_bumps=2):
        assert found.named_after is not None, found
        assert found.named_after <= (SOON if found.turn_deg >= 0.5 else 20), found
        assert not found.others_named, found


def test_healthy_stones_raise_no_alarm() -> None:
    alarms, scores_px = false_alarms(*EXACT(np.random.default_rng(33)))
    assert alarms == 0
    assert scores_px.max() < 0.3


@pytest.mark.full
@pytest.mark.parametrize(("wall", "most_odd"), [(WallKind.PANELS, 0.0), (WallKind.SPOTTED, 0.01)])
def test_an_open_lens_hides_no_bump_and_raises_no_alarm(wall: WallKind, most_odd: float) -> None:
    observed: Observed = in_images(LensPreset.F2, wall, seed=34)
    alarms, scores_px = false_alarms(*observed(np.random.default_rng(0)), n_stones=20)
    assert alarms == 0
    assert (scores_px >= 0.3).mean() <= most_odd, "a piece of a stone may look like a spot, and no more"
    for found in bumps(35, observed, turns_deg=(0.01, 0.1), n_bumps=4):
        assert not found.others_named, found
        if found.image_px > 0.5:
            assert found.named_after is not None, found
            assert found.named_after <= (SOON if found.turn_deg >= 0.1 else 15), found
