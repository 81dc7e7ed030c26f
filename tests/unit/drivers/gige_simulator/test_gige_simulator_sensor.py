"""Which edges a simulated camera exposes, when, with which settings; what it remembers and tells about itself."""

import struct
import time

import numpy as np
import pytest
from numpy.typing import NDArray
from support.eventually import eventually
from support.simulated_camera import SIZE_PX, Session, session

from drivers.gige_simulator.camera import Exposure
from drivers.gige_simulator.clock import CameraClock

MS = 1_000_000
FAR_NS = 10_000 * MS
"""From now: edges so far ahead are decided upon at once and exposed never."""
RISING, FALLING, ANY = 0, 1, 2
LINE1, LINE2, SOFTWARE, ACTION1 = 0, 1, 3, 4
FRAME, BURST = 0, 1
WRITE_PROTECT = 0x8004


def _accepted(camera: Session) -> int:
    return camera.camera.counters.triggers


# --- which edges ---


@pytest.mark.parametrize(
    ("activation", "rising", "is_accepted"),
    [(RISING, True, True), (RISING, False, False), (FALLING, False, True), (FALLING, True, False)],
)
def test_activation(camera: Session, activation: int, rising: bool, is_accepted: bool) -> None:
    assert camera.set("TriggerActivation", activation) == 0
    camera.start()
    camera.camera.line(rising=rising)
    assert _accepted(camera) == is_accepted


def test_any_edge_and_an_inverted_line(camera: Session) -> None:
    assert camera.set("TriggerActivation", ANY) == camera.set("LineInverter", 1) == 0
    camera.start()
    at_ns = time.monotonic_ns() + FAR_NS
    camera.camera.line(at_ns=at_ns)
    assert camera.number("LineStatus") == 0  # high, inverted
    camera.camera.line(at_ns=at_ns + 50 * MS, rising=False)
    assert camera.number("LineStatus") == 1
    assert _accepted(camera) == 2


def test_only_the_chosen_source_triggers(camera: Session) -> None:
    camera.start(source=LINE2)
    camera.camera.line("Line1")
    assert camera.set("TriggerSoftware", 1) == 0
    assert _accepted(camera) == 0
    camera.camera.line("Line2")
    counters = camera.settled()
    assert (counters.edges, counters.triggers, counters.missed) == (3, 1, 2)


def test_an_output_does_not_listen(camera: Session) -> None:
    assert camera.set("LineMode", 1, bank=LINE1) == 0
    camera.start()
    camera.camera.line()
    assert camera.camera.counters.edges == 0


def test_the_debouncer_swallows_edges_that_follow_too_soon(camera: Session) -> None:
    assert camera.set_quantity("LineDebouncerTime", 5000.0) == 0
    camera.start()
    first_ns = time.monotonic_ns() + FAR_NS
    for after_ms, n_accepted in ((0, 1), (3, 1), (6, 1), (100, 2)):
        camera.camera.line(at_ns=first_ns + after_ms * MS)
        assert _accepted(camera) == n_accepted
    counters = camera.camera.counters
    assert (counters.edges, counters.debounced, counters.missed) == (4, 2, 0)


def test_triggers_during_delay_exposure_and_readout_are_missed(camera: Session) -> None:
    assert camera.set_quantity("TriggerDelay", 20_000.0) == 0
    camera.start()
    assert camera.set_quantity("ExposureTime", 5_000.0) == 0
    edge_ns = time.monotonic_ns() + FAR_NS
    end_ns = edge_ns + 25 * MS
    for at_ns in (edge_ns, edge_ns + 10 * MS, end_ns - 1, end_ns):
        camera.camera.line(at_ns=at_ns)
    counters = camera.camera.counters
    assert (counters.edges, counters.triggers, counters.missed) == (4, 2, 2)


def test_the_next_exposure_may_not_disturb_the_readout(camera: Session) -> None:
    camera.start()  # 0.1 ms exposure, 96 lines of 8 us
    edge_ns = time.monotonic_ns() + FAR_NS
    for after_us, n_accepted in ((0, 1), (500, 1), (768, 2)):
        camera.camera.line(at_ns=edge_ns + after_us * 1000)
        assert _accepted(camera) == n_accepted


def test_with_both_triggers_on_a_burst_trigger_lets_one_frame_pass(camera: Session) -> None:
    assert camera.set("TriggerMode", 1, bank=BURST) == 0
    assert camera.set("TriggerSource", LINE2, bank=BURST) == 0
    camera.start(source=LINE1)
    camera.camera.line("Line1")
    assert camera.camera.counters.missed == 1
    camera.camera.line("Line2")
    for _ in range(2):
        camera.camera.line("Line1")
        camera.receiver.frame(0.1)
    counters = camera.settled()
    assert (counters.triggers, counters.frames, counters.missed) == (2, 1, 2)


def test_a_burst_trigger_alone_exposes(camera: Session) -> None:
    camera.start()
    assert camera.set("TriggerMode", 0) == camera.set("TriggerMode", 1, bank=BURST) == 0
    camera.camera.line("Line1")
    assert camera.receiver.frame() is not None


