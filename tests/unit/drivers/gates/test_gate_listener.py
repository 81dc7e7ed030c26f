import random
import time
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.gates.edge_counter import EdgeCounter
from drivers.gates.gate_clock import WINDOW_NS, GateClock
from drivers.gates.gate_listener import GateListener
from drivers.gates.gate_protocol import STONEFALL, encode
from drivers.gates.gate_records import SEQUENCES, Edge, Identity, Record, Status, TestPulse, Width
from drivers.interfaces import DeviceEvent, PulseEnded, TriggersIgnored, TriggersLost
from pipeline.frames import BundleKind, Trigger

MS = 1_000_000
BAUD = 1_000_000  # 10 us a byte


class Wire:
    """A gate whose clock began at `BOOT_NS` of the host's, heard without delay but the transmission."""

    BOOT_NS = 5_000 * MS

    def __init__(self, debounce_ms: int = 10) -> None:
        self.listener = GateListener(STONEFALL, baud=BAUD, debounce_ns=debounce_ms * MS)
        self.events: list[DeviceEvent] = []

    def hear(self, at_ms: float, *records: Record, late_ms: float = 0) -> list[DeviceEvent]:
        data = b"".join(map(encode, records))
        read_ns = self.BOOT_NS + round((at_ms + late_ms) * MS) + len(data) * 10_000
        events = self.listener.hear(data, read_ns)
        self.events += events
        return events

    def edge(self, sequence: int, at_ms: float, late_ms: float = 0) -> list[DeviceEvent]:
        return self.hear(at_ms, Edge(sequence, round(at_ms * 1000)), late_ms=late_ms)

    def status(
        self, at_ms: float, last: int, *, ignored: int = 0, blocked: bool = False
    ) -> list[DeviceEvent]:
        us = round(at_ms * 1000)
        return self.hear(at_ms, Status(device_us=us, last_sequence=last, ignored=ignored, is_blocked=blocked))


def kinds(events: list[DeviceEvent]) -> list[tuple[str, int]]:
    """Each event's type, and its count or number."""
    return [
        (type(event).__name__, getattr(event, "count", getattr(event, "sequence", 0))) for event in events
    ]


class TestListening:
    def test_a_stone_is_a_trigger_and_later_its_width(self) -> None:
        wire = Wire()
        (trigger,) = wire.edge(1, 100)
        assert isinstance(trigger, Trigger)
        assert (trigger.sequence, trigger.kind, trigger.device_ns) == (1, BundleKind.PARTICLE, 100 * MS)
        assert trigger.received_ns == wire.BOOT_NS + 100 * MS
        assert wire.hear(155, Width(1, 55_000)) == []
        assert kinds(wire.hear(164)) == []
        (ended,) = wire.hear(165.1)
        assert isinstance(ended, PulseEnded)
        assert (ended.sequence, ended.width_ns) == (1, 55 * MS)

    def test_utc_is_that_of_the_edge(self) -> None:
        listener = GateListener(STONEFALL, baud=BAUD, debounce_ns=0)
        (trigger,) = listener.hear(encode(Edge(1, 2)), time.monotonic_ns() - 3_600_000 * MS)
        assert isinstance(trigger, Trigger)
        hour_ago = time.gmtime(time.time() - 3600)
        assert trigger.utc.startswith(time.strftime("%Y-%m-%dT%H:", hour_ago))
        assert trigger.utc.endswith("Z")

    def test_a_test_pulse_is_background(self) -> None:
        (trigger,) = Wire().hear(1, TestPulse(1, 1000))
        assert isinstance(trigger, Trigger)
        assert trigger.kind is BundleKind.BACKGROUND

    def test_two_edges_of_one_stone_are_one_trigger_and_one_bounce(self) -> None:  # D1
        wire = Wire()
        wire.edge(1, 100)
        wire.hear(102, Width(1, 2000))
        wire.edge(2, 103)
        wire.hear(150, Width(2, 47_000))
        wire.hear(161)
        assert kinds(wire.events) == [("Trigger", 1), ("TriggersIgnored", 1), ("PulseEnded", 1)]
        assert wire.events[1] == TriggersIgnored(
            received_ns=wire.BOOT_NS + 103 * MS, count=1, reason="bounce"
        )
        assert isinstance(wire.events[2], PulseEnded)
        assert wire.events[2].width_ns == 50 * MS

    def test_stones_faster_than_the_dead_time_are_all_told(self) -> None:  # D6
        wire = Wire()
        for number in range(1, 21):
            wire.edge(number, 50 * number)
        assert kinds(wire.events) == [("Trigger", number) for number in range(1, 21)]

    def test_what_the_gate_merged_is_told_by_its_status(self) -> None:
        wire = Wire()
        assert wire.status(1000, 0, ignored=7) == []  # before anyone listened
        assert kinds(wire.status(2000, 0, ignored=10)) == [("TriggersIgnored", 3)]
        assert wire.status(3000, 0, ignored=10) == []

    def test_lost_lines_are_told_by_the_next_number(self) -> None:
        wire = Wire()
        wire.edge(1, 100)
        assert kinds(wire.edge(4, 900)) == [("TriggersLost", 2), ("Trigger", 4)]
        assert kinds(wire.status(1000, 6)) == [("TriggersLost", 2)]
        assert kinds(wire.edge(7, 1100)) == [("Trigger", 7)]
        assert wire.listener.counters.missed == 4

    def test_a_repeated_line_is_no_second_stone(self) -> None:
        wire = Wire()
        wire.edge(1, 100)
        wire.status(1000, 1)
        assert kinds(wire.edge(1, 100)) == [("TriggersIgnored", 1)]
        assert wire.listener.counters.repeated == 1
        assert wire.listener.counters.restarts == 0

    def test_a_restart_is_no_absurd_gap_and_numbers_go_on(self) -> None:
        wire = Wire()
        wire.edge(5000, 60_000)
        wire.BOOT_NS = wire.BOOT_NS + 61_000 * MS
        assert wire.status(1000, 0) == []
        (trigger,) = wire.edge(1, 1500)
        assert isinstance(trigger, Trigger)
        assert (trigger.sequence, trigger.received_ns) == (5001, wire.BOOT_NS + 1500 * MS)
        assert wire.listener.counters.restarts == 1
        wire.BOOT_NS = wire.BOOT_NS + 2_000 * MS
        assert kinds(wire.edge(3, 400)) == [("TriggersLost", 2), ("Trigger", 5004)]

    def test_how_long_the_beam_is_blocked(self) -> None:
        wire = Wire()
        now_ns = wire.BOOT_NS + 4000 * MS
        wire.status(1000, 0)
        assert wire.listener.blocked_s(now_ns) == 0
        wire.status(2000, 0, blocked=True)
        wire.status(3000, 0, blocked=True)
        assert wire.listener.blocked_s(now_ns) == pytest.approx(2, abs=0.01)
        wire.status(4000, 0)
        assert wire.listener.blocked_s(now_ns) == 0

    def test_a_width_without_its_edge_says_nothing(self) -> None:
        wire = Wire()
        assert wire.hear(1, Width(1, 50_000)) == []
        wire.edge(2, 100)
        wire.hear(200, Width(1, 50_000))
        assert kinds(wire.hear(300)) == []

    @given(st.lists(st.binary(max_size=50)))
    def test_garbage_does_nothing_but_count(self, pieces: list[bytes]) -> None:
        wire = Wire()
        wire.edge(1, 100)
        for piece in pieces:
            wire.listener.hear(piece.replace(b"$", b"%"), wire.BOOT_NS + 200 * MS)
        wire.hear(250, Identity(name="a", serial="b", version="c"))
        assert kinds(wire.edge(2, 300)) == [("Trigger", 2)]
        assert wire.listener.counters.lines == 2 + (wire.listener.identity is not None)


