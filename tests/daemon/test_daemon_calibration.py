"""A calibration in the running daemon: collected, solved, accepted, activated, killed, verified, rolled back."""

from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from support.calibration_cli import run
from support.daemon_process import DaemonProcess
from support.small_recording import write_ball_recording

from drivers.files.rig_file import read_rig

N_BALLS = 8
LOOP = 'pace = "fast"\nloop = true'


@pytest.fixture(scope="module")
def balls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("balls") / "recording"
    write_ball_recording(path, n_balls=N_BALLS)
    return path


def results_of(daemon: DaemonProcess, calibration_id: str, n_results: int) -> list[dict[str, Any]]:
    """The latest results, as soon as so many of them rest on this calibration."""

    def latest(page: dict[str, Any]) -> list[dict[str, Any]]:
        return [item for item in page["items"][-n_results:] if item["calibration_id"] == calibration_id]

    path = "/results?after=0&limit=1000"
    return latest(daemon.wait_for(path, lambda page: len(latest(page)) == n_results))


def told(events: dict[str, Any]) -> list[tuple[str, str, str]]:
    return [
        (each["type"], each["subject"], each["data"].get("outcome") or each["data"]["calibration_id"])
        for each in events["items"]
        if each["type"].startswith(("calibration.", "verification."))
    ]


@pytest.mark.full
def test_from_the_first_ball_to_the_roll_back(balls: Path, tmp_path: Path):
    nominal_id = read_rig(balls / "rig.json").calibration_id
    with DaemonProcess(tmp_path, balls, rig=LOOP) as daemon:
        daemon.hear("READY=1")
        assert run(daemon, "list")["active"]["calibration_id"] == nominal_id
        name = run(daemon, "start", "--ball-diameter-mm", "10", "--by", "the test")["id"]
        assert daemon.post("/calibrations", {"ball_diameters_mm": [10.0]})["status"] == 409
        assert daemon.post(f"/calibrations/{name}/accept", {})["status"] == 409
        collected = daemon.wait_for(f"/calibrations/{name}", lambda now: len(now["drops"]) >= N_BALLS)
        assert collected["coverage"]["n_drops"] >= N_BALLS
        assert min(collected["residuals_before_px"].values()) > 1
        daemon.check("drops", lambda now: "what falls is a ball" in (now["detail"] or ""))
        solved = run(daemon, "solve", name)
        assert max(solved["report"]["residuals_after_px"].values()) < 0.05
        assert run(daemon, "accept", name, "--by", "the test")["state"] == "accepted"
        assert {item["calibration_id"] for item in daemon.results()} == {nominal_id}
        active = run(daemon, "activate", name, "--by", "the test")
        assert active["is_active"]
        new_id = active["calibration_id"]
        measured = results_of(daemon, new_id, 1)
        assert {item["outcome"] for item in measured} == {"measured"}
        daemon.process.kill()
        daemon.process.wait()
    with DaemonProcess(tmp_path, balls, rig=LOOP) as daemon:
        daemon.hear("READY=1")
        assert run(daemon, "list")["active"]["calibration_id"] == new_id
        verification = daemon.post("/verifications", {"diameter_mm": 10.0, "count": 2})["id"]
        verdict = daemon.wait_for(f"/verifications/{verification}", lambda now: now["state"] != "collecting")
        assert verdict["state"] == "passed", verdict
        assert run(daemon, "activate", "0001")["is_active"]
        results_of(daemon, nominal_id, 1)
        results = daemon.results()
        events = daemon.wait_for("/events?limit=1000", lambda now: len(told(now)) == 3)
        assert told(events) == [
            ("calibration.activated", name, new_id),
            ("verification.ended", verification, "passed"),
            ("calibration.activated", "0001", nominal_id),
        ]
    assert [each for each, _ in groupby(item["calibration_id"] for item in results)] == [
        nominal_id,
        new_id,
        nominal_id,
    ]
