"""The daemon runs on with a camera that was hit and one that has lost its light, and everybody is told."""

from pathlib import Path

import numpy as np
import pytest
from support.daemon_process import DaemonProcess
from support.outlines import bumped
from support.small_recording import thumbnail_rig, write_small_recording

from drivers.files.rig_file import write_rig
from pipeline.frames import CameraId
from service.health.rig_watch import MIN_STONES


@pytest.mark.full
def test_a_bumped_camera_is_left_out_and_named_and_so_is_a_dark_one(tmp_path: Path) -> None:
    recording, rig = tmp_path / "recording", tmp_path / "before.json"
    write_small_recording(recording, n_stones=MIN_STONES, dimmed={CameraId("c09"): 0.6})
    write_rig(rig, bumped(thumbnail_rig(), "c05", np.array([0.0, 0.5, 0.0])))
    with DaemonProcess(tmp_path, recording, rig=f'pace = "fast"\ncalibration = "{rig}"') as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda now: now["measured"] == MIN_STONES)
        for result in daemon.results():
            assert list(result["dropped_views"]) == ["c05"]
            assert max(result["tangency_px"], key=result["tangency_px"].get) == "c05"
            assert (result["outcome"], result["quality"]) == ("measured", "good")
        health = daemon.get("/health")
        assert health["ne107"] == "out_of_specification"
        (reason,) = [reason for reason in health["reasons"] if reason.startswith("rig:")]
        assert reason.startswith("rig: c05: moved: it sees the stones 13.")
        assert reason.endswith(
            "recalibrate (stonefall calibrate RECORDING --method stones, or drop the ball)"
        )
        assert health["checks"]["rig"]["observed_value"] > 5
        (reason,) = [reason for reason in health["reasons"] if reason.startswith("optics:")]
        assert reason == (
            "optics: c09: sees 40% less light, its neighbours do not: look at its window, lens and flash"
        )
        brightness = {
            camera["id"]: camera["optics"]["brightness"] for camera in daemon.get("/cameras")["items"]
        }
        assert brightness.pop("c09") == pytest.approx(0.6, abs=0.02)
        assert list(brightness.values()) == pytest.approx([1] * 15, abs=0.03)
        scores = {camera["id"]: camera["tangency_px"] for camera in daemon.get("/cameras")["items"]}
        assert scores.pop("c05") > 5
        assert max(scores.values()) < 0.3
        assert daemon.stop() == 0
