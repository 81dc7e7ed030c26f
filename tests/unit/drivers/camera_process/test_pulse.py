"""How long the process of the cameras has been silent, by the clock and by the time in which it could be heard."""

from drivers.camera_process.messages import HEARTBEAT_S
from drivers.camera_process.process import HUNG_S, LISTEN_S, SILENT_S, Pulse


def test_silence_is_named_first_and_then_ends_the_process() -> None:
    pulse, now_s = Pulse(), 100.0
    pulse.beat(now_s)
    silent_after_s = lost_after_s = None
    while lost_after_s is None:
        now_s += LISTEN_S
        pulse.wait(LISTEN_S)
        if silent_after_s is None and pulse.is_silent(now_s):
            silent_after_s = now_s - 100.0
        if pulse.is_lost:
            lost_after_s = now_s - 100.0
    assert silent_after_s is not None
    assert HEARTBEAT_S < SILENT_S < silent_after_s < SILENT_S + 2 * LISTEN_S
    assert HUNG_S - LISTEN_S < lost_after_s < HUNG_S + 2 * LISTEN_S
    pulse.beat(now_s)
    assert not pulse.is_silent(now_s)
    assert not pulse.is_lost


def test_a_host_that_stood_still_ends_no_process() -> None:
    pulse = Pulse()
    pulse.beat(100.0)
    pulse.wait(3600.0)
    assert pulse.is_silent(3700.0)  # and its images are not there, until the next heartbeat
    assert not pulse.is_lost


def test_a_process_that_starts_is_not_silent() -> None:
    pulse = Pulse()
    for _ in range(1000):
        pulse.wait(LISTEN_S)
    assert not pulse.is_silent(100.0)
    assert not pulse.is_lost