def test_edges_while_not_acquiring_are_missed(camera: Session) -> None:
    assert camera.set("TriggerMode", 1) == 0
    camera.camera.line()
    counters = camera.settled()
    assert (counters.edges, counters.missed, counters.exposures) == (1, 1, 0)


def test_missed_and_doubled_triggers(camera: Session) -> None:
    camera.start()
    faults = camera.camera.faults
    faults.missed_triggers = faults.doubled_triggers = 1
    camera.camera.line()
    assert camera.receiver.frame(0.05) is None
    camera.camera.line()
    first, second = camera.receiver.frame(), camera.receiver.frame()
    assert first is not None
    assert second is not None
    assert second.device_ns - first.device_ns == 30 * MS
    counters = camera.settled()
    assert (counters.edges, counters.unseen, counters.triggers, counters.frames) == (2, 1, 1, 2)
    assert len({exposure.trigger_ns for exposure in camera.exposures}) == 1


# --- exposures ---


def test_the_source_is_asked_for_what_was_seen(camera: Session) -> None:
    assert camera.set_quantity("TriggerDelay", 30_000.0) == camera.set_quantity("Gain", 6.0) == 0
    camera.start()
    edge_ns = time.monotonic_ns()
    camera.camera.line(at_ns=edge_ns)
    frame = camera.receiver.frame()
    assert frame is not None
    assert camera.exposures == [
        Exposure(
            camera=camera.camera.id,
            n=1,
            trigger_ns=edge_ns,
            exposed_ns=edge_ns + 30 * MS,
            exposure_us=100.0,
            gain_db=6.0,
        )
    ]
    assert time.monotonic_ns() > edge_ns + 30 * MS


def test_the_strobe_lights_with_the_exposure(camera: Session) -> None:
    assert camera.set("LineMode", 1, bank=LINE2) == camera.set("LineSource", 1, bank=LINE2) == 0
    camera.start()
    edge_ns = time.monotonic_ns()
    camera.camera.line(at_ns=edge_ns)
    assert camera.receiver.frame() is not None
    (exposure,) = camera.exposures
    assert exposure.high_lines == ("Line2",)
    (strobe,) = camera.strobes
    assert (strobe.line, strobe.exposed_ns, strobe.exposure_us) == ("Line2", edge_ns, 100.0)


def test_the_camera_clock_is_its_own() -> None:
    with session(clock_offset_ns=5_000 * MS, clock_drift_ppm=1000.0) as camera:
        camera.start()
        edges_ns, frames_ns = [], []
        for _ in range(2):
            edges_ns.append(time.monotonic_ns())
            camera.camera.line(at_ns=edges_ns[-1])
            frame = camera.receiver.frame()
            assert frame is not None
            frames_ns.append(frame.device_ns)
            time.sleep(0.1)
    elapsed_ns = edges_ns[1] - edges_ns[0]
    assert abs(frames_ns[1] - frames_ns[0] - elapsed_ns * 1.001) < 1000
    assert 5_000 * MS < frames_ns[0] < 10_000 * MS


def test_free_running(camera: Session) -> None:
    assert camera.set("AcquisitionFrameRateEnable", 1) == 0
    assert camera.set_quantity("AcquisitionFrameRate", 50.0) == 0
    camera.stream_to_receiver()
    assert camera.set("AcquisitionStart", 1) == 0
    frames = [camera.receiver.frame() for _ in range(4)]
    assert camera.set("AcquisitionStop", 1) == 0
    times_ns = [frame.device_ns for frame in frames if frame]
    assert np.diff(times_ns).min() >= 20 * MS
    assert np.median(np.diff(times_ns)) < 60 * MS  # a busy machine may be late once
    counters = camera.settled()
    assert counters.exposures == counters.frames + counters.aborted + counters.torn


def test_a_single_frame_ends_the_acquisition(camera: Session) -> None:
    assert camera.set("AcquisitionMode", 1) == 0
    camera.start()
    camera.camera.line()
    assert camera.receiver.frame() is not None
    eventually(lambda: not camera.camera.is_acquiring)


def _grey(exposure: Exposure) -> NDArray[np.uint8]:
    """As bright as light, exposure and gain make it."""
    level = 0.01 * exposure.exposure_us * 10 ** (exposure.gain_db / 20)
    return np.full(SIZE_PX[::-1], min(level, 255.0), np.uint8)


@pytest.mark.parametrize("name", ["ExposureAuto", "GainAuto"])
def test_automatic_exposure_and_gain_reach_their_target_once_and_stop(name: str) -> None:
    with session(_grey) as camera:
        assert camera.set(name, 1) == 0
        camera.start()
        assert camera.set_quantity("ExposureTime", 3000.0) == 0
        greys = []
        for _ in range(12):
            camera.camera.line()
            frame = camera.receiver.frame()
            assert frame is not None
            camera.settled()
            greys.append(int(frame.image[0, 0]))
        assert greys[0] == 30
        assert abs(greys[-1] - 128) <= 7
        assert camera.number(name) == 0
        after = camera.camera.feature("ExposureTime" if name == "ExposureAuto" else "Gain")
        assert after == pytest.approx(12_800 if name == "ExposureAuto" else 12.6, rel=0.06)


