"""`stonefall doctor` on a simulated rig: broken, whole with a test pulse, and while the daemon has it."""

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest
from support import broken_host
from support.broken_host import Tree
from support.daemon_process import STONEFALL
from support.live_rig import eventually, live_rig, live_section, simulated_rig
from support.small_recording import write_small_recording
from support.warm_stonefall import run_stonefall

from drivers.gige_simulator.personalities import PERSONALITIES

LINE2 = 1
"""Bank of Line2 among the registers of the lines."""


def doctor(config: Path, *more: str | Path) -> tuple[int, dict[str, Any]]:
    """Return the exit code, and the findings by subject."""
    done = run_stonefall("doctor", "--config", config, "--json", *more)
    assert done.stdout, done.stderr
    return done.returncode, {
        finding["subject"]: finding for part in json.loads(done.stdout).values() for finding in part
    }


def test_each_planted_fault_is_named_with_its_remedy() -> None:
    assert len(broken_host.FAULTS) >= 10
    assert broken_host.main() == 0


@pytest.mark.full
def test_a_whole_rig_exposes_at_the_test_pulse(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "source", n_stones=1)
    config = tmp_path / "stonefall.toml"
    with simulated_rig(tmp_path, tmp_path / "source", number=4) as rig:
        section = live_section(rig, tmp_path, tmp_path / "source")
        rest = '[spool]\ndir = "/run/stonefall"\n[store]\ndir = "state"\nretention.min_free_gb = 0.0\n[api]\nport = 1\n'
        config.write_text(section + rest)
        tree = Tree(tmp_path / "host", port="lo", gate=str(tmp_path / "gate"))
        for _ in range(
            3
        ):  # a machine with no time for heartbeats loses cameras, which the next look finds again
            code, found = doctor(config, "--pulse", "--root", tree.root)
            if code == 0:
                break
        assert [finding for finding in found.values() if finding["verdict"] == "fault"] == []
        assert code == 0
        assert found["cameras"]["found"] == "16 of 16 answer"
        assert found["test pulse"]["found"] == "16 of 16 cameras exposed"
        assert found["light"]["found"] == "all views are lit"

        config.write_text(
            section.replace('interfaces = ["127.0.0.1"]', 'interfaces = ["198.51.100.9"]') + rest
        )
        code, found = doctor(config, "--root", tree.root)
        assert code == 1
        assert "it answers at 127." in found["camera c01"]["found"]
        assert found["port of 198.51.100.9"]["remedy"]


@pytest.mark.full
def test_cameras_of_seven_vendors_are_set_alike_and_what_was_left_on_is_told(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "source", n_stones=1)
    config = tmp_path / "stonefall.toml"
    vendors = tuple(PERSONALITIES)
    delayed = {"vendors": vendors, "timer_ms": 247.2}
    with simulated_rig(tmp_path, tmp_path / "source", number=6, **delayed) as rig:
        rest = '[spool]\ndir = "/run/stonefall"\n[store]\ndir = "state"\nretention.min_free_gb = 0.0\n[api]\nport = 1\n'
        config.write_text(
            live_section(rig, tmp_path, tmp_path / "source", more="packet_size_bytes = 1500") + rest
        )
        tree = Tree(tmp_path / "host", port="lo", gate=str(tmp_path / "gate"))
        code, found = doctor(config, "--root", tree.root)
        assert code == 1
        fault = found["settings of c02"]  # whose delay is too short for the fall
        assert "cannot set TriggerDelay to 24735" in fault["found"]
        assert "let gate or timer make the delay (rig.delay)" in fault["found"]
        assert found["settings of cameras"]["found"] == "13 of 16 are set as configured"  # three are FLIR's
        put_back = {
            camera.design.ways.resembles: found[f"settings of {name}"]["found"]
            for name, camera in rig.cameras.items()
        }
        assert (
            "acA1300-60gm: ChunkModeActive was True: put back to False; ReverseX was True"
            in put_back["Basler"]
        )
        assert "GevHeartbeatTimeout was 300000: put back to 3000" in put_back["Basler"]
        assert "has no FrameStart in TriggerSelector: FrameBurstStart is used" in put_back["Hikrobot"]
        assert "LUTEnable was True: put back to False" in put_back["Daheng"]
        assert "ExposureMode was TriggerWidth: put back to Timed" in put_back["JAI"]
        assert "has no Mono8 in PixelFormat: Mono12p is used" in put_back["The Imaging Source"]
        assert "GammaEnable was True: put back to False" in put_back["Lucid"]

        more = "packet_size_bytes = 1500\ndelay_outside_ms = 247.2"
        config.write_text(live_section(rig, tmp_path, tmp_path / "source", more=more) + rest)
        for _ in range(3):  # as above
            code, found = doctor(config, "--pulse", "--root", tree.root)
            if code == 0:
                break
        assert [finding for finding in found.values() if finding["verdict"] == "fault"] == []
        assert found["test pulse"]["found"] == "16 of 16 cameras exposed"
        assert not any("put back" in finding["found"] for finding in found.values())  # told once


