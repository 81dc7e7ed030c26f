"""`stonefall init` from options: what it writes passes `check-config`, or it says what is missing."""

import json
import tomllib
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


@pytest.mark.parametrize(
    ("ports_mbit_s", "option", "uplink_bytes_s", "delay_ns"),
    [
        ([10_000], (), 1.25e9, 51_300),
        ([10_000, 10_000], (), 2.5e9, 0),
        ([10_000, -1], (), None, 0),  # a virtual port does not say it
        ([], ("--uplink", "10"), 1.25e9, 51_300),
    ],
)
def test_the_packet_delay_is_what_the_uplink_of_the_cameras_needs_and_check_config_shows_it(
    ports_mbit_s: list[int],
    option: tuple[str, ...],
    uplink_bytes_s: float | None,
    delay_ns: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    route = "Iface Destination Gateway Flags RefCnt Use Metric Mask MTU Window IRTT\n"
    for number, speed in enumerate(ports_mbit_s):
        port = tmp_path / f"sys/class/net/cams{number}"
        port.mkdir(parents=True)
        (port / "speed").write_text(f"{speed}\n")
        route += f"cams{number} 00004D0A 00000000 0001 0 0 0 00FFFFFF 0 0 0\n"
    (tmp_path / "proc/net").mkdir(parents=True)
    (tmp_path / "proc/net/route").write_text(route)
    monkeypatch.setattr(init, "ROOT", tmp_path)
    assert complete(tmp_path, "--flash-us", "20", *option).exit_code == 0
    file = tmp_path / "stonefall.toml"
    rig = load_settings(file).rig
    assert isinstance(rig, AravisRigSettings)
    assert (rig.uplink_bytes_s, rig.packet_delay_ns) == (uplink_bytes_s or 2.5e9, delay_ns)
    assert ("\n# uplink_bytes_s = " in file.read_text()) == (uplink_bytes_s is None)
    checked = CliRunner().invoke(build_app(["check-config"]), ["check-config", str(file)])
    assert (checked.exit_code, checked.stderr) == (0, "")
    assert f"packet_delay_ns = {delay_ns}\n" in checked.stdout
    assert f"a bundle is {19.0 if delay_ns else 10.6} ms on the wire" in checked.stdout
    assert "# two stones 247 ms apart: carried" in checked.stdout
    tomllib.loads(checked.stdout)
    document = CliRunner().invoke(build_app(["check-config"]), ["check-config", str(file), "--json"])
    network = json.loads(document.stdout)["network"]
    assert [round(each["rate_hz"]) for each in network] == [4, 4, 10, 13]
    assert all(each["is_carried"] for each in network)


@pytest.mark.parametrize("gbit_s", ["10", "20"])
def test_frames_over_a_shared_uplink_fit_the_short_window_of_a_gate_that_makes_the_delay(
    gbit_s: str, tmp_path: Path
) -> None:
    assert complete(tmp_path, "--flash-us", "20", "--delay", "gate", "--uplink", gbit_s).exit_code == 0
    words = ["check-config", str(tmp_path / "stonefall.toml")]
    checked = CliRunner().invoke(build_app(["check-config"]), words)
    assert (checked.exit_code, checked.stderr) == (0, "")
    assert "# two stones 25 ms apart: carried" in checked.stdout


def test_doctor_names_a_network_that_loses_bundles_in_the_switch(tmp_path: Path) -> None:
    complete(tmp_path, "--uplink", "10", "--interface", "127.0.0.1")
    file = tmp_path / "stonefall.toml"

    def found(delay_ns: int) -> dict[str, str]:
        file.write_text(file.read_text().replace("packet_delay_ns = 51300", f"packet_delay_ns = {delay_ns}"))
        words = ["doctor", "--config", str(file), "--root", str(tmp_path), "--json"]
        said = json.loads(CliRunner().invoke(build_app(["doctor"]), words).stdout)
        (network,) = [each for each in said["configuration"] if each["subject"] == "network of the cameras"]
        return dict(network)

    assert found(51_300)["verdict"] == "good"
    assert found(0)["verdict"] == "fault"
    assert found(0)["found"] == "a bundle is 17.0 ms on the wire, 8.13 MB of it wait in the switch"


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
    assert rig.gate.serial is not None
    assert rig.gate.serial.debounce_us == 1000  # a pulse of an edge that is merged here would be nobody's


def test_the_installed_example_is_replaced_while_nothing_of_the_site_is_in_it(tmp_path: Path) -> None:
    file = tmp_path / "stonefall.toml"
    example = (DEPLOY / "stonefall.toml").read_text()
    for mine in (
        example.replace("SERIAL-07", "4711"),
        example.replace("# keep_raw =", "keep_raw = 7  #"),
        example.replace("by-id/usb-gate", "by-id/usb-ours"),
    ):
        assert mine != example
        file.write_text(mine)
        assert "--force replaces it" in str(complete(tmp_path).exception)
        assert file.read_text() == mine
    file.write_text(example)
    assert complete(tmp_path).exit_code == 0
    assert "S-c07" in file.read_text()
