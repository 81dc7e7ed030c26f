"""`stonefall init` from options: what it writes passes `check-config`, or it says what is missing."""

from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from drivers.files.rig_file import read_rig, write_rig
from pipeline.rig.design import nominal_rig
from service.commands import init
from service.commands.cli import build_app
from service.configuration.live_rig import DelayMaker
from service.configuration.rig_settings import AravisRigSettings
from service.configuration.settings import load_settings, problems

PLACES = [f"c{number:02d}" for number in range(1, 17)]
DEPLOY = Path(__file__).parents[4] / "deploy"


def started(folder: Path, *more: str) -> Result:
    command = [
        "init",
        str(folder / "stonefall.toml"),
        "--store",
        str(folder / "state"),
        "--spool",
        str(folder / "spool"),
    ]
    return CliRunner().invoke(build_app(["init"]), [*command, *more])


def complete(folder: Path, *more: str) -> Result:
    cameras = [word for place in PLACES for word in ("--camera", f"{place}=S-{place}")]
    return started(
        folder, *cameras, "--gate", "/dev/serial/by-id/usb-ours", "--interface", "10.77.0.1", *more
    )


def test_what_it_writes_passes_check_config_and_it_says_what_comes_next(tmp_path: Path) -> None:
    tmp_path /= 'Werk "\U0001d7d9"'
    done = complete(tmp_path, "--product", "8-16", "--density-kg-m3", "2650")
    assert done.exit_code == 0, done.output
    assert "nothing is missing" in done.output
    checked = CliRunner().invoke(
        build_app(["check-config"]), ["check-config", str(tmp_path / "stonefall.toml")]
    )
    assert checked.exit_code == 0, checked.output
    settings = load_settings(tmp_path / "stonefall.toml")
    assert isinstance(settings.rig, AravisRigSettings)
    assert [(camera.id, camera.serial) for camera in settings.rig.cameras] == [
        (place, f"S-{place}") for place in PLACES
    ]
    assert settings.rig.interfaces == ("10.77.0.1",)
    assert settings.rig.gate.device.port == "/dev/serial/by-id/usb-ours"
    assert settings.measuring.density_kg_m3 == 2650
    assert read_rig(tmp_path / "rig.json").calibration_id == nominal_rig().calibration_id
    for step in (
        "doctor --config",
        "calibration start",
        "calibration verify",
        "lots product 8-16 --density-kg-m3 2650",
    ):
        assert step in done.output


def test_the_output_that_fires_the_light_is_entered_and_without_it_check_config_warns(
    tmp_path: Path,
) -> None:
    def checked(*more: str) -> tuple[AravisRigSettings, str]:
        assert complete(tmp_path, "--force", *more).exit_code == 0
        file = tmp_path / "stonefall.toml"
        done = CliRunner().invoke(build_app(["check-config"]), ["check-config", str(file)])
        assert done.exit_code == 0  # a warning is no fault
        rig = load_settings(file).rig
        assert isinstance(rig, AravisRigSettings)
        return rig, done.stderr

    rig, said = checked()
    assert (rig.strobe_line, rig.flash_us) == (None, None)
    assert "warning: rig.strobe_line: no output of the cameras fires the light panels" in said
    assert '\n# strobe_line = "Line2"' in (tmp_path / "stonefall.toml").read_text()
    rig, said = checked("--strobe-line", "Line2", "--flash-us", "15")
    assert (rig.strobe_line, rig.flash_us, said) == ("Line2", 15, "")
    assert complete(tmp_path, "--force", "--flash-us", "25").exit_code == 1  # longer than the exposure


def test_nothing_is_replaced_without_being_told(tmp_path: Path) -> None:
    rig = nominal_rig("2026-01-01T00:00:00Z")
    write_rig(tmp_path / "rig.json", rig)
    (tmp_path / "stonefall.toml").write_text("mine")
    refused = complete(tmp_path)
    assert refused.exit_code == 1
    assert "--force replaces it" in str(refused.exception)
    assert (tmp_path / "stonefall.toml").read_text() == "mine"
    assert complete(tmp_path, "--force").exit_code == 0
    assert read_rig(tmp_path / "rig.json").created_at == rig.created_at


def test_what_is_missing_is_said_and_marked_in_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(init, "GATES", tmp_path / "no-ports")
    done = started(tmp_path, "--camera", "c01=S-1")
    assert done.exit_code == 1
    assert "rig.cameras: no camera for c02, c03" in done.output
    assert "rig.gate: no light gate" in done.output
    text = (tmp_path / "stonefall.toml").read_text()
    assert text.count("MISSING") == 16  # fifteen cameras, and the gate


