"""On a rig that was not told what falls: balls while a calibration is open, stones after it."""

from pathlib import Path

import pytest
from support.calibration_cli import run
from support.live_rig import live_rig
from support.small_recording import write_ball_recording

from drivers.files.rig_file import read_rig

N_BALLS = 8


@pytest.mark.full
def test_on_live_cameras_what_falls_is_a_ball_until_the_calibration_ends(tmp_path: Path):
    balls = tmp_path / "recording"
    write_ball_recording(balls, n_balls=N_BALLS)
    nominal_id = read_rig(balls / "rig.json").calibration_id
    with live_rig(tmp_path, balls, by_address=True, number=7) as live:
        name = live.daemon.post("/calibrations", {"ball_diameters_mm": [10.0]})["id"]
        fallen = live.measure(N_BALLS)
        assert {(item["kind"], item["calibration_id"]) for item in fallen} == {("ball", nominal_id)}
        solved = run(live.daemon, "solve", name)
        assert len(solved["report"]["drops_used"]) == N_BALLS
        assert run(live.daemon, "accept", name)["state"] == "accepted"
        new_id = run(live.daemon, "activate", name)["calibration_id"]
        (after,) = live.measure(1)
        assert (after["kind"], after["outcome"], after["calibration_id"]) == ("particle", "measured", new_id)
        assert len(after["views"]) == 16
        assert run(live.daemon, "activate", "0001")["is_active"]
        (back,) = live.measure(1)
        assert back["calibration_id"] == nominal_id
