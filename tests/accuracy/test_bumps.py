"""The table of bumps, in short: named in time, and nobody else."""

import numpy as np
from accuracy.bumps import bumps, false_alarms

from pipeline.rig.design import as_built, nominal_rig

NOISE_PX = 0.08


def test_every_bump_is_named_in_time_and_no_other_camera() -> None:
    for found in bumps(seed=31, noise_px=NOISE_PX, n_bumps=2):
        assert found.named_after is not None, found
        assert found.named_after <= (1 if found.turn_deg >= 0.5 else 20), found
        assert not found.others_named, found


def test_healthy_stones_raise_no_alarm() -> None:
    rig = as_built(nominal_rig(), 32)
    alarms, highest_px = false_alarms(rig, np.random.default_rng(33), NOISE_PX)
    assert alarms == 0
    assert highest_px < 0.3