# --- memory and vitals ---


def test_counters_count_and_can_be_reset(camera: Session) -> None:
    assert camera.set("CounterEventSource", 2, bank=1) == 0  # missed triggers
    camera.start()
    at_ns = time.monotonic_ns() + FAR_NS
    for after_us in (0, 10, 20):
        camera.camera.line(at_ns=at_ns + after_us * 1000)
    assert [camera.number("CounterValue", bank) for bank in (0, 1)] == [3, 2]
    assert camera.set("CounterReset", 1) == 0
    assert [camera.number("CounterValue", bank) for bank in (0, 1)] == [0, 2]


def test_a_user_set_survives_the_power_cycle_when_it_is_the_default(camera: Session) -> None:
    assert camera.set("UserSetSave", 1) == WRITE_PROTECT  # the factory's
    assert camera.set_quantity("ExposureTime", 77.0) == camera.set("GevSCPD", 1234) == 0
    assert camera.set("UserSetSelector", 1) == camera.set("UserSetSave", 1) == 0
    assert camera.set_quantity("ExposureTime", 99.0) == camera.set("UserSetLoad", 1) == 0
    assert camera.camera.feature("ExposureTime") == 77.0
    assert camera.set("UserSetDefault", 1) == 0
    _cycle(camera)
    assert camera.camera.feature("ExposureTime") == 77.0
    assert camera.number("GevSCPD") == 1234
    assert camera.set("UserSetSelector", 0) == camera.set("UserSetLoad", 1) == 0
    assert camera.camera.feature("ExposureTime") == 1000.0


def test_the_user_name_stays(camera: Session) -> None:
    assert camera.control.write_memory(camera.address("DeviceUserID"), b"north 3".ljust(16, b"\0")) == 0
    _cycle(camera)
    assert camera.camera.feature("DeviceUserID") == "north 3"


def _cycle(camera: Session) -> None:
    camera.camera.power_cycle(0.05)
    eventually(lambda: camera.camera.log[-1].event == "power on")
    camera.control.take_control()


def test_the_temperature_drifts_and_can_be_raised(camera: Session) -> None:
    def temperature_c() -> float:
        data = camera.control.read_memory(camera.address("DeviceTemperature"), 8)
        return float(struct.unpack(">d", data)[0])

    first_c = temperature_c()
    assert 30 < first_c < 50
    eventually(lambda: temperature_c() != first_c)
    camera.camera.faults.temperature_c = 95.0
    assert temperature_c() == 95.0


def test_the_time_can_be_latched_and_reset(camera: Session) -> None:
    def latched_ns() -> int:
        assert camera.set("TimestampLatch", 1) == 0
        return int.from_bytes(camera.control.read_memory(0x948, 8), "big")

    first_ns = latched_ns()
    assert latched_ns() > first_ns
    camera.camera.jump_clock(3_600_000 * MS)
    assert latched_ns() > 3_600_000 * MS
    assert camera.control.write(0x944, 1) == 0
    assert latched_ns() < 1_000 * MS


def test_someone_else_changes_a_setting(camera: Session) -> None:
    camera.camera.tamper("ExposureTime", 500.0)
    camera.camera.tamper("TriggerMode", "On")
    assert camera.camera.feature("ExposureTime") == 500.0
    assert camera.number("TriggerMode") == 1
    for name, value in (("Nonsense", 1), ("TriggerMode", "Perhaps"), ("ExposureTime", "long")):
        with pytest.raises(ValueError, match=f"c01.*{name}"):
            camera.camera.tamper(name, value)


def test_a_clock_without_ptp_runs_at_its_own_rate_and_jumps() -> None:
    clock = CameraClock(offset_ns=1_000, drift_ppm=50.0, seed=1)
    start_ns = time.monotonic_ns()
    one, later = clock.device_ns(start_ns), clock.device_ns(start_ns + 10**9)
    assert later - one == pytest.approx(1_000_050_000, abs=2)
    assert clock.host_ns(later) == pytest.approx(start_ns + 10**9, abs=2)
    assert (clock.ptp_state(), clock.ptp_offset_ns()) == ("Disabled", 0)
    clock.jump(-5_000)
    assert clock.device_ns(start_ns) == pytest.approx(one - 5_000, abs=2)


def test_a_slave_shows_its_masters_time_and_goes_on_from_there() -> None:
    clock = CameraClock(offset_ns=0, drift_ppm=100.0, seed=1)
    clock.set_ptp(is_enabled=True)
    assert clock.ptp_state() == "Listening"
    ahead_ns = time.monotonic_ns() + 10 * 10**9  # locked by then
    utc_ns = time.time_ns() + 10 * 10**9
    assert clock.device_ns(ahead_ns) == pytest.approx(utc_ns, abs=20 * MS)
