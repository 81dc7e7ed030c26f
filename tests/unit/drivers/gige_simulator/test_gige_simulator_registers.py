"""The simulated camera's discovery and registers, spoken to over raw sockets."""

import io
import socket
import struct
import zipfile

import pytest
from support.gige_client import (
    BAD_ALIGNMENT,
    BUSY,
    CCP,
    DISCOVERY,
    GVCP_PORT,
    INVALID_ADDRESS,
    INVALID_HEADER,
    INVALID_PARAMETER,
    NOT_IMPLEMENTED,
    READMEM,
    READREG,
    SCPS,
    WRITE_PROTECT,
    WRITEREG,
)
from support.simulated_camera import ADDRESS, Session, design, session

from drivers.errors import CameraUnavailableError
from drivers.gige_simulator.camera import SimulatedCamera

UNKNOWN_ADDRESS = 0x1FFFC


def test_discovery_tells_who_it_is(camera: Session) -> None:
    status, body = camera.control.ask(DISCOVERY)
    assert status == 0
    assert len(body) == 0xF8
    assert socket.inet_ntoa(body[0x24:0x28]) == ADDRESS
    texts = [body[at : at + 16].split(b"\0")[0] for at in (0x48, 0x68, 0xD8, 0xE8)]
    assert texts == [b"Stonefall", b"SF-1280", b"SIM01", b"place 1"]


def test_broadcast_discovery_is_answered_from_its_own_address(camera: Session) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        asking.bind(("127.0.0.1", 0))
        asking.settimeout(1.0)
        asking.sendto(struct.pack(">BBHHH", 0x42, 0x11, DISCOVERY, 0, 1), ("255.255.255.255", GVCP_PORT))
        answered: set[tuple[str, int]] = set()
        while (ADDRESS, GVCP_PORT) not in answered:  # other simulators of this machine answer as well
            answered.add(asking.recvfrom(2048)[1])


def test_an_address_in_use_is_refused(camera: Session) -> None:
    second = SimulatedCamera(design(), lambda _: None)
    with pytest.raises(CameraUnavailableError, match=rf"c01: cannot be simulated at {ADDRESS}:3956.*127/8"):
        second.start()


def test_several_registers_are_read_and_written_at_once(camera: Session) -> None:
    keys = [camera.address(name) for name in ("ActionDeviceKey", "ActionGroupKey", "ActionGroupMask")]
    values = struct.pack(">IIIIII", keys[0], 11, keys[1], 22, keys[2], 33)
    assert camera.control.ask(WRITEREG, values) == (0, struct.pack(">HH", 0, 3))
    assert camera.control.ask(READREG, struct.pack(">III", *keys)) == (0, struct.pack(">III", 11, 22, 33))


@pytest.mark.parametrize(
    ("address", "status"),
    [
        (0xD02, BAD_ALIGNMENT),
        (UNKNOWN_ADDRESS, INVALID_ADDRESS),
        (0xA04, WRITE_PROTECT),  # a bootstrap register nobody may write
        (0x24, WRITE_PROTECT),
    ],
)
def test_writing_what_cannot_be_written_says_why(camera: Session, address: int, status: int) -> None:
    assert camera.control.write(address, 1) == status


@pytest.mark.parametrize(
    ("name", "value", "status"),
    [
        ("Width", 120, 0),
        ("Width", 122, INVALID_PARAMETER),  # no multiple of 4
        ("Width", 132, INVALID_PARAMETER),  # wider than the sensor
        ("OffsetX", 4, INVALID_PARAMETER),  # no room beside the full width
        ("TriggerSource", 99, INVALID_PARAMETER),  # no such entry
        ("SensorWidth", 64, WRITE_PROTECT),
        ("PayloadSize", 64, WRITE_PROTECT),
        ("GevSCPD", 100_000_001, INVALID_PARAMETER),
    ],
)
def test_values_are_checked(camera: Session, name: str, value: int, status: int) -> None:
    before = camera.camera.feature(name)
    assert camera.set(name, value) == status
    assert camera.camera.feature(name) == (before if status else value)


def test_limits_depend_on_each_other(camera: Session) -> None:
    assert camera.set("OffsetX", 64) == INVALID_PARAMETER
    assert camera.set("Width", 64) == camera.set("OffsetX", 64) == 0
    assert camera.set("Width", 68) == INVALID_PARAMETER
    assert camera.number("PayloadSize") == 64 * 96


def test_a_legacy_camera_clamps_instead() -> None:
    with session(dialect="legacy") as camera:
        assert camera.set("Width", 1000) == 0
        assert camera.number("Width") == 128
        assert camera.set("ExposureTime", 2_000_000) == 0  # an integer behind the float
        assert camera.camera.feature("ExposureTime") == 1_000_000
        assert camera.set("Gain", 3) == 0
        assert camera.camera.feature("Gain") == pytest.approx(0.3)  # in steps of a tenth


def test_a_bad_packet_size_is_refused_and_the_flags_beside_it_are_not_lost(camera: Session) -> None:
    assert camera.control.write(SCPS, 1 << 30 | 1500) == 0
    assert camera.control.write(SCPS, 9004) == INVALID_PARAMETER
    assert camera.control.read(SCPS) == 1 << 30 | 1500


def test_what_is_locked_is_busy_while_acquiring(camera: Session) -> None:
    camera.start()
    assert camera.set("Width", 64) == BUSY
    assert camera.control.write(SCPS, 1000) == BUSY
    assert camera.set("Width", 128) == 0  # nothing changes
    assert camera.set("AcquisitionStop", 1) == camera.set("Width", 64) == 0


def test_unknown_commands_and_torn_bodies_are_answered_with_a_status(camera: Session) -> None:
    assert camera.control.ask(0x1234)[0] == NOT_IMPLEMENTED
    assert camera.control.ask(READREG, b"\0\0\x0a")[0] == INVALID_HEADER
    assert camera.control.ask(READMEM, struct.pack(">IHH", 0, 0, 700))[0] == INVALID_PARAMETER
    assert camera.control.ask(READMEM, struct.pack(">IHH", 0xFFFFFFF0, 0, 16))[0] == INVALID_ADDRESS


def test_garbage_is_ignored(camera: Session) -> None:
    for garbage in (b"", b"\x42", b"\x99" * 40, bytes(8)):
        camera.control.socket.sendto(garbage, (ADDRESS, GVCP_PORT))
    assert camera.control.read(CCP) == 2


@pytest.mark.parametrize("has_zipped_xml", [False, True])
def test_the_xml_is_where_the_url_says(has_zipped_xml: bool) -> None:
    with session(has_zipped_xml=has_zipped_xml) as camera:
        url = camera.control.read_memory(0x200, 512).split(b"\0")[0].decode()
        name, address, size = url.removeprefix("Local:").split(";")
        data = camera.control.read_memory(int(address, 16), int(size, 16))
    if has_zipped_xml:
        assert name == "SF-1280.zip"
        archive = zipfile.ZipFile(io.BytesIO(data))
        data = archive.read(archive.namelist()[0])
    assert data.startswith(b"<?xml")
    assert data.endswith(b"</RegisterDescription>")
