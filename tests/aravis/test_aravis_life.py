"""Life and death of a camera: what the driver notices, how soon, and how it comes back."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.eventually import PATIENCE_S, eventually
from support.extents import first_quick
from support.gige import NET, design, picture, powered, serial, settings_for
from support.sinks import Collector

from drivers.cameras import lamp
from drivers.cameras.aravis import AravisCamera
from drivers.cameras.genicam import strobe_features
from drivers.errors import CameraUnavailableError
from drivers.gige_simulator.camera import Exposure, SimulatedCamera
from drivers.gige_simulator.features import Dialect
from drivers.interfaces import CameraLost
from pipeline.arrays import GreyImage
from pipeline.frames import Frame

FOUND_OUT_S = 2.5
"""How soon `examine` knows: 0.25 s, and before the heartbeat's 3 s on any machine."""
STROBE_BANK, EXPOSURE_ACTIVE = 1, 1
"""Bank of Line2 among the registers of the lines, and an entry of its `LineSource`."""


@pytest.fixture
def simulated() -> Iterator[SimulatedCamera]:
    with powered(design()) as camera:
        yield camera


@pytest.fixture
def camera(simulated: SimulatedCamera) -> Iterator[AravisCamera]:
    """Open; found by its serial number."""
    camera = AravisCamera(settings_for(simulated.design, address=None, serial=simulated.design.serial))
    camera.open()
    yield camera
    camera.close()


def trouble(camera: AravisCamera) -> str:
    """What `examine` complains about."""
    start_s = time.monotonic()
    with pytest.raises(CameraUnavailableError) as caught:
        camera.examine()
    assert time.monotonic() - start_s < FOUND_OUT_S
    return str(caught.value)


def reopen(camera: AravisCamera, timeout_s: float = PATIENCE_S) -> None:
    """What the service does with a lost camera: close, and open until it can."""
    camera.close()

    def can_be_opened() -> bool:
        try:
            camera.open()
        except CameraUnavailableError:
            return False
        return True

    eventually(can_be_opened, timeout_s)


def works(camera: AravisCamera, simulated: SimulatedCamera) -> bool:
    """Whether an edge becomes the frame that was exposed, and all settings are as they should be."""
    camera.arm(sink := Collector())
    simulated.line()
    frame = sink.next()
    vitals = camera.examine()
    camera.disarm()
    return isinstance(frame, Frame) and frame.frame_id == 1 and vitals.serial == simulated.design.serial


# --- gone ---


def test_a_pulled_cable_is_seen_at_once_and_back_in_time_nothing_was(
    camera: AravisCamera, simulated: SimulatedCamera
) -> None:
    camera.arm(sink := Collector())
    simulated.unplug()
    assert f"does not answer at {NET}.2" in trouble(camera)
    simulated.line()
    eventually(lambda: simulated.counters.torn == 1)
    simulated.replug()
    camera.examine()
    simulated.line()
    frame = sink.next()
    assert isinstance(frame, Frame)
    assert frame.frame_id == 2
    assert np.array_equal(frame.image, picture(2))


def test_a_power_cycle_is_seen_and_the_camera_set_again(
    camera: AravisCamera, simulated: SimulatedCamera
) -> None:
    camera.arm(Collector())
    simulated.power_cycle(0.3)
    assert "does not answer" in trouble(camera)
    eventually(lambda: "does not answer" not in trouble(camera))
    assert "control was lost" in trouble(camera)
    assert simulated.feature("ExposureTime") != 100.0
    reopen(camera)
    assert simulated.feature("ExposureTime") == 100.0
    assert works(camera, simulated)


def test_another_device_in_the_place_is_told_by_its_serial_number(
    camera: AravisCamera, simulated: SimulatedCamera
) -> None:
    simulated.power_cycle(0.1, serial="OTHER")
    eventually(lambda: f"another camera, serial OTHER, has the address {NET}.2" in trouble(camera))
    camera.close()
    with pytest.raises(CameraUnavailableError, match=rf"serial {serial(2)} does not answer; found .*OTHER"):
        camera.open()


@pytest.mark.full
def test_a_new_address_is_found_by_the_serial_number(
    camera: AravisCamera, simulated: SimulatedCamera
) -> None:
    simulated.power_cycle(0.1, address=f"{NET}.99")
    assert f"does not answer at {NET}.2" in trouble(camera)
    reopen(camera)
    assert camera.examine().address == f"{NET}.99"
    assert works(camera, simulated)


