"""Daemon and offline command measure the stone that is due, of several in one picture."""

import json
from pathlib import Path

import pytest
from support.daemon_process import DaemonProcess
from support.small_recording import write_crowded_recording
from typer.testing import CliRunner

from drivers.files.recording import open_recording
from service.commands.cli import build_app

NAMES = ("alone", "above", "unannounced", "touching", "between")


@pytest.mark.full
def test_the_due_stone_is_measured_beside_those_that_the_gate_announced(tmp_path: Path) -> None:
    path = tmp_path / "recording"
    write_crowded_recording(path)
    (tmp_path / "daemon").mkdir()
    with DaemonProcess(tmp_path / "daemon", path) as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda counts: counts["triggers"] == 5 and not counts["in_progress"])
        found = daemon.get("/results?after=0")["items"]
        config = daemon.config_path
    alone, above, unannounced, touching, between = found
    assert [record["outcome"] for record in found] == [
        "measured",
        "measured",
        "rejected",
        "rejected",
        "measured",
    ]
    assert unannounced["reason"] == touching["reason"] == "multiple"
    for beside in (above, between):
        assert beside["quality"] == alone["quality"]
        assert beside["views"] == alone["views"]
        assert beside["volume_mm3"] == pytest.approx(alone["volume_mm3"], rel=5e-3)
    arguments = ["measure", str(path), "--out", str(tmp_path / "out"), "--config", str(config)]
    result = CliRunner().invoke(build_app(), arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    offline = [json.loads(line) for line in (tmp_path / "out" / "results.jsonl").read_text().splitlines()]
    for ours, theirs in zip(found, offline, strict=True):
        for name in ("outcome", "reason", "volume_mm3", "views", "quality", "gate_extent_mm"):
            assert ours[name] == theirs[name]


def test_a_recording_without_them_reads_as_before(tmp_path: Path) -> None:
    write_crowded_recording(tmp_path)
    by_name = {header.name.partition("-")[2]: header.trigger for header in open_recording(tmp_path).headers}
    assert [len(by_name[name].near_stones) for name in NAMES] == [0, 1, 0, 1, 2]
