import sys
import time
import types
from collections.abc import Iterator
from dataclasses import replace

import pytest
from support.bare_lines import FakeLines
from support.sinks import Collector

from drivers.errors import GateUnavailableError
from drivers.gates.gpio import GpioGate, GpioGateSettings
from drivers.interfaces import GateLost, PulseEnded, TriggersIgnored, TriggersLost
from pipeline.frames import BundleKind, Trigger

MS = 1_000_000
SETTINGS = GpioGateSettings(chip="/dev/gpiochip9", line="gate", test_line=5, test_pulse_us=500)


@pytest.fixture
def lines() -> FakeLines:
    return FakeLines()


@pytest.fixture
def gate(lines: FakeLines) -> Iterator[GpioGate]:
    gate = GpioGate(SETTINGS, lambda _: lines)
    yield gate
    gate.close()


@pytest.fixture
def sink(gate: GpioGate) -> Collector:
    """Of the opened and armed gate."""
    gate.open()
    gate.arm(sink := Collector())
    return sink


def test_a_pulse_is_a_trigger_at_the_kernels_time_and_its_width(lines: FakeLines, sink: Collector) -> None:
    now_ns = time.monotonic_ns() - 1000 * MS
    for number in range(2):
        at_ns = now_ns + number * 250 * MS
        lines.edge(True, at_ns)
        lines.edge(False, at_ns + 55 * MS)
        trigger, ended = sink.next(), sink.next()
        assert isinstance(trigger, Trigger)
        assert (trigger.sequence, trigger.received_ns, trigger.device_ns) == (number, at_ns, 0)
        assert isinstance(ended, PulseEnded)
        assert (ended.sequence, ended.width_ns) == (number, 55 * MS)


def test_two_edges_3_ms_apart_are_one_stone(lines: FakeLines, sink: Collector) -> None:  # D1
    lines.edges((True, 0), (False, 1 * MS), (True, 3 * MS), (False, 50 * MS))
    events = [sink.next() for _ in range(3)]
    assert [type(event) for event in events] == [Trigger, TriggersIgnored, PulseEnded]
    assert isinstance(events[2], PulseEnded)
    assert events[2].width_ns == 50 * MS


@pytest.mark.parametrize(("n_dropped", "n_stones"), [(1, 0), (2, 1), (3, 1), (4, 2)])
def test_edges_the_kernel_dropped_are_lost_stones(
    lines: FakeLines, sink: Collector, n_dropped: int, n_stones: int
) -> None:  # D9: overflow
    lines.edge(True, 0)
    assert isinstance(sink.next(), Trigger)
    lines.n_edges += n_dropped
    if n_dropped % 2 == 0:  # the last one dropped closed the beam
        lines.edge(False, 900 * MS)
    lines.edge(True, 1000 * MS)
    if n_stones:
        lost = sink.next()
        assert isinstance(lost, TriggersLost)
        assert (lost.count, lost.reason) == (n_stones, f"{n_dropped} edges dropped by the kernel")
    trigger = sink.next()
    assert isinstance(trigger, Trigger)
    assert trigger.sequence == 1 + n_stones


def test_two_openings_in_a_row_are_a_stone_that_one_interrupt_hid(lines: FakeLines, sink: Collector) -> None:
    lines.edges((True, 0), (False, 55 * MS), (False, 300 * MS), (True, 600 * MS))
    events = [sink.next() for _ in range(4)]
    assert [type(event) for event in events] == [Trigger, PulseEnded, TriggersLost, Trigger]
    assert isinstance(events[2], TriggersLost)
    assert (events[2].count, "one interrupt" in events[2].reason) == (1, True)
    assert isinstance(events[3], Trigger)
    assert events[3].sequence == 2


def test_a_second_opening_within_the_debounce_time_is_a_bounce(lines: FakeLines, sink: Collector) -> None:
    lines.edges((False, -900 * MS), (True, 0), (False, 55 * MS), (False, 57 * MS), (True, 600 * MS))
    assert [type(sink.next()) for _ in range(3)] == [Trigger, PulseEnded, Trigger]


