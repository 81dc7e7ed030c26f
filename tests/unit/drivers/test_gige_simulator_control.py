"""The simulated camera's control channel, spoken to over raw sockets."""

import io
import socket
import struct
import time
import zipfile
from collections.abc import Iterator

import pytest
from support.eventually import eventually
from support.gige_client import (
    ACTION,
    CCP,
    DISCOVERY,
    GVCP_PORT,
    READMEM,
    READREG,
    SCPS,
    WRITEREG,
    application,
)
from support.simulated_camera import ADDRESS, Session, design, session

from drivers.errors import CameraUnavailableError
from drivers.gige_simulator.camera import SimulatedCamera
from drivers.gvcp import action_command

NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS, WRITE_PROTECT, BAD_ALIGNMENT, ACCESS_DENIED, BUSY = (
    range(0x8001, 0x8008)
)
INVALID_HEADER, NO_REFERENCE_TIME, ACTION_LATE = 0x800E, 0x8013, 0x8016
UNKNOWN_ADDRESS = 0x1FFFC


@pytest.fixture
def camera() -> Iterator[Session]:
    with session() as opened:
        yield opened


# --- discovery ---


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


# --- registers ---


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


# --- access ---


def test_only_the_controller_may_write(camera: Session) -> None:
    with application(ADDRESS) as other:
        assert other.read(CCP) == 2
        assert other.write(camera.address("GevSCPD"), 5) == ACCESS_DENIED
        assert other.write(CCP, 2) == ACCESS_DENIED
        camera.control.write(CCP, 0)
        assert other.write(camera.address("GevSCPD"), 5) == ACCESS_DENIED  # control comes first
        other.take_control()
        assert other.write(camera.address("GevSCPD"), 5) == 0
        assert camera.control.write(camera.address("GevSCPD"), 6) == ACCESS_DENIED


def test_exclusive_access_shuts_readers_out(camera: Session) -> None:
    assert camera.control.write(CCP, 1) == 0
    with application(ADDRESS) as other:
        assert other.ask(READREG, struct.pack(">I", 0x934))[0] == ACCESS_DENIED
        assert other.read(CCP) == 1
        assert other.ask(DISCOVERY)[0] == 0


def test_a_silent_controller_loses_control_and_the_stream_ends(camera: Session) -> None:
    camera.start()
    assert camera.set("GevHeartbeatTimeout", 500) == 0
    for _ in range(4):  # a read is enough to stay
        time.sleep(0.2)
        assert camera.control.read(CCP) == 2
    assert camera.camera.is_acquiring
    since_s = time.monotonic()
    eventually(lambda: camera.camera.controller is None, 2.0)
    assert 0.45 < time.monotonic() - since_s < 1.0
    assert not camera.camera.is_acquiring
    assert camera.control.read(CCP) == 0
    assert [entry.event.split(" of ")[0] for entry in camera.camera.log][-1] == "heartbeat"


def test_others_that_ask_all_the_time_do_not_keep_a_dead_controller_alive(camera: Session) -> None:
    assert camera.set("GevHeartbeatTimeout", 500) == 0
    deadline_s = time.monotonic() + 2.0
    with application(ADDRESS) as other:
        while other.read(CCP):
            assert time.monotonic() < deadline_s


def test_a_repeated_command_is_answered_again_but_not_done_again(camera: Session) -> None:
    camera.start(source=3)  # software
    body = struct.pack(">II", camera.address("TriggerSoftware"), 1)
    with application(ADDRESS) as other:
        for _ in range(2):
            camera.control.tell(WRITEREG, body, flags=1, request_id=777)
            assert camera.control.socket.recv(100)[:2] == b"\0\0"
            other.read(CCP)
    assert camera.camera.counters.edges == 1
    camera.control.tell(WRITEREG, body, flags=1, request_id=778)
    eventually(lambda: camera.camera.counters.edges == 2)


def test_heartbeats_of_the_controller_are_counted(camera: Session) -> None:
    with application(ADDRESS) as other:
        other.read(CCP)
        for _ in range(3):
            camera.control.read(CCP)
    assert camera.camera.counters.heartbeats == 3


# --- actions ---


def _prepare_action(camera: Session) -> None:
    camera.start(source=4)
    for name, value in (("ActionDeviceKey", 7), ("ActionGroupKey", 1), ("ActionGroupMask", 0b110)):
        assert camera.set(name, value) == 0


@pytest.mark.parametrize(
    ("device_key", "group_key", "group_mask", "n_frames"),
    [(7, 1, 0b010, 1), (8, 1, 0b010, 0), (7, 2, 0b010, 0), (7, 1, 0b001, 0)],
)
def test_an_action_needs_both_keys_and_a_bit_of_the_mask(
    camera: Session, device_key: int, group_key: int, group_mask: int, n_frames: int
) -> None:
    _prepare_action(camera)
    datagram = action_command(device_key=device_key, group_key=group_key, group_mask=group_mask, request_id=1)
    camera.control.socket.sendto(datagram, (ADDRESS, GVCP_PORT))
    camera.control.read(CCP)  # commands are done in order
    counters = camera.settled()
    assert (counters.actions, counters.triggers) == (n_frames, n_frames)


def test_a_broadcast_action_reaches_the_camera(camera: Session) -> None:
    _prepare_action(camera)
    camera.control.socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
    datagram = action_command(device_key=7, group_key=1, group_mask=2, request_id=1)
    camera.control.socket.sendto(datagram, ("255.255.255.255", GVCP_PORT))
    assert camera.receiver.frame() is not None


