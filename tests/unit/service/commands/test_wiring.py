"""The wiring page: one page with all of a rig's connections, and lines to write on for what is not known yet."""

from io import BytesIO
from pathlib import Path

import pytest
from pypdf import PdfReader
from typer.testing import CliRunner

from service.base.language import Language
from service.commands.cli import build_app
from service.commands.wiring import rig_wiring
from service.reports.wiring import GateKind, WiredGate
from service.reports.wiring_sheet import BLANK, BOX, wiring_document

PLACES = [f"c{number:02d}" for number in range(1, 17)]
DEPLOY = Path(__file__).parents[4] / "deploy"
RIG = """
[rig]
backend = "aravis"
calibration = "rig.json"
interfaces = [{interfaces}]
trigger = "{trigger}"
{more}
[rig.gate.{gate}]
"""


def page_of(file: Path, language: Language = Language.ENGLISH) -> str:
    done = CliRunner().invoke(
        build_app(["init"]), ["init", str(file), "--wiring", "--language", language.value]
    )
    assert done.exit_code == 0, done.output
    assert (file.parent / "wiring.svg").read_bytes().startswith(b"<svg")
    (page,) = PdfReader(BytesIO((file.parent / "wiring.pdf").read_bytes())).pages
    return page.extract_text().replace("\u00a0", " ")


def written(folder: Path, gate: str, *, interfaces: str = "", trigger: str = "Line1", more: str = "") -> Path:
    file = folder / "rig.toml"
    file.write_text(RIG.format(gate=gate, interfaces=interfaces, trigger=trigger, more=more))
    return file


@pytest.mark.parametrize("language", Language)
def test_one_page_has_each_camera_with_its_place_address_lines_and_boxes(
    language: Language, tmp_path: Path
) -> None:
    cameras = [word for place in PLACES for word in ("--camera", f"{place}=DA-{place}")]
    rig = ["--gate", "/dev/serial/by-id/usb-ours", "--interface", "10.77.0.1", "--uplink", "10"]
    light = ["--strobe-line", "Line2", "--flash-us", "15", "--delay", "gate"]
    file = tmp_path / "stonefall.toml"
    folders = ["--store", str(tmp_path / "state"), "--spool", str(tmp_path / "spool")]
    CliRunner().invoke(build_app(["init"]), ["init", str(file), *cameras, *rig, *light, *folders])
    before = file.read_bytes()
    text = page_of(file, language)
    assert file.read_bytes() == before  # a configuration that is there stays
    for number, place in enumerate(PLACES, 1):
        assert f"DA-{place}" in text
        assert f"10.77.0.{10 + number} (" in text  # proposed
        assert f"{BOX} {number} {BOX} Line1 {BOX} Line2" in " ".join(text.split())
    assert text.count(f"{BOX} Line1") == text.count(f"{BOX} Line2") == 16
    for said in ("D8", "D9", "51.3 µs", "247.4 ms", "1 124 MB/s", "/dev/serial/by-id/usb-ours"):
        assert (said if language is Language.ENGLISH else said.replace(".", ",", 1)) in text or said in text
    assert BLANK not in text


def test_the_installed_example_has_lines_to_write_on(tmp_path: Path) -> None:
    (tmp_path / "stonefall.toml").write_bytes((DEPLOY / "stonefall.toml").read_bytes())
    text = page_of(tmp_path / "stonefall.toml")
    assert text.count(BLANK) == 16 + 16 + 1 + 1  # serial numbers, addresses, the gate's port, this machine
    assert "SERIAL" not in text


def test_options_beside_it_are_for_the_file_as_well(tmp_path: Path) -> None:
    """An output for the light, given with the page of the installed example, was left out of both."""
    file = tmp_path / "stonefall.toml"
    file.write_bytes((DEPLOY / "stonefall.toml").read_bytes())
    file.chmod(0o640)

    def run(*more: str) -> int:
        return CliRunner().invoke(build_app(["init"]), ["init", str(file), "--wiring", *more]).exit_code

    assert run("--strobe-line", "Line2") == 1  # cameras and gate are missing still
    assert page_of(file).count(f"{BOX} Line2") == 16
    assert file.stat().st_mode & 0o777 == 0o640
    assert run("--strobe-line", "Line3") == 1, "a file that is no example is not changed"
    assert page_of(file).count(f"{BOX} Line2") == 16