@pytest.mark.full
def test_the_light_is_compared_with_and_without_the_flash(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "source", n_stones=1)
    config = tmp_path / "stonefall.toml"
    with simulated_rig(tmp_path, tmp_path / "source", number=8, strobe_line="Line2") as rig:

        def flash(line: str) -> dict[str, Any]:
            """Return the finding when the configuration says that this line fires the light."""
            section = live_section(rig, tmp_path, tmp_path / "source", more=f'strobe_line = "{line}"')
            config.write_text(
                f'{section}[spool]\ndir = "/run/stonefall"\n[store]\ndir = "state"\n[api]\nport = 1\n'
            )
            _, found = doctor(config, "--pulse")
            assert found["test pulse"]["found"] == "16 of 16 cameras exposed"
            return found["flash"]

        def n_flashing() -> int:
            """Return how many cameras fire the light with their exposures."""
            cameras = rig.cameras.values()
            active = [camera.features["LineSource"].entries["ExposureActive"] for camera in cameras]
            return [camera.feature("LineSource", LINE2) for camera in cameras].count(active[0])

        unwired = flash("Line3")
        assert unwired["verdict"] == "fault"
        assert unwired["found"] == "all 16 views: 0 grey levels with it, 0 without"
        assert "check the wire from the cameras' output" in unwired["remedy"]

        good = flash("Line2")
        assert good["verdict"] == "good"
        assert good["found"].endswith(" grey levels with it, 0 without")
        assert "all 16 views" in good["found"]
        assert n_flashing() == 16
        killed = subprocess.Popen([STONEFALL, "doctor", "--config", config, "--pulse"])
        eventually(lambda: n_flashing() == 0, "exposures without the flash")
        killed.kill()
        killed.wait()
        eventually(lambda: n_flashing() == 16, "the process of the cameras gives the flash back")

        other = flash("Line3")  # the cameras still fire it at Line2, as the last configuration said
        assert other["verdict"] == "fault"
        assert "another output fires them" in other["remedy"]


@pytest.mark.full
def test_a_running_daemon_is_asked_and_keeps_its_devices(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "source", n_stones=1)
    with live_rig(tmp_path, tmp_path / "source", number=5) as live:
        config, url = live.daemon.config_path, live.daemon.url("").removesuffix("/api/v1")
        code, found = doctor(config, "--pulse", "--url", url)
        assert found["daemon"]["verdict"] == "good"
        assert "camera c01" not in found
        assert found["test pulse"]["verdict"] == "unknown"
        silent, said = doctor(config, "--url", "http://127.0.0.1:1")
        assert silent == 1
        assert "journalctl" in said["daemon"]["remedy"]

        live.rig.cameras["c03"].unplug()
        live.daemon.check("camera:c03", lambda check: check["status"] == "fail")
        code, found = doctor(config, "--url", url)
        assert code == 1
        assert "switch port" in found["camera:c03"]["remedy"]
        assert live.daemon.get("/acquisition")["state"] == "armed"
