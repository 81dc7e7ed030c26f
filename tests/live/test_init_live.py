"""`stonefall init` on a terminal, with simulated cameras that answer: what is said becomes the file."""

import os
import pty
import re
import subprocess
from pathlib import Path

from support.daemon_process import STONEFALL
from support.live_rig import simulated_rig
from support.small_recording import write_small_recording
from support.warm_stonefall import run_stonefall

from drivers.files.rig_file import read_rig, write_rig
from service.configuration.rig_settings import AravisRigSettings
from service.configuration.settings import load_settings


def test_what_is_asked_for_becomes_the_configuration(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "source", n_stones=1)
    rig_file = read_rig(tmp_path / "source" / "rig.json")
    write_rig(tmp_path / "rig.json", rig_file)
    config = tmp_path / "stonefall.toml"
    ours, theirs = pty.openpty()
    with simulated_rig(tmp_path, tmp_path / "source", number=6) as rig:
        expected = {camera.design.id: camera.design.serial for camera in rig.cameras.values()}
        interfaces, gate, density = "127.0.0.1", str(tmp_path / "gate"), "2700"
        light = ["Line2", "2700", "15"]  # a flash longer than the exposure is asked for again
        # typed, as cameras of other tests may answer as well, and be suggested
        serials = [expected[place] for place in rig_file.camera_ids]
        os.write(ours, "\n".join([interfaces, *serials, gate, *light, density, ""]).encode())
        done = subprocess.run(
            [
                STONEFALL,
                "init",
                config,
                "--store",
                tmp_path / "state",
                "--spool",
                tmp_path / "spool",
                "--simulated",
            ],
            stdin=theirs,
            capture_output=True,
            text=True,
            timeout=100,
            check=False,
        )
        os.close(ours)
        os.close(theirs)
        answering = re.search(r"(\d+) cameras answer", done.stdout)
        assert answering and int(answering[1]) >= len(expected) == 16, done
    assert done.returncode == 0, done
    settings = load_settings(config)
    assert isinstance(settings.rig, AravisRigSettings)
    assert {camera.id: camera.serial for camera in settings.rig.cameras} == expected
    assert settings.rig.interfaces == ("127.0.0.1",)
    assert (settings.rig.strobe_line, settings.rig.flash_us) == ("Line2", 15)
    assert settings.measuring.density_kg_m3 == 2700
    checked = run_stonefall("check-config", config)
    assert checked.returncode == 0, checked