def test_layers_and_azimuths_are_those_of_the_rig(tmp_path: Path) -> None:
    rig = rig_wiring(written(tmp_path, 'serial]\nport = "/dev/gate"\n[plant'), Language.ENGLISH)
    assert [(each.place, each.layer, each.azimuth_deg) for each in rig.cameras[3:6]] == [
        ("c04", 1, 270),
        ("c05", 2, 45),
        ("c06", 2, 135),
    ]
    assert {each.layer for each in rig.cameras} == {1, 2, 3, 4}


def test_addresses_are_proposed_in_the_networks_of_this_machine_and_none_twice(tmp_path: Path) -> None:
    more = 'cameras = [{id = "c02", address = "10.77.0.11"}]'
    file = written(
        tmp_path, 'serial]\nport = "/dev/gate"\n[plant', interfaces='"10.77.0.12", "10.78.0.1"', more=more
    )
    cameras = rig_wiring(file, Language.ENGLISH).cameras
    addresses = [str(each.address) for each in cameras]
    assert addresses[:3] == ["10.77.0.13", "10.77.0.11", "10.77.0.14"]
    assert [each.is_address_proposed for each in cameras[:3]] == [True, False, True]
    assert {address.rpartition(".")[0] for address in addresses[8:]} == {"10.78.0"}
    assert len(set(addresses) | {"10.77.0.12", "10.78.0.1"}) == 18


@pytest.mark.parametrize(
    ("gate", "wired"),
    [
        (
            'modem_line]\nport = "/dev/m"\nline = "DSR"\n[plant',
            WiredGate(kind=GateKind.MODEM_LINE, port="/dev/m", line="DSR", delay_maker="camera"),
        ),
        (
            'gpio]\nchip = "/dev/gpiochip0"\nline = 4\ntest_line = 5\n[plant',
            WiredGate(
                kind=GateKind.GPIO, port="/dev/gpiochip0", line="4", test_line="5", delay_maker="camera"
            ),
        ),
    ],
)
@pytest.mark.parametrize("trigger", ["Line1", "action"])
def test_every_kind_of_gate_is_drawn(gate: str, wired: WiredGate, trigger: str, tmp_path: Path) -> None:
    rig = rig_wiring(written(tmp_path, gate, trigger=trigger), Language.GERMAN)
    assert rig.gate == wired
    assert {each.trigger for each in rig.cameras} == ({"Line1"} if trigger == "Line1" else {None})
    tables = wiring_document(rig).sections[2].blocks
    assert any(wired.line in row[0] for row in tables[0].rows)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ('strobe_line = "Line2"', ("Output Line2", "opto-isolated input of the light's driver")),
        ('flash_us = 12.0\ndelay = "gate"', ("D10", "opto-isolated input of the light's driver")),
        ("flash_us = 12.0", ("Light panels with driver", "fired by something else; flash_us says how long")),
        ("", ("Light panels with driver", "always on: no output fires them")),
    ],
)
def test_it_says_what_fires_the_light(more: str, said: tuple[str, str], tmp_path: Path) -> None:
    rig = rig_wiring(written(tmp_path, 'serial]\nport = "/dev/gate"\n[plant', more=more), Language.ENGLISH)
    (table,) = wiring_document(rig).sections[2].blocks
    assert [tuple(row[:2]) for row in table.rows if said[1] in row[1]] == [said]


def test_what_is_no_live_rig_has_no_wiring(tmp_path: Path) -> None:
    for text, why in (
        ('[rig]\nbackend = "replay"', 'rig.backend is not "aravis"'),
        ("[rig", "rig.toml: "),
        ('[rig]\nbackend = "aravis"\ncalibration = "r"\nexposure_us = 0', "rig: exposure_us must be"),
        (
            '[rig]\nbackend = "aravis"\ncalibration = "r"\n[[rig.cameras]]\nid = "x9"\nserial = "7"',
            "x9: no place of",
        ),
    ):
        (tmp_path / "rig.toml").write_text(text)
        done = CliRunner().invoke(build_app(["init"]), ["init", str(tmp_path / "rig.toml"), "--wiring"])
        assert why in str(done.exception)
        assert not (tmp_path / "wiring.pdf").exists()