def test_two_closings_in_a_row_are_two_stones(lines: FakeLines, sink: Collector) -> None:
    lines.edges((True, 0), (True, 300 * MS), (False, 355 * MS), (True, 600 * MS))
    events = [sink.next() for _ in range(4)]
    assert [type(event) for event in events] == [Trigger, Trigger, PulseEnded, Trigger]


def test_a_chip_that_vanishes_is_a_loss(lines: FakeLines, gate: GpioGate, sink: Collector) -> None:  # D9
    lines.vanish()
    lost = sink.next()
    assert isinstance(lost, GateLost)
    assert "/dev/gpiochip9 gate" in lost.reason
    assert "No such device" in lost.reason
    with pytest.raises(GateUnavailableError, match="is gone"):
        gate.arm(sink)
    gate.disarm()
    gate.close()
    assert lines.is_closed
    lines.n_edges = 0  # a new request counts anew
    gate.open()
    gate.arm(sink)
    lines.edge(True, 0)
    assert isinstance(sink.next(), Trigger)


def test_what_the_kernel_swallowed_took_time(lines: FakeLines) -> None:
    gate = GpioGate(replace(SETTINGS, glitch_us=200), lambda _: lines)
    try:
        gate.open()
        gate.arm(sink := Collector())
        lines.edge(True, 10 * MS)
        trigger = sink.next()
        assert isinstance(trigger, Trigger)
        assert trigger.received_ns == 10 * MS - 200_000
    finally:
        gate.close()


@pytest.mark.parametrize(("echoes", "drive_s"), [(True, 0.0), (True, 0.01), (False, 0.0)])
def test_a_test_pulse_is_one_exposure_whether_the_input_sees_it_or_not(
    lines: FakeLines, gate: GpioGate, sink: Collector, echoes: bool, drive_s: float
) -> None:
    lines.echoes, lines.drive_s = echoes, drive_s
    before_ns = time.monotonic_ns()
    gate.test_pulse()
    assert lines.driven == [(5, True), (5, False)]
    trigger = sink.next()
    assert isinstance(trigger, Trigger)
    assert (trigger.sequence, trigger.kind) == (0, BundleKind.BACKGROUND)
    assert before_ns <= trigger.received_ns <= time.monotonic_ns()
    lines.edge(True, time.monotonic_ns() + 100 * MS)
    stone = sink.next()
    assert isinstance(stone, Trigger)
    assert (stone.sequence, stone.kind) == (1, BundleKind.PARTICLE)


def test_test_pulses_need_a_line_and_an_armed_gate(lines: FakeLines, gate: GpioGate) -> None:
    with pytest.raises(GateUnavailableError, match="is not armed"):
        gate.test_pulse()
    without = GpioGate(replace(SETTINGS, test_line=None), lambda _: lines)
    with pytest.raises(GateUnavailableError, match="has no test line"):
        without.test_pulse()


def test_it_must_be_open_to_be_armed(gate: GpioGate) -> None:
    with pytest.raises(GateUnavailableError, match="light gate /dev/gpiochip9 gate: is not open"):
        gate.arm(Collector())


def test_a_chip_that_is_not_there_is_refused_by_the_real_library() -> None:
    gate = GpioGate(replace(SETTINGS, chip="/dev/no-such-chip"))
    with pytest.raises(GateUnavailableError, match=r"no-such-chip gate: cannot be opened: .*group dialout"):
        gate.open()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"chip": ""}, "chip must be named"),
        ({"test_line": "gate"}, "test_line must be another line than gate"),
        ({"debounce_us": -1}, "debounce_us must be in 0..1000000, not -1"),
        ({"glitch_us": 1 << 40}, "glitch_us must be in"),
        ({"line": 1 << 32}, "offset must be in"),
        ({"test_pulse_us": 0}, "test_pulse_us must be in"),
    ],
)
def test_settings_that_cannot_work_are_refused(changes: dict[str, object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        replace(SETTINGS, **changes)


def test_the_library_of_another_version_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gpiod", types.ModuleType("gpiod"))  # 1.x has neither line nor EdgeEvent
    with pytest.raises(GateUnavailableError, match=r"gpiod is missing, or is 1\.x: install 2\.x"):
        GpioGate(SETTINGS).open()
