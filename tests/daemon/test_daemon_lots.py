"""A lot of the real daemon, by the commands that a plant's engineer types; it outlives a kill."""

import json
from pathlib import Path
from typing import Any

import pytest
from pypdf import PdfReader
from support.daemon_process import DaemonProcess
from support.eventually import eventually
from support.small_recording import write_small_recording
from support.warm_stonefall import run_stonefall
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
        assert [entry["action"] for entry in daemon.get("/audit")["items"]][:4] == [
            "product", "lot opened", "stones assigned", "lot closed",
        ]  # fmt: skip
        for kind, begin in (("html", b"<!"), ("pdf", b"%PDF")):
            path = tmp_path / f"report.{kind}"
            report = ["report", "L1", "--out", str(path), "--language", "de"]
            eventually(lambda words=report: run(daemon, *words).exit_code == 0)  # readers wait for all others
            assert path.read_bytes().startswith(begin)
        assert daemon.stop() == 0
    assert "Traceback" not in daemon.log


@pytest.mark.full
@pytest.mark.parametrize("n_lots", [3, pytest.param(100, marks=pytest.mark.night)])
def test_a_close_under_load_answers_with_the_figures_that_stay(tmp_path: Path, n_lots: int) -> None:
    write_small_recording(tmp_path / "recording", n_stones=N_STONES)
    rig = "loop = true\nspeed = 2.5"  # ten stones a second
    with DaemonProcess(tmp_path, tmp_path / "recording", rig=rig, slots=2) as daemon:
        daemon.hear("READY=1")
        daemon.put("/products/basalt", {"title": "basalt", "density_kg_m3": 2700, "specification": "astm-8"})
        daemon.wait_for("/accounting", lambda found: found["measured"] > 0)
        closed = []
        for number in range(n_lots):
            daemon.post("/lots", {"lot": f"L{number}", "product": "basalt"})
            fallen = daemon.get("/accounting")["triggers"] + 5
            daemon.wait_for("/accounting", lambda found, fallen=fallen: found["triggers"] >= fallen)
            at_once = daemon.post(f"/lots/L{number}/close", {})
            closed.append((at_once, daemon.post(f"/lots/L{number}/close?wait_s=300", {})))
        for at_once, final in closed:
            figures = daemon.get(f"/lots/{final['lot']}/gradation")
            assert figures["lot"] == final
            assert (figures["measured"], figures["verdict"]) == tuple(
                final["completion"][name] for name in ("measured", "verdict")
            )
            assert final["n_stones"] == at_once["n_stones"] + at_once["in_progress"]
            assert (final["state"], final["revision"], final["completion"]["revision"]) == ("closed", 1, 1)
        events = daemon.get("/events?after=0&limit=1000")["items"]
        told = [each["data"]["completion"] for each in events if each["type"] == "lot.completed"]
        assert told == [final["completion"] for _, final in closed]
        if n_lots > 10:  # else chance may have it that none was being measured
            assert sum(at_once["in_progress"] for at_once, _ in closed) > 0
        assert daemon.stop() == 0


@pytest.mark.full
def test_an_issued_report_is_signed_by_a_key_that_outlives_the_daemon(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "recording", n_stones=N_STONES)
    rig = 'pace = "fast"\n[plant]\nplant = "Quarry North"\ninstrument_serial = "SF-1"\ntime_zone = "Europe/Berlin"'
    with DaemonProcess(tmp_path, tmp_path / "recording", rig=rig) as daemon:
        daemon.hear("READY=1")
        daemon.put("/products/basalt", {"title": "basalt", "density_kg_m3": 2700})
        daemon.post("/lots", {"lot": "L1", "product": "basalt"})
        assert daemon.post("/lots/L1/close?wait_s=300", {})["state"] == "closed"
        key = daemon.get("/instrument/key")
        assert daemon.stop() == 0
    file = tmp_path / "state/issued/L1-1.pdf"
    text = " ".join(page.extract_text() for page in PdfReader(file).pages)
    assert "Quarry North" in text
    assert key["fingerprint"] in text
    said = f"signed by instrument SF-1 with key {key['fingerprint']}"
    for words in (("--config", daemon.config_path), ("--key", key["public_key"])):
        assert said in run_stonefall("report", "--verify", file, *words, check=True).stdout
    with DaemonProcess(tmp_path, tmp_path / "recording", rig=rig) as daemon:
        daemon.hear("READY=1")
        assert daemon.get("/instrument/key") == key
        assert daemon.stop() == 0
