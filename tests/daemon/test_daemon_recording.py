"""What the daemon records while it measures gives the same numbers when it is measured again."""

import json
from pathlib import Path

import pytest
from support.daemon_process import DaemonProcess
from support.small_recording import write_small_recording
from typer.testing import CliRunner

from drivers.files.recording import open_recording
from pipeline.frames import BundleKind
from service.commands.cli import build_app
from service.results.fields import MEASURED_FIELDS

COMPARED = (
    "bundle", "sequence", "kind", "outcome", "reason", "quality", "views", "dropped_views",
    *MEASURED_FIELDS, "gate_extent_mm", "gate_extent_is_plausible",
    "view_residuals_px", "calibration_id", "is_simulated",
)  # fmt: skip
N_STONES = 7


@pytest.mark.full
def test_a_recording_measures_as_the_daemon_did(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "source", n_stones=N_STONES)
    with DaemonProcess(tmp_path, tmp_path / "source", rig='pace = "recorded"') as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda counts: counts["measured"] >= 3)
        started = daemon.post("/recordings", {"name": "r1", "duration_s": 600, "pre_trigger": 3})
        assert started["state"] == "recording", started
        assert daemon.post("/recordings", {"name": "r2", "count": 1})["status"] == 409
        counts = daemon.wait_for(
            "/accounting", lambda counts: counts["triggers"] == N_STONES and not counts["in_progress"]
        )
        assert counts["measured"] == N_STONES  # nobody was disturbed
        stopped = daemon.post("/recordings/r1/stop", {})
        assert (stopped["state"], stopped["ended_by"]) == ("complete", "stop")
        live = {record["bundle"]: record for record in daemon.results()}
        assert daemon.stop() == 0

    folder = tmp_path / "state" / "recordings" / "r1"
    recording = open_recording(folder)
    kinds = [header.kind for header in recording.headers]
    assert kinds[:2] == [BundleKind.BACKGROUND, BundleKind.BACKGROUND]
    assert len(kinds) == stopped["bundles"] >= 5
    assert recording.document["made_by"]["pre_trigger"] == 3
    arguments = ["measure", str(folder), "--out", str(tmp_path / "out"), "--config", str(daemon.config_path)]
    result = CliRunner().invoke(build_app(["measure"]), arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    again = [json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines()]
    assert [record["bundle"] for record in again] == [header.name for header in recording.headers[2:]]
    for record in again:
        assert {key: record[key] for key in COMPARED} == {
            key: live[record["bundle"]][key] for key in COMPARED
        }


@pytest.mark.full
@pytest.mark.parametrize("asked_to_stop", [True, False])
def test_a_recording_when_the_daemon_ends(tmp_path: Path, asked_to_stop: bool) -> None:
    """Stopped in order it is kept as far as it came, killed it leaves nothing half done."""
    write_small_recording(tmp_path / "source", n_stones=2)
    state = tmp_path / "state" / "recordings"
    with DaemonProcess(tmp_path, tmp_path / "source", rig='pace = "fast"\nloop = true') as daemon:
        daemon.hear("READY=1")
        daemon.post("/recordings", {"name": "r1", "duration_s": 600})
        daemon.wait_for("/recordings/r1", lambda recording: recording["bundles"] >= 3)
        if asked_to_stop:
            assert daemon.stop() == 0
            assert len(open_recording(state / "r1").headers) >= 3
            assert [path.name for path in state.iterdir()] == ["r1"]
            return
        daemon.process.kill()
        daemon.process.wait()
    assert not (state / "r1").exists()
    with DaemonProcess(tmp_path, tmp_path / "source") as daemon:
        daemon.hear("READY=1")
        assert daemon.get("/recordings") == {"items": []}
        daemon.hear_line("recording that the daemon's crash left unfinished")
        assert list(state.iterdir()) == []
        assert daemon.stop() == 0
