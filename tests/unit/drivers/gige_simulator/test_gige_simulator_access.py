"""Who may command the simulated camera, and what actions do: spoken over raw sockets."""

import socket
import struct
import time

import pytest
from support.eventually import PATIENCE_S, eventually
from support.gige_client import (
    ACCESS_DENIED,
    ACTION,
    ACTION_LATE,
    CCP,
    DISCOVERY,
    GVCP_PORT,
    NO_REFERENCE_TIME,
    READREG,
    WRITEREG,
    application,
)
from support.simulated_camera import ADDRESS, Session

from drivers.gige_simulator import clock
from drivers.gvcp import action_command


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
    for _ in range(7):  # a read is enough to stay
        time.sleep(0.1)
        since_s = time.monotonic()
        assert camera.control.read(CCP) == 2
    assert camera.camera.is_acquiring
    eventually(lambda: camera.camera.controller is None)
    assert time.monotonic() - since_s >= 0.5
    assert not camera.camera.is_acquiring
    assert camera.control.read(CCP) == 0
    assert [entry.event.split(" of ")[0] for entry in camera.camera.log][-1] == "heartbeat"


def test_others_that_ask_all_the_time_do_not_keep_a_dead_controller_alive(camera: Session) -> None:
    assert camera.set("GevHeartbeatTimeout", 500) == 0
    deadline_s = time.monotonic() + PATIENCE_S
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


def test_a_scheduled_action_waits_for_its_time_on_a_common_clock(
    camera: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clock, "LISTENING_NS", 500_000_000)
    monkeypatch.setattr(clock, "LOCKING_NS", 1_000_000_000)
    _prepare_action(camera)

    def act(at_ns: int) -> int:
        return camera.control.ask(ACTION, struct.pack(">IIIQ", 7, 1, 2, at_ns), flags=0x81)[0]

    assert act(time.time_ns() + 10**9) == NO_REFERENCE_TIME
    assert camera.set("PtpEnable", 1) == 0
    entries = {0: "Initializing", 2: "Disabled", 3: "Listening", 7: "Uncalibrated", 8: "Slave"}
    seen = set()
    deadline_s = time.monotonic() + PATIENCE_S
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
