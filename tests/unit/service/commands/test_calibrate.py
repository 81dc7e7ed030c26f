"""`stonefall calibrate` on a small rendered recording: a quarter of the pixels in each direction."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from support.small_recording import thumbnail_rig
from support.synthetic_rigs import rig_of
from typer.testing import CliRunner, Result

from drivers.files.rig_file import read_rig, write_rig
from pipeline.errors import CalibrationError
from pipeline.evaluation.scene import rig_error
from pipeline.rig.cameras import rig_to_document
from pipeline.rig.design import nominal_rig
from service.base.errors import UsageError
from service.commands import synthesize
from service.commands.cli import build_app


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with `balls`, a recording of eight drops, and `nominal.json`, the design of its rig."""
    path = tmp_path_factory.mktemp("calibrate")
    write_rig(path / "nominal.json", rig_of(*nominal_rig().camera_ids, binning=4))
    write_rig(path / "true.json", thumbnail_rig())
    synthesize.command(path / "balls", bodies="ball", count=8, seed=3, rig=path / "true.json", backgrounds=3)
    return path


def run(folder: Path, *arguments: str, initial: str = "nominal.json", out: str = "rig.json") -> Result:
    return CliRunner().invoke(
        build_app(["calibrate"]),
        [
            "calibrate",
            str(folder / "balls"),
            *("--initial", str(folder / initial)),
            *("--out", str(folder / out)),
            *arguments,
        ],
    )


def report_of(result: Result) -> dict[str, Any]:
    report: dict[str, Any] = json.loads(result.stdout)
    return report


def as_a_program_reads_it(problems: list[Mapping[str, Any]]) -> set[tuple[str, bool]]:
    return {(problem["code"], problem["is_fatal"]) for problem in problems}


def test_balls_calibrate_the_rig(folder: Path) -> None:
    result = run(folder, "--ball-diameter-mm", "10", "--json", out="new/rig.json")
    assert result.exit_code == 0, result.stderr
    report = report_of(result)
    assert report["is_acceptable"]
    assert report["scale"] == "ball_diameter"
    assert min(report["residuals_before_px"].values()) > 1
    assert max(report["residuals_after_px"].values()) < 0.1
    assert report["held_out_px"] < 0.1
    assert report["coverage"]["n_drops"] == 8
    written = read_rig(folder / "new" / "rig.json")
    assert written.calibration_id == report["calibration_id"]
    assert (written.method, written.ball_diameter_mm, written.name) == ("bundle", 10, "rig")
    # 0.05 px of 26 px radius
    assert rig_error(written, thumbnail_rig()).length_percent < 0.2


@pytest.mark.full
def test_the_report_for_people(folder: Path) -> None:
    result = run(folder, "--ball-diameter-mm", "10", "--workers", "1")
    assert result.exit_code == 0, result.stderr
    assert "c16" in result.stdout
    assert "scale: from the diameter of the ball" in result.stdout
    assert "drops not used in the fit: 0.0" in result.stdout


@pytest.mark.full
def test_without_a_diameter_the_scale_is_said_to_be_unknown(folder: Path) -> None:
    result = run(folder, "--json")
    assert result.exit_code == 0, result.stderr
    report = report_of(result)
    assert report["scale"] == "not_observable"
    assert as_a_program_reads_it(report["problems"]) == {("scale_not_observable", False)}


@pytest.mark.full
def test_a_wrong_diameter_is_refused_unless_forced(folder: Path) -> None:
    wrong = ("--ball-diameter-mm", "10.5263", "--json")
    refused = run(folder, *wrong, out="refused.json")
    assert refused.exit_code == 1
    assert isinstance(refused.exception, UsageError)
    assert "was not written: the ball's diameter is wrong" in str(refused.exception)
    assert "likely it is 10.0" in str(refused.exception) or "likely it is 9.9" in str(refused.exception)
    assert ("wrong_diameter", True) in as_a_program_reads_it(report_of(refused)["problems"])
    assert not (folder / "refused.json").exists()
    forced = run(folder, *wrong, "--force", out="forced.json")
    assert forced.exit_code == 0
    assert read_rig(folder / "forced.json").ball_diameter_mm == 10.5263


@pytest.mark.full
def test_swapped_cameras_in_the_rig_file_are_named(folder: Path) -> None:
    document = rig_to_document(read_rig(folder / "nominal.json"))
    del document["checksum"]
    cameras = document["cameras"]
    for key in set(cameras[0]) - {"id"}:
        cameras[4][key], cameras[10][key] = cameras[10][key], cameras[4][key]
    (folder / "swapped.json").write_text(json.dumps(document))
    result = run(folder, "--ball-diameter-mm", "10", "--json", initial="swapped.json", out="swapped-out.json")
    assert result.exit_code == 1
    assert isinstance(result.exception, CalibrationError)
    assert "cameras c05 and c11 are swapped" in str(result.exception)
    assert as_a_program_reads_it(report_of(result)["problems"]) == {("cameras_swapped", True)}
    assert not (folder / "swapped-out.json").exists()


@pytest.mark.full
def test_one_size_entered_as_two_is_refused(folder: Path) -> None:
    result = run(folder, "--ball-diameter-mm", "10", "--ball-diameter-mm", "15")
    assert isinstance(result.exception, CalibrationError)
    assert "do not show two sizes" in str(result.exception)


def test_a_recording_without_the_empty_rig_is_refused(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "balls" / "bundles").mkdir(parents=True)
    for path in (folder / "balls").iterdir():
        if path.is_file():
            (tmp_path / "balls" / path.name).write_bytes(path.read_bytes())
    for path in (folder / "balls" / "bundles").glob("*-ball.tiff"):
        (tmp_path / "balls" / "bundles" / path.name).symlink_to(path)
    (tmp_path / "nominal.json").write_bytes((folder / "nominal.json").read_bytes())
    result = run(tmp_path, "--ball-diameter-mm", "10")
    assert isinstance(result.exception, UsageError)
    assert "has no exposure of the empty rig" in str(result.exception)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--ball-diameter-mm", "100"], "must be 1 to 45"),
        ([f"--ball-diameter-mm={d}" for d in (5, 10, 15)], "give one diameter, or two"),
        (["--method", "magic"], "'magic' is not one of"),
        (["--method", "stones", "--ball-diameter-mm", "10"], "method stones cannot tell the scale"),
    ],
)
def test_wrong_usage(folder: Path, arguments: list[str], message: str) -> None:
    result = run(folder, *arguments)
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