def test_cameras_from_a_file(tmp_path: Path) -> None:
    table = tmp_path / "cameras.csv"
    rows = [f"{place},,10.77.0.{number}," for number, place in enumerate(PLACES[1:], 12)]
    table.write_text("\n".join(["id,serial,address,user_name", "c01,123,,left", *rows]), encoding="utf-8-sig")
    assert started(tmp_path, "--cameras", str(table), "--gate", "/dev/gate").exit_code == 0
    settings = load_settings(tmp_path / "stonefall.toml")
    assert isinstance(settings.rig, AravisRigSettings)
    first, second, *_ = settings.rig.cameras
    assert (first.serial, first.user_name, first.address) == ("123", "left", None)
    assert (second.serial, second.address) == (None, "10.77.0.12")
    table.write_text("id,serial\nc01,\n")
    wrong = started(tmp_path, "--cameras", str(table), "--force")
    assert "line 2: needs an id of its own" in str(wrong.exception)
    table.write_text("place;number\nc01;7\n")
    wrong = started(tmp_path, "--cameras", str(table), "--force")
    assert "cameras.csv: line 1: must name" not in str(wrong.exception)
    assert "line 2: needs an id of its own, and a serial" in str(wrong.exception)
    table.write_text("where;number\nc01;7\n")
    wrong = started(tmp_path, "--cameras", str(table), "--force")
    assert "cameras.csv: line 1: must name the columns id, not 'where', 'number'" in str(wrong.exception)


@pytest.mark.parametrize(
    ("head", "row", "encoding"),
    [
        ("id;serial;note", "{};00{};near, left", "utf-8"),
        ("id, Serial", "{}, 00{}", "utf-8-sig"),
        ("Kamera\tSeriennummer\tBemerkung", "{}\t00{}\tSüd", "utf-16"),
        ('"sep=|"\nPlace|Serial number', "{}|00{}", "utf-8"),
        ('"ID","User\nname","Serial No."', '"{}",,"00{}"', "cp1252"),
    ],
)
def test_any_spreadsheet_s_file_of_cameras_is_read(
    tmp_path: Path, head: str, row: str, encoding: str
) -> None:
    table = tmp_path / "cameras.csv"
    rows = [row.format(place, 1234 + number) for number, place in enumerate(PLACES)]
    table.write_bytes("\r\n".join([head, *rows, "", ""]).encode(encoding))
    assert started(tmp_path, "--cameras", str(table), "--gate", "/dev/gate").exit_code == 0
    settings = load_settings(tmp_path / "stonefall.toml")
    assert isinstance(settings.rig, AravisRigSettings)
    assert [camera.serial for camera in settings.rig.cameras] == [f"00{1234 + n}" for n in range(len(PLACES))]
    assert {(camera.user_name, camera.address) for camera in settings.rig.cameras} == {(None, None)}


@pytest.mark.parametrize("serial", ["1,23457E+11", "4.00E+12"])
def test_a_serial_that_a_spreadsheet_rounded_is_no_serial(tmp_path: Path, serial: str) -> None:
    (tmp_path / "cameras.csv").write_text(f"id;serial\nc01;{serial}\n")
    done = started(tmp_path, "--cameras", str(tmp_path / "cameras.csv"), "--gate", "/dev/gate")
    assert f"cameras.csv: line 2: serial {serial} was rounded by a spreadsheet" in str(done.exception)
    assert not (tmp_path / "stonefall.toml").exists()


@pytest.mark.parametrize(
    ("option", "problem"),
    [("c01", "must be PLACE=SERIAL"), ("c99=1", "c99: no place of the rig, which has c01")],
)
def test_wrong_options_change_nothing(option: str, problem: str, tmp_path: Path) -> None:
    done = started(tmp_path, "--camera", option)
    assert done.exit_code == 1
    assert problem in str(done.exception)
    assert not (tmp_path / "stonefall.toml").exists()


def test_placeholders_of_the_example_are_refused(tmp_path: Path) -> None:
    found = list(problems(load_settings(DEPLOY / "stonefall.toml")))
    assert any("c01, c02" in each and "SERIAL-... are placeholders" in each for each in found)
    assert any("usb-gate is a placeholder" in each for each in found)
    served = CliRunner().invoke(build_app(["serve"]), ["serve", "--config", str(DEPLOY / "stonefall.toml")])
    assert served.exit_code == 1
    assert "placeholders" in str(served.exception)
    assert not any("placeholder" in each for each in problems(load_settings(DEPLOY / "simulated.toml")))


def test_what_makes_the_delay_can_be_said(tmp_path: Path) -> None:
    assert complete(tmp_path, "--delay", "gate").exit_code == 0
    rig = load_settings(tmp_path / "stonefall.toml").rig
    assert isinstance(rig, AravisRigSettings)
    assert (rig.delay, rig.gate_delay_us, rig.camera_delay_ms) == (DelayMaker.GATE, 247_352, 0.0)