class TestClock:
    def test_the_promptest_line_dates_the_others(self) -> None:
        wire = Wire()
        wire.status(1000, 0)
        (trigger,) = wire.edge(1, 1500, late_ms=16)
        assert isinstance(trigger, Trigger)
        assert trigger.received_ns == wire.BOOT_NS + 1500 * MS

    @pytest.mark.parametrize("lines_a_second", [1, 5])
    @pytest.mark.parametrize("drift_ppm", [-100, 0, 100])
    def test_latency_and_drift_leave_a_few_milliseconds(self, drift_ppm: int, lines_a_second: int) -> None:
        clock, dice = GateClock(), random.Random(1)  # noqa: S311 - nothing secret
        errors_ms = []
        for number in range(600 * lines_a_second):
            true_ns = 1000 * MS * number // lines_a_second
            latest_ns = true_ns + round(dice.uniform(1, 16) * MS)  # a USB converter's latency timer
            device_ns = true_ns + true_ns * drift_ppm // 1_000_000 + 77 * MS
            error_ns = clock.host_ns(device_ns, latest_ns) - true_ns
            assert error_ns <= latest_ns - true_ns
            errors_ms.append(error_ns / MS)
        settled_ms = sorted(errors_ms[20 * lines_a_second :])
        assert settled_ms[0] > 1 - 2.1  # the least latency, less the drift within the window
        assert settled_ms[len(settled_ms) * 9 // 10] < 5
        assert settled_ms[-1] < 8

    def test_a_stall_of_the_host_is_not_taken_for_time(self) -> None:
        clock = GateClock()
        clock.host_ns(0, 1 * MS)
        assert clock.host_ns(1000 * MS, 1400 * MS) == 1001 * MS

    def test_old_lines_do_not_count(self) -> None:
        clock = GateClock()
        clock.host_ns(0, 0)
        later_ns = WINDOW_NS + 3 * MS
        assert clock.host_ns(later_ns - 3 * MS, later_ns) == later_ns

    def test_before_the_first_line_there_is_no_device_time(self) -> None:
        assert GateClock().device_ns(0) is None


class TestCounter:
    @given(st.integers(0, SEQUENCES - 1), st.lists(st.tuples(st.booleans(), st.integers(0, 9)), min_size=1))
    def test_everything_counted_is_told_or_missed_over_every_wrap(
        self, first: int, steps: list[tuple[bool, int]]
    ) -> None:
        counter = EdgeCounter()
        told = [counter.status(first, 0).sequence]
        true = first
        for number, (is_edge, n_unheard) in enumerate(steps, start=1):
            true += n_unheard + is_edge
            take = counter.edge if is_edge else counter.status
            step = take(true % SEQUENCES, number * 1000)
            assert (step.sequence, step.missed) == (true, n_unheard)
            assert not step.has_restarted
            told.append(step.sequence)
        assert all(later >= earlier for earlier, later in pairwise(told))

    def test_an_edge_told_after_a_later_status_is_no_restart(self) -> None:
        counter = EdgeCounter()
        counter.status(0, 5_000_000)
        step = counter.edge(1, 4_999_990)
        assert (step.sequence, step.missed, step.has_restarted) == (1, 0, False)

    def test_a_number_that_goes_back_is_a_restart_also_after_a_long_silence(self) -> None:
        counter = EdgeCounter()
        counter.edge(1000, 10_000_000)
        step = counter.status(40, 900_000_000)
        assert (step.sequence, step.missed, step.has_restarted) == (1040, 40, True)

    def test_the_same_number_after_a_restart_is_another_edge(self) -> None:
        counter = EdgeCounter()
        counter.edge(1, 10_000_000)
        step = counter.edge(1, 3_000_000)
        assert (step.sequence, step.is_repeated, step.has_restarted) == (2, False, True)

    def test_no_more_is_missed_than_can_have_fallen(self) -> None:
        counter = EdgeCounter()
        counter.edge(7, 10_000_000)
        step = counter.status(67, 11_000_000)  # 50 in a second, and 10 at once
        assert (step.sequence, step.missed, step.has_restarted) == (67, 60, False)
        step = counter.edge(1_000_000, 12_000_000)
        assert (step.sequence, step.missed, step.has_restarted) == (68, None, True)
        step = counter.edge(900_000, 2_000_000)  # a restart, two seconds ago
        assert (step.sequence, step.missed, step.has_restarted) == (69, None, True)
        step = counter.edge(900_002, 3_000_000)
        assert (step.sequence, step.missed, step.has_restarted) == (71, 1, False)


def test_lines_that_come_late_are_told_for_a_minute() -> None:
    wire = Wire()
    for number in range(1, 4):
        wire.status(1000 * number, 0)
    wire.edge(1, 3500, late_ms=120)
    assert wire.listener.troubles(wire.BOOT_NS + 4000 * MS) == []
    wire.edge(2, 4500, late_ms=280)
    wire.edge(3, 5500, late_ms=220)
    (trouble,) = wire.listener.troubles(wire.BOOT_NS + 6000 * MS)
    assert trouble.startswith("2 lines within the last minute came up to 280 ms late (2 since the start)")
    assert "converter" in trouble
    assert wire.listener.troubles(wire.BOOT_NS + 70_000 * MS) == []


def test_a_counter_that_jumps_is_a_warning_and_no_loss(caplog: pytest.LogCaptureFixture) -> None:
    wire = Wire()
    wire.edge(5, 1000)
    (trigger,) = wire.edge(5_000_000, 2000)
    assert isinstance(trigger, Trigger)
    assert trigger.sequence == 6
    assert "an unknown number" in caplog.text
    (trouble,) = wire.listener.troubles(wire.BOOT_NS + 3000 * MS)
    assert "was restarted within the last minute" in trouble
    assert wire.listener.troubles(wire.BOOT_NS + 63_000 * MS) == []
    assert (wire.listener.counters.missed, wire.listener.counters.restarts) == (0, 1)


def test_another_gate_on_the_same_port_owes_nothing(caplog: pytest.LogCaptureFixture) -> None:
    wire = Wire()
    wire.hear(0, Identity(name="gate", serial="1", version="1"))
    wire.edge(5, 1000)
    wire.listener.reopen()
    assert wire.status(86_400_000, 300_000, ignored=70_000) == []  # before it said who it is
    assert wire.listener.n_statuses == 0
    assert wire.hear(86_400_001, Identity(name="gate", serial="2", version="1")) == []
    assert wire.status(86_400_002, 300_000, ignored=70_000) == []
    assert "serial='2'" in caplog.text
    (trigger,) = wire.edge(300_001, 86_400_500)
    assert isinstance(trigger, Trigger)
    assert trigger.sequence == 6
    assert wire.listener.counters.missed == 0
    wire.listener.reopen()
    wire.hear(86_401_000, Identity(name="gate", serial="2", version="1"))
    assert kinds(wire.status(86_402_000, 300_004, ignored=70_000)) == [
        ("TriggersLost", 3)
    ]  # the same: what it counted is lost


def test_the_gap_of_a_restart_says_so() -> None:
    wire = Wire()
    wire.edge(9, 60_000)
    lost, _ = wire.hear(62_000, Edge(3, 1_000_000))
    assert isinstance(lost, TriggersLost)
    assert (lost.count, lost.reason) == (2, "the gate restarted")
