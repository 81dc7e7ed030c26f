"""Alarms of the real daemon: a lost camera is one, a dead switch is one as well, and events tell it in order."""

from collections.abc import Iterator
from typing import Any

import pytest
from support.live_rig import LiveRig, eventually, live_rig
from support.small_recording import write_small_recording
from typer.testing import CliRunner

from service.commands.cli import build_app


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveRig]:
    folder = tmp_path_factory.mktemp("live")
    write_small_recording(folder / "recording", n_stones=2, n_backgrounds=4)
    with live_rig(folder, folder / "recording") as live:
        live.wait_until_whole()
        yield live


def alarms(live: LiveRig) -> dict[str, str]:
    """State of what people see, by check."""
    return {each["check"]: each["state"] for each in live.daemon.get("/alarms")["items"]}


def events(live: LiveRig, *subjects: str) -> list[tuple[str, str]]:
    page = live.daemon.get("/events?after=0&limit=1000")
    assert [item["seq"] for item in page["items"]] == list(range(1, page["last_seq"] + 1))
    return [(item["type"], item["subject"]) for item in page["items"] if item["subject"] in subjects]


def data(live: LiveRig, kind: str) -> list[dict[str, Any]]:
    items = live.daemon.get("/events?after=0&limit=1000")["items"]
    return [item["data"] for item in items if item["type"] == kind]


@pytest.mark.full  # its delays are those of the plant
def test_a_lost_camera_is_an_alarm_until_it_is_back(live: LiveRig):
    live.camera("c02").unplug()
    eventually(lambda: alarms(live) == {"camera:c02": "unacknowledged"}, "the alarm is raised")
    (alarm,) = live.daemon.get("/alarms")["items"]
    assert (alarm["priority"], "switch port" in alarm["action"]) == ("medium", True)
    assert live.status("c02")["ne107"] == "failure"
    assert live.status("c03")["ne107"] == "good"
    at = alarm["raised_at"].replace("T", " ").partition(".")[0]
    words = ["--acknowledge", str(alarm["id"]), "--language", "de"]
    done = CliRunner().invoke(
        build_app(["alarms"]), ["alarms", *words, "--url", live.daemon.url("").removesuffix("/api/v1")]
    )
    assert done.exit_code == 0, done.output
    assert f"{alarm['id']}  medium  camera:c02  acknowledged; raised {at} UTC\n" in done.stdout
    assert "-> Stromversorgung, Kabel und Switch-Port prüfen" in done.stdout
    assert done.stdout.endswith("1 alarms\n")
    live.camera("c02").replug()
    eventually(lambda: alarms(live) == {}, "the alarm is gone")
    told = [(f"alarm.{word}", "camera:c02") for word in ("raised", "acknowledged", "cleared")]
    eventually(
        lambda: events(live, "camera:c02") == told, "all of it is among the events"
    )  # written after it
    (ended,) = live.daemon.get("/alarms/history?check=camera:c02")["items"]
    assert (ended["state"], ended["occurrences"]) == ("normal", 1)
    words = [each["ne107"] for each in data(live, "health.changed")]
    assert "maintenance_required" in words
    states = [each["state"] for each in data(live, "acquisition.changed")]
    assert states[:2] == ["arming", "armed"]


@pytest.mark.full
def test_a_dead_switch_is_one_alarm(live: LiveRig):
    for camera in live.rig.cameras.values():
        camera.unplug()
    eventually(lambda: "cameras" in alarms(live), "the alarm is raised")
    eventually(lambda: len(live.daemon.get("/alarms")["suppressed"]) == 16, "the cameras' are suppressed")
    assert alarms(live) == {"cameras": "unacknowledged"}
    for camera in live.rig.cameras.values():
        camera.replug()
    eventually(lambda: alarms(live) == {"cameras": "returned"}, "the alarm has returned")
    eventually(lambda: live.daemon.get("/alarms")["suppressed"] == [], "all cameras are back")
    told = [("alarm.raised", "cameras"), ("alarm.cleared", "cameras")]
    eventually(lambda: events(live, "cameras") == told, "both are among the events")
    of_cameras = events(live, *(f"camera:c{number:02d}" for number in range(1, 17)))
    assert len(of_cameras) == 3  # of the first test
    states = [each["state"] for each in data(live, "acquisition.changed")]
    assert states[:4] == ["arming", "armed", "held", "armed"]
