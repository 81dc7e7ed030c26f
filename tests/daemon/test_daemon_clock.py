"""The real process on a host whose wall clock is not set at the start, and is set while stones fall."""

import sys
import time
from pathlib import Path

import pytest
from support.daemon_process import DaemonProcess
from support.small_recording import write_small_recording
from support.wall_clock import set_ahead

WALL_CLOCK = Path(__file__).parents[1] / "support" / "wall_clock.py"
HOUR_S = 3600.0


@pytest.mark.full
def test_a_clock_that_is_set_costs_no_stone_and_its_times_are_marked_until_then(tmp_path: Path) -> None:
    recording, ahead = tmp_path / "recording", tmp_path / "ahead"
    write_small_recording(recording, n_stones=6)
    set_ahead(ahead, 42 - time.time())  # 1970
    command = (sys.executable, WALL_CLOCK, ahead)
    with DaemonProcess(tmp_path, recording, rig="loop = true\nspeed = 2.0", command=command) as daemon:

        def measure_some() -> None:
            measured = daemon.get("/accounting")["measured"]
            daemon.wait_for("/accounting", lambda now: now["measured"] >= measured + 4)

        daemon.hear("READY=1")
        measure_some()
        health = daemon.get("/health")
        assert health["ne107"] == "out_of_specification"
        assert any(reason.startswith("clock: the wall clock was not set") for reason in health["reasons"])

        set_ahead(ahead, 0)
        daemon.wait_for("/health", lambda now: now["checks"]["clock"]["status"] == "pass")
        n_before = daemon.get("/results?after=0&limit=1")["last_seq"]
        measure_some()

        for step_s in (HOUR_S, -HOUR_S):
            set_ahead(ahead, max(step_s, 0))
            daemon.wait_for(
                "/health",
                lambda now, step_s=step_s: abs((now["checks"]["clock"]["observed_value"] or 0) - step_s) < 1,
            )
            measure_some()

        assert daemon.get("/acquisition")["state"] == "armed"
        results, accounting = daemon.results(), daemon.get("/accounting")
        assert [result["seq"] for result in results] == list(range(1, len(results) + 1))
        assert (accounting["lost"], accounting["is_balanced"]) == (0, True)
        assert all(result["time_is_doubtful"] is (result["recorded_at"] < "2026") for result in results)
        assert all(result["time_is_doubtful"] for result in results[:4])
        assert not any(result["time_is_doubtful"] for result in results[n_before + 1 :])
        assert daemon.stop() == 0