@pytest.mark.full
def test_a_killed_camera_does_not_hold_up_anybody_else(
    camera: AravisCamera, simulated: SimulatedCamera
) -> None:
    """Closing takes seconds, in Aravis and without the interpreter's lock; another camera works meanwhile."""
    with powered(design(3)) as other_simulated:
        other = AravisCamera(settings_for(other_simulated.design))
        camera.arm(Collector())
        simulated.stop()
        assert "does not answer" in trouble(camera)
        closing = threading.Thread(target=camera.close)
        start_s = time.monotonic()
        closing.start()
        moments_s = [start_s]
        while closing.is_alive():
            other.open()
            assert works(other, other_simulated)
            other.close()
            moments_s.append(time.monotonic())
        closing.join()
        closing_s = time.monotonic() - start_s
        # with the lock held the other one would have waited all the while
        assert max(later - earlier for earlier, later in pairwise(moments_s)) < closing_s / 2
    with pytest.raises(CameraUnavailableError, match="does not answer"):
        camera.open()
    simulated.start()
    camera.open()
    assert works(camera, simulated)


def test_control_lost_for_good_ends_the_session_by_itself(
    camera: AravisCamera, simulated: SimulatedCamera
) -> None:
    camera.arm(sink := Collector())
    simulated.power_cycle(0.1)
    lost = sink.next()
    assert isinstance(lost, CameraLost)
    assert (lost.camera, lost.reason) == ("c02", "control was lost")
    reopen(camera)
    assert works(camera, simulated)
    assert [event for event in sink.events if isinstance(event, CameraLost)] == [lost]


# --- in other hands ---


def test_settings_changed_by_someone_else(camera: AravisCamera, simulated: SimulatedCamera) -> None:
    camera.arm(Collector())
    simulated.tamper("ExposureTime", 5000.0)
    assert trouble(camera) == "c02: setting ExposureTime is 5000.0, should be 100.0"
    simulated.tamper("ExposureTime", 100.0)
    camera.examine()
    simulated.tamper("TriggerMode", "Off")
    assert "setting TriggerMode is Off, should be On" in trouble(camera)
    reopen(camera)
    assert works(camera, simulated)


def test_stolen_control_is_seen_and_won_back(camera: AravisCamera, simulated: SimulatedCamera) -> None:
    camera.arm(Collector())
    simulated.steal_control(1.0)
    assert "control was lost: cannot keep it" in trouble(camera)
    camera.close()
    with pytest.raises(CameraUnavailableError, match="in use by another application"):
        camera.open()
    reopen(camera)
    assert works(camera, simulated)


def test_a_killed_predecessor_is_waited_for(simulated: SimulatedCamera) -> None:
    program = f"""
        import time
        from support.gige import design, settings_for
        from support.sinks import Collector
        from drivers.cameras.aravis import AravisCamera
        camera = AravisCamera(settings_for(design(), address={simulated.design.address!r}))
        camera.open()
        camera.arm(Collector())
        print("armed", flush=True)
        time.sleep(60)
    """
    tests = Path(__file__).parents[1]
    predecessor = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(program)],
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": f"{tests}{os.pathsep}{tests.parent}"},
    )
    with predecessor:
        assert predecessor.stdout is not None
        assert predecessor.stdout.readline() == b"armed\n"
        predecessor.send_signal(signal.SIGKILL)
    camera = AravisCamera(settings_for(design()))
    with pytest.raises(CameraUnavailableError, match="its heartbeat ends within 3 s"):
        camera.open()
    reopen(camera)
    assert works(camera, simulated)
    camera.close()


# --- the driver's own life ---


def test_a_sequence_of_calls_nobody_planned(simulated: SimulatedCamera) -> None:
    camera = AravisCamera(settings_for(design()))
    camera.close()
    camera.disarm()
    for call in (lambda: camera.arm(Collector()), camera.examine, camera.software_trigger):
        with pytest.raises(CameraUnavailableError, match="c02: is not open"):
            call()
    camera.open()
    camera.open()
    camera.arm(first := Collector())
    camera.arm(second := Collector())
    simulated.line()
    assert isinstance(second.next(), Frame)
    assert first.events == []
    camera.close()
    camera.close()
    assert simulated.controller is None


STROBED = settings_for(design()).features + strobe_features(line="Line2")


@pytest.fixture
def old() -> Iterator[SimulatedCamera]:
    """A camera whose status lamp cannot be switched."""
    with powered(design(dialect="legacy")) as camera:
        yield camera


def test_a_camera_without_a_switchable_lamp_is_found_by_its_strobe(old: SimulatedCamera) -> None:
    camera = AravisCamera(settings_for(old.design, features=STROBED))
    camera.open()
    assert not old.is_lit
    camera.light(is_on=True)
    assert old.is_lit
    camera.close()
    assert not old.is_lit
    assert old.feature("LineSource", STROBE_BANK) == EXPOSURE_ACTIVE
    assert works(camera_opened(camera), old)  # the strobe flashes with the exposure again
    camera.close()