def test_a_scheduled_action_waits_for_its_time_on_a_common_clock(camera: Session) -> None:
    _prepare_action(camera)

    def act(at_ns: int) -> int:
        return camera.control.ask(ACTION, struct.pack(">IIIQ", 7, 1, 2, at_ns), flags=0x81)[0]

    assert act(time.time_ns() + 10**9) == NO_REFERENCE_TIME
    assert camera.set("PtpEnable", 1) == 0
    entries = {0: "Initializing", 2: "Disabled", 3: "Listening", 7: "Uncalibrated", 8: "Slave"}
    seen = set()
    deadline_s = time.monotonic() + 5
    while (state := entries[camera.number("PtpStatus")]) != "Slave":
        seen.add(state)
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    assert seen == {"Listening", "Uncalibrated"}
    assert act(time.time_ns() - 1) == ACTION_LATE
    at_ns = time.time_ns() + 200_000_000
    assert act(at_ns) == 0
    frame = camera.receiver.frame()
    assert frame is not None
    assert abs(frame.device_ns - at_ns) < 5_000_000
    assert time.time_ns() > at_ns


# --- faults of the control channel ---


def test_lost_commands_are_answered_when_repeated(camera: Session) -> None:
    camera.camera.faults.control_loss = 0.5
    camera.control.socket.settimeout(0.02)
    n_lost = 0
    for _ in range(20):
        try:
            camera.control.read(CCP)
        except TimeoutError:
            n_lost += 1
    assert 5 < n_lost < 20
    camera.camera.faults.clear()
    camera.control.socket.settimeout(1.0)
    eventually(lambda: _answers(camera))


def _answers(camera: Session) -> bool:
    camera.control.socket.setblocking(False)
    try:
        while camera.control.socket.recv(2048):
            pass
    except BlockingIOError:
        pass
    camera.control.socket.settimeout(1.0)
    return camera.control.read(CCP) == 2


def test_a_slow_camera_asks_for_patience(camera: Session) -> None:
    camera.camera.faults.ack_delay_ms = 150
    camera.control.tell(READREG, struct.pack(">I", CCP), flags=1, request_id=9)
    since_s = time.monotonic()
    pending = camera.control.socket.recv(100)
    assert pending == struct.pack(">HHHHHH", 0, 0x89, 4, 9, 0, 300)
    assert time.monotonic() - since_s < 0.1
    assert camera.control.socket.recv(100) == struct.pack(">HHHHI", 0, 0x81, 4, 9, 2)
    assert 0.14 < time.monotonic() - since_s < 0.4


def test_a_pulled_cable_is_silence_and_control_survives_a_short_one(camera: Session) -> None:
    camera.start()
    camera.camera.unplug()
    camera.control.socket.settimeout(0.1)
    with pytest.raises(TimeoutError):
        camera.control.read(CCP)
    camera.camera.line()
    assert camera.settled().torn == 1  # exposed, and lost on the way
    camera.camera.replug()
    assert camera.control.read(CCP) == 2
    assert camera.camera.is_acquiring


def test_a_power_cycle_forgets_settings_and_controller(camera: Session) -> None:
    camera.start()
    camera.camera.power_cycle(0.3)
    camera.control.socket.settimeout(0.1)
    with pytest.raises(TimeoutError):
        camera.control.read(CCP)
    eventually(lambda: camera.camera.log[-1].event == "power on")
    assert camera.control.read(CCP) == 0
    assert not camera.camera.is_acquiring
    assert camera.camera.feature("TriggerMode") == 0
    assert camera.camera.feature("ExposureTime") == 1000.0


def test_a_new_address_and_another_device_in_the_place(camera: Session) -> None:
    camera.camera.power_cycle(0.1, address="127.31.0.9", serial="OTHER")
    with application("127.31.0.9") as other:
        other.socket.settimeout(0.1)

        def serial() -> bytes:
            try:
                return other.ask(DISCOVERY)[1][0xD8:0xE8].split(b"\0")[0]
            except TimeoutError:
                return b""

        eventually(lambda: serial() == b"OTHER")
    assert camera.camera.design.address == "127.31.0.9"
    camera.control.socket.settimeout(0.1)
    with pytest.raises(TimeoutError):  # nobody is at the old one any more
        camera.control.read(CCP)
    with session(address=ADDRESS, id="c02"), pytest.raises(CameraUnavailableError, match=r"127\.31\.0\.2"):
        camera.camera.power_cycle(0.1, address=ADDRESS)


def test_device_reset_is_acknowledged_before_the_camera_is_gone(camera: Session) -> None:
    assert camera.set("DeviceReset", 1) == 0
    eventually(lambda: camera.camera.log[-1].event == "power on", 5.0)
    assert camera.control.read(CCP) == 0


def test_stolen_control(camera: Session) -> None:
    assert camera.set("GevHeartbeatTimeout", 500) == 0
    camera.camera.steal_control(0.7)
    assert camera.set("GevSCPD", 5) == ACCESS_DENIED
    assert camera.control.read(CCP) == 2  # Aravis' heartbeat sees nothing wrong
    eventually(lambda: camera.camera.controller is None, 2.0)
    assert camera.control.read(CCP) == 0


def test_a_stopped_camera_can_be_started_again(camera: Session) -> None:
    camera.start()
    camera.camera.stop()
    camera.camera.stop()
    camera.camera.line()
    camera.camera.start()
    assert camera.control.read(CCP) == 0
    camera.control.take_control()
    camera.start()
    camera.camera.line()
    assert camera.receiver.frame() is not None
    counters = camera.settled()
    assert (counters.edges, counters.missed, counters.frames) == (2, 1, 1)
