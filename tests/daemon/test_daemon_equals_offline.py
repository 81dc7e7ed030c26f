"""The daemon and `stonefall measure` give the same results, bit for bit, whatever the number of workers."""

import json
import time
from pathlib import Path

import pytest
from support.daemon_process import DaemonProcess
from support.small_recording import write_small_recording
from typer.testing import CliRunner

from service.cli import build_app
from service.record import MEASURED_FIELDS

COMPARED = (
    "bundle", "sequence", "kind", "captured_at", "outcome", "reason", "detail", "quality", "views",
    "dropped_views", *MEASURED_FIELDS, "gate_extent_mm", "gate_extent_is_plausible",
    "view_residuals_px", "calibration_id", "algorithm_version", "is_simulated",
)  # fmt: skip


@pytest.mark.parametrize("slots", [1, 3])
def test_daemon_equals_offline(tmp_path: Path, slots: int) -> None:
    recording = tmp_path / "recording"
    write_small_recording(recording, n_stones=5)
    document = json.loads((recording / "recording.json").read_text())
    document["gate_settings"] = {"speed_at_gate_mm_s": 100.0}
    (recording / "recording.json").write_text(json.dumps(document))
    header, torn, page = sorted((recording / "bundles").iterdir())[-3:]
    header.write_bytes(header.read_bytes()[:50])  # cannot be read at all
    torn.write_bytes(torn.read_bytes()[:-2000])  # the header is sound, the last pages are not
    assert page.exists()
    with DaemonProcess(tmp_path, recording, slots=slots) as daemon:
        daemon.hear("READY=1")
        deadline = time.monotonic() + 60
        while (counts := daemon.get("/accounting"))["triggers"] < 5 or counts["in_progress"]:
            assert time.monotonic() < deadline, daemon.log
            time.sleep(0.1)
        live = daemon.get("/results?after=0")["items"]
        arguments = ["measure", str(recording), "--out", str(tmp_path / "out"), "--workers", "2"]
        arguments += ["--config", str(daemon.config_path)]
        result = CliRunner().invoke(build_app(), arguments, catch_exceptions=False)
        assert result.exit_code == 0, result.output
        offline = [json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines()]
        assert len(live) == len(offline) == 5
        assert [record["outcome"] for record in offline] == [*["measured"] * 4, "lost"]
        assert offline[-1]["reason"] == "unreadable"
        assert offline[2]["dropped_views"]
        for record in offline[:4]:  # the pulses are those of spheres of 15 mm that were let go at the beam
            assert record["gate_extent_mm"] == pytest.approx(15.0 + 100 * 0.0553, abs=0.2)
            assert record["gate_extent_is_plausible"] is False
        for ours, theirs in zip(live, offline, strict=True):
            assert {key: ours[key] for key in COMPARED} == {key: theirs[key] for key in COMPARED}
            if ours["mesh"] is None:
                continue
            kept = tmp_path / "state" / ours["mesh"]
            assert kept.read_bytes() == (tmp_path / "out" / theirs["mesh"]).read_bytes()
