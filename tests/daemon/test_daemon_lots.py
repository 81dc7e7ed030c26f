"""A lot of the real daemon, by the commands that a plant's engineer types; it outlives a kill."""

import json
from pathlib import Path
from typing import Any

import pytest
from support.daemon_process import DaemonProcess
from support.eventually import eventually
from support.small_recording import write_small_recording
from typer.testing import CliRunner, Result

from service.commands.cli import build_app

N_STONES = 4


def run(daemon: DaemonProcess, *words: str) -> Result:
    url = daemon.url("").removesuffix("/api/v1")
    return CliRunner().invoke(build_app(["lots"]), ["lots", *words, "--url", url])


def lots(daemon: DaemonProcess, *words: str) -> str:
    done = run(daemon, *words)
    assert done.exit_code == 0, done.output
    return done.stdout


def lots_json(daemon: DaemonProcess, *words: str) -> dict[str, Any]:
    return dict(json.loads(lots(daemon, *words, "--json")))


@pytest.mark.full
def test_a_lot_is_opened_filled_shown_and_closed_over_a_kill(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=N_STONES)
    with DaemonProcess(tmp_path, tmp_path / "recording") as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda found: found["measured"] == N_STONES)
        product = ["product", "basalt", "--density-kg-m3", "2700", "--lower-mm", "8", "--upper-mm", "16"]
        assert "version 1" in lots(daemon, *product, "--specification", "GC85-20")
        assert "L1 of basalt is open: 0 stones" in lots(daemon, "open", "L1", "--product", "basalt")
        times = ["--since", "2000-01-01T00:00:00Z", "--until", "2100-01-01T00:00:00Z"]
        assert lots_json(daemon, "assign", "L1", *times)["n_assigned"] == N_STONES
        daemon.process.kill()
        daemon.process.wait()
    with DaemonProcess(tmp_path, tmp_path / "recording") as daemon:
        daemon.hear("READY=1")
        daemon.wait_for("/accounting", lambda found: found["measured"] == 2 * N_STONES)
        figures = lots_json(daemon, "show", "L1")
        assert (figures["measured"], figures["is_replay"]) == (2 * N_STONES, True)
        text = lots(daemon, "show", "L1", "--sieves", "astm-c136", "--specification", "astm-8")
        assert "not measured" in text
        assert "astm-8: insufficient" in text
        assert "is closed: 8 stones" in lots(daemon, "close", "L1", "--tonnage-t", "12.5")
        (listed,) = lots_json(daemon, "list")["items"]
        assert (listed["lot"], listed["state"], listed["tonnage_t"]) == ("L1", "closed", 12.5)
        assert [entry["action"] for entry in daemon.get("/audit")["items"]] == [
            "product", "lot opened", "stones assigned", "lot closed",
        ]  # fmt: skip
        for kind, begin in (("html", b"<!"), ("pdf", b"%PDF")):
            path = tmp_path / f"report.{kind}"
            report = ["report", "L1", "--out", str(path), "--language", "de"]
            eventually(lambda words=report: run(daemon, *words).exit_code == 0)  # readers wait for all others
            assert path.read_bytes().startswith(begin)
        assert daemon.stop() == 0
    assert "Traceback" not in daemon.log
