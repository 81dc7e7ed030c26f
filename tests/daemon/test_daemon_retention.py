"""The daemon removes by itself what its settings say, but nothing that is pinned, and tells."""

from pathlib import Path

import pytest
from support.daemon_process import DaemonProcess
from support.small_recording import write_small_recording

N_STONES = 3


@pytest.mark.full
def test_files_go_for_space_and_numbers_and_what_is_pinned_stay(tmp_path: Path) -> None:
    recording = tmp_path / "recording"
    write_small_recording(recording, n_stones=N_STONES)
    with DaemonProcess(tmp_path, recording) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda found: found["measured"] == N_STONES)
        assert daemon.put("/particles/2/pin", {"is_pinned": True, "reason": "test"})["is_pinned"]
        assert daemon.stop() == 0
    assert len(list(tmp_path.glob("state/particles/????-??-??/*/mesh.sfmesh"))) == N_STONES

    with DaemonProcess(tmp_path, recording, store="retention.max_files_gb = 1e-9") as daemon:
        daemon.hear("READY=1")
        for seq in (1, 3):
            daemon.wait_for(f"/particles/{seq}", lambda found: found["files_removed"] == "space")
            gone = daemon.get(f"/particles/{seq}/mesh.ply")
            assert (gone["status"], gone["files_removed"]) == (410, "space")
        pinned = daemon.get("/particles/2")
        assert (pinned["files_removed"], pinned["pin_reason"]) == (None, "test")
        page = daemon.get("/results")
        assert page["first_seq"] == 1
        assert [item["seq"] for item in page["items"]][:N_STONES] == [1, 2, 3]
        checks = daemon.wait_for("/health", lambda health: health["checks"]["disk_days"]["detail"])["checks"]
        assert (checks["disk_days"]["status"], checks["retention"]["status"]) == ("pass", "pass")
        assert daemon.stop() == 0
    assert "Traceback" not in daemon.log
    (kept,) = tmp_path.glob(f"state/particles/*/{pinned['id']}/mesh.sfmesh")
    assert kept.stat().st_size > 100