def test_the_strobe_is_itself_again_after_a_host_that_was_killed_over_it(old: SimulatedCamera) -> None:
    old.tamper("UserOutputValue", 1)
    old.tamper("LineMode", "Output", STROBE_BANK)
    old.tamper("LineSource", "UserOutput1", STROBE_BANK)
    assert old.is_lit
    camera = camera_opened(AravisCamera(settings_for(old.design, features=STROBED)))
    assert not old.is_lit
    camera.examine()
    camera.close()


@pytest.mark.parametrize("dialect", ["sfnc", "legacy"])
@pytest.mark.parametrize("has_user_output", [True, False])
def test_exposures_without_the_strobe_until_the_camera_is_closed(
    dialect: Dialect, has_user_output: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not has_user_output:
        monkeypatch.setattr(lamp, "USER_OUTPUT", "NoSuchOutput")
    exposures: list[Exposure] = []

    def seen(exposure: Exposure) -> GreyImage:
        exposures.append(exposure)
        return picture(exposure.n)

    with powered(design(dialect=dialect), seen) as device:
        device.tamper("UserOutputValue", 1)
        settings = settings_for(device.design, features=STROBED)
        camera = camera_opened(AravisCamera(replace(settings, is_strobe_off=True)))
        assert works(camera, device)
        camera.examine()
        assert exposures[-1].high_lines == ()
        camera.close()
        assert device.feature("LineSource", STROBE_BANK) == EXPOSURE_ACTIVE
        camera = camera_opened(AravisCamera(settings))
        assert works(camera, device)
        assert exposures[-1].high_lines == ("Line2",)
        camera.close()


def test_a_camera_with_nothing_to_light_says_so(old: SimulatedCamera) -> None:
    camera = camera_opened(AravisCamera(settings_for(old.design)))
    with pytest.raises(
        CameraUnavailableError, match="has no lamp to switch: neither DeviceIndicatorMode nor"
    ):
        camera.light(is_on=True)
    camera.examine()
    camera.close()


def camera_opened(camera: AravisCamera) -> AravisCamera:
    camera.open()
    return camera


def test_an_error_somebody_keeps_does_not_keep_the_camera(
    camera: AravisCamera, simulated: SimulatedCamera
) -> None:
    simulated.tamper("ExposureTime", 5000.0)
    with pytest.raises(CameraUnavailableError) as kept:
        camera.examine()
    n_sockets = sockets_of_this_process()
    camera.close()
    assert sockets_of_this_process() == n_sockets - 2  # control and stream
    assert kept.value.problem


def test_vitals_are_the_camera_s_own(camera: AravisCamera, simulated: SimulatedCamera) -> None:
    simulated.faults.temperature_c = 91.5
    camera.arm(sink := Collector())
    for _ in range(3):
        simulated.line()
        sink.next()
    eventually(lambda: simulated.counters.frames == 3)  # the last one may have come before it was counted
    vitals = camera.examine()
    assert vitals.temperature_c == 91.5
    assert vitals.ptp_offset_ns is None  # not asked for
    assert (vitals.frames, vitals.failed_frames, vitals.missing_packets) == (3, 0, 0)
    assert vitals.warnings == ()


@pytest.mark.parametrize("n_cycles", first_quick([12, 100]))
def test_cycles_leave_nothing_behind(simulated: SimulatedCamera, n_cycles: int) -> None:
    camera = AravisCamera(settings_for(design()))
    used = []
    for n in range(n_cycles):
        camera.open()
        camera.arm(sink := Collector())
        simulated.line()
        frame = sink.next()
        assert isinstance(frame, Frame)
        assert frame.frame_id == 1
        eventually(lambda: is_well(camera))  # here a busy machine holds up camera and host alike
        camera.close()
        if n in (n_cycles // 4, n_cycles - 1):
            used.append((entries("fd"), entries("task"), resident_kb()))
    (fds, threads, kb), (fds_after, threads_after, kb_after) = used
    assert fds_after <= fds
    assert threads_after - threads < 5  # threads of GLib's pool come and go; one a cycle would be 8 or 75
    assert kb_after - kb < 1000
    eventually(lambda: simulated.counters.frames == n_cycles)
    assert simulated.counters.triggers == n_cycles


def is_well(camera: AravisCamera) -> bool:
    try:
        camera.examine()
    except CameraUnavailableError:
        return False
    return True


def entries(folder: str) -> int:
    return sum(1 for _ in Path("/proc/self", folder).iterdir())


def sockets_of_this_process() -> int:
    links = (entry.readlink().name for entry in Path("/proc/self/fd").iterdir() if entry.is_symlink())
    return sum(name.startswith("socket:") for name in links)


def resident_kb() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024
