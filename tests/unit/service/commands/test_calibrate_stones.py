"""`stonefall calibrate --method stones`: corrects the pose of a bumped camera."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from support.outlines import bumped
from support.small_recording import thumbnail_rig, write_small_recording
from typer.testing import CliRunner, Result

from drivers.files.rig_file import read_rig, write_rig
from pipeline.errors import CalibrationError
from pipeline.views.epipolar_tangency import ALARM_PX
from service.commands.calibrate import command

N_STONES = 21


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stones") / "recording"
    write_small_recording(path, n_stones=N_STONES)
    return path


@pytest.fixture
def wrong_rig(tmp_path: Path) -> Path:
    """Return a rig file that is wrong about the pose of camera c05."""
    path = tmp_path / "wrong.json"
    write_rig(path, bumped(thumbnail_rig(), "c05", np.array([0.4, -0.3, 0.0])))
    return path


def calibrate(*arguments: str | Path) -> Result:
    app = typer.Typer()
    app.command()(command)
    return CliRunner().invoke(app, [*map(str, arguments), "--method", "stones", "--workers", "1"])


def test_the_camera_that_was_hit_is_put_back(recording: Path, wrong_rig: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "rig.json"
    result = calibrate(recording, "--initial", wrong_rig, "--out", out, "--json")
    assert result.exit_code == 0, result.output
    report = json.loads(result.stdout)
    assert report["is_acceptable"]
    assert report["moved"].keys() == {"c05"}
    assert report["tangency_before_px"]["c05"] > 5
    assert max(report["tangency_after_px"].values()) < ALARM_PX
    assert (report["stones_fitted"], report["stones_judging"]) == (17, 4)
    made, true = read_rig(out), thumbnail_rig()
    assert made.calibration_id == report["calibration_id"]
    points_mm = np.random.default_rng(1).uniform(-7, 7, size=(50, 3))
    errors_px = made.cameras[4].project(points_mm)[0] - true.cameras[4].project(points_mm)[0]
    assert np.linalg.norm(errors_px, axis=1).mean() < 0.2


def test_people_get_a_table(recording: Path, wrong_rig: Path, tmp_path: Path) -> None:
    result = calibrate(recording, "--initial", wrong_rig, "--out", tmp_path / "rig.json")
    assert result.exit_code == 0, result.output
    assert "scale: not observable; lengths are those of the initial rig" in result.stdout
    turned = re.findall(r"(c\d\d) .* (0\.\d{3}) .* (\d\.\d{3})", result.stdout)
    assert [camera for camera, _, _ in turned] == ["c05"]  # all others stay
    assert float(turned[0][1]) == pytest.approx(0.5, abs=0.1)


def test_too_few_stones_are_refused(wrong_rig: Path, tmp_path: Path) -> None:
    write_small_recording(tmp_path / "few", n_stones=2)
    out = tmp_path / "rig.json"
    result = calibrate(tmp_path / "few", "--initial", wrong_rig, "--out", out)
    assert isinstance(result.exception, CalibrationError)
    assert "2 stones with usable silhouettes are too few: let at least 20 fall" in str(result.exception)
    assert not out.exists()
