"""The simulated camera slow, deaf, without power, in other hands: its control channel over raw sockets."""

import struct
import time
from contextlib import suppress

import pytest
from support.eventually import eventually
from support.gige_client import ACCESS_DENIED, CCP, DISCOVERY, READREG, application
from support.simulated_camera import ADDRESS, NET, Session, session

from drivers.errors import CameraUnavailableError


def test_lost_commands_are_answered_when_repeated(camera: Session) -> None:
    camera.camera.faults.control_loss = 0.5
    asked = set(range(101, 121))
    camera.control.socket.settimeout(0.3)
    lost = asked - _answered(camera, asked)
    assert 5 < len(lost) < 20
    camera.camera.faults.clear()
    assert _answered(camera, lost) == lost


def _answered(camera: Session, request_ids: set[int]) -> set[int]:
    for request_id in request_ids:
        camera.control.tell(READREG, struct.pack(">I", CCP), flags=1, request_id=request_id)
    found = set()
    with suppress(TimeoutError):
        while found != request_ids:
            *_, request_id, control = struct.unpack(">HHHHI", camera.control.socket.recv(100))
            assert control == 2
            found.add(request_id)
    return found


def test_a_slow_camera_asks_for_patience(camera: Session) -> None:
    camera.camera.faults.ack_delay_ms = 400
    since_s = time.monotonic()
    camera.control.tell(READREG, struct.pack(">I", CCP), flags=1, request_id=9)
    pending = camera.control.socket.recv(100)
    assert pending == struct.pack(">HHHHHH", 0, 0x89, 4, 9, 0, 800)
    assert camera.control.socket.recv(100) == struct.pack(">HHHHI", 0, 0x81, 4, 9, 2)
    assert time.monotonic() - since_s >= 0.4


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
    elsewhere = f"{NET}.9"
    camera.camera.power_cycle(0.1, address=elsewhere, serial="OTHER")
    with application(elsewhere) as other:
        other.socket.settimeout(0.1)

        def serial() -> bytes:
            try:
                return other.ask(DISCOVERY)[1][0xD8:0xE8].split(b"\0")[0]
            except TimeoutError:
                return b""

        eventually(lambda: serial() == b"OTHER")
    assert camera.camera.design.address == elsewhere
    camera.control.socket.settimeout(0.1)
    with pytest.raises(TimeoutError):  # nobody is at the old one any more
        camera.control.read(CCP)
    with session(address=ADDRESS, id="c02"), pytest.raises(CameraUnavailableError, match=ADDRESS):
        camera.camera.power_cycle(0.1, address=ADDRESS)


def test_device_reset_is_acknowledged_before_the_camera_is_gone(camera: Session) -> None:
    assert camera.set("DeviceReset", 1) == 0
    eventually(lambda: camera.camera.log[-1].event == "power on")
    assert camera.control.read(CCP) == 0


def test_stolen_control(camera: Session) -> None:
    assert camera.set("GevHeartbeatTimeout", 500) == 0
    camera.camera.steal_control(0.7)
    assert camera.set("GevSCPD", 5) == ACCESS_DENIED
    assert camera.control.read(CCP) == 2  # Aravis' heartbeat sees nothing wrong
    eventually(lambda: camera.camera.controller is None)
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
