"""What `stonefall doctor` makes of the gate, and of the light of the views, with the flash and without."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from support.pty_gate import serial_gate

from drivers.gates.gate_protocol import FIRMWARE_NAME, FIRMWARE_VERSION
from drivers.gates.gate_records import Identity
from drivers.gates.serial_gate import SerialGateSettings
from pipeline.frames import CameraId
from service.commands.doctor_rig import check_gate, judge_flash
from service.host.finding import Finding, HostVerdict

C1, C2, C3 = map(CameraId, ("c01", "c02", "c03"))


def judged(lit: tuple[float, ...], unlit: tuple[float, ...]) -> Finding:
    return judge_flash(dict(zip((C1, C2, C3), lit, strict=True)), dict(zip((C1, C2, C3), unlit, strict=True)))


@pytest.mark.parametrize(
    ("lit", "unlit", "found", "remedies"),
    [
        ((150, 160, 140), (3, 4, 2), "all 3 views: 150 grey levels with it, 3 without", []),
        ((21, 30, 25), (4, 5, 4), "all 3 views: 25 grey levels with it, 4 without", []),  # black level
        ((3, 3, 3), (3, 3, 3), "all 3 views: 3 grey levels with it, 3 without", ["the wire"]),
        ((150, 150, 150), (150, 149, 150), "all 3 views: 150 grey levels with it, 150 without", ["daylight"]),
        ((150, 160, 140), (3, 60, 2), "c02: 160 grey levels with it, 60 without", ["daylight"]),
        (
            (150, 2, 140),
            (3, 2, 70),
            "c02: 2 grey levels with it, 2 without; c03: 140 grey levels with it, 70 without",
            ["the wire", "daylight"],
        ),
    ],
)
def test_the_light_must_come_from_the_flash(
    lit: tuple[float, ...], unlit: tuple[float, ...], found: str, remedies: list[str]
) -> None:
    finding = judged(lit, unlit)
    assert finding.found == found
    assert finding.verdict is (HostVerdict.FAULT if remedies else HostVerdict.GOOD)
    assert [each for each in ("the wire", "daylight") if each in (finding.remedy or "")] == remedies


def test_views_that_were_not_exposed_twice_are_not_compared() -> None:
    assert judge_flash({C1: 150.0}, {C2: 150.0}).verdict is HostVerdict.UNKNOWN
    assert judge_flash({C1: 150.0, C2: 150.0}, {C1: 3.0}).found.startswith("all 1 views")


@pytest.mark.parametrize("version", ["0.9", FIRMWARE_VERSION])
def test_an_old_firmware_of_the_gate_is_named_with_its_remedy(tmp_path: Path, version: str) -> None:
    with serial_gate(tmp_path / "gate") as (_, device):
        device.identity = Identity(name=FIRMWARE_NAME, serial="7", version=version)
        settings = SerialGateSettings(port=str(device.link))
        rig = SimpleNamespace(gate=SimpleNamespace(device=settings), gate_delay_us=0)
        finding = check_gate(rig)  # type: ignore[arg-type]  # all that it asks of a rig
    if version == FIRMWARE_VERSION:
        assert (finding.verdict, finding.remedy) == (HostVerdict.GOOD, None)
    else:
        assert finding.verdict is HostVerdict.FAULT
        assert f"version 0.9, this release has {FIRMWARE_VERSION}" in finding.found
        assert "make -C drivers/gates/firmware flash" in finding.found
