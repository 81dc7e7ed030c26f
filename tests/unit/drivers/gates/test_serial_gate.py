import errno
import os
import random
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from support.eventually import eventually
from support.pty_gate import PtyGate, pty_settings, serial_gate
from support.sinks import Collector

from drivers.errors import GateUnavailableError
from drivers.gates.gate_protocol import encode
from drivers.gates.gate_records import Edge, Identity
from drivers.gates.gate_thread import port_problem
from drivers.gates.serial_gate import SerialGate, SerialGateSettings
from drivers.interfaces import GateLost, PulseEnded, TriggersIgnored, TriggersLost
from pipeline.frames import BundleKind, GateCount, Trigger


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[SerialGate, PtyGate]]:
    with serial_gate(tmp_path / "gate") as pair:
        yield pair


@pytest.fixture
def gate(pair: tuple[SerialGate, PtyGate]) -> SerialGate:
    return pair[0]


@pytest.fixture
def device(pair: tuple[SerialGate, PtyGate]) -> PtyGate:
    return pair[1]


@pytest.fixture
def settings(device: PtyGate) -> SerialGateSettings:
    return pty_settings(device.link)


@pytest.fixture
def sink(gate: SerialGate) -> Collector:
    """Of the opened and armed gate."""
    sink = Collector()
    gate.open()
    gate.arm(sink)
    return sink


def test_it_knows_whom_it_talks_to(gate: SerialGate) -> None:
    gate.open()
    assert gate.identity == Identity(name="pty-gate", serial="7", version="1.0")
    gate.open()


def test_stones_come_with_their_widths(device: PtyGate, sink: Collector) -> None:
    for number in (1, 2):
        edge = device.edge(width_us=20)
        trigger, ended = sink.next(), sink.next()
        assert isinstance(trigger, Trigger)
        assert trigger.sequence == edge.sequence == number
        assert trigger.device_ns == edge.device_us * 1000
        assert isinstance(ended, PulseEnded)
        assert (ended.sequence, ended.width_ns) == (number, 20_000)


def test_the_time_is_that_of_the_edge(device: PtyGate, sink: Collector) -> None:
    edge = Edge(1, device.device_us - 40_000)
    device.status()  # at once
    device.send(edge)  # 40 ms late
    trigger = sink.next()
    assert isinstance(trigger, Trigger)
    true_ns = device.host_ns(edge.device_us)
    assert abs(trigger.received_ns - true_ns) < 20e6  # less than it was late, for a busy machine


def test_two_edges_3_ms_apart_are_one_stone(device: PtyGate, settings: SerialGateSettings) -> None:  # D1
    gate = SerialGate(replace(settings, debounce_us=10_000))
    try:
        gate.open()
        gate.arm(sink := Collector())
        now_us = device.device_us
        device.edge(at_us=now_us)
        device.edge(at_us=now_us + 3000)
        assert isinstance(sink.next(), Trigger)
        bounce = sink.next()
        assert isinstance(bounce, TriggersIgnored)
        assert (bounce.count, bounce.reason) == (1, "bounce")
    finally:
        gate.close()


def test_garbage_and_half_lines_cost_nothing_but_themselves(
    device: PtyGate, gate: SerialGate, sink: Collector
) -> None:  # D8
    dice = random.Random(5)  # noqa: S311 - nothing secret
    for number in range(1, 21):
        device.send_bytes(dice.randbytes(dice.randrange(200)) + dice.choice([b"", b"\n", b"$E,7,1"]))
        edge = device.edge()
        assert edge.sequence == number
    triggers = [sink.next() for _ in range(20)]
    assert [getattr(event, "sequence", event) for event in triggers] == list(range(1, 21))
    assert gate.counters.garbage > 0
    assert gate.counters.missed == 0


def test_a_damaged_line_is_a_stone_that_the_counter_misses(device: PtyGate, sink: Collector) -> None:  # D8
    device.edge()
    line = encode(device.edge(is_told=False))
    device.send_bytes(line[:-7])
    device.edge()
    events = [sink.next() for _ in range(3)]
    assert [type(event) for event in events] == [Trigger, TriggersLost, Trigger]
    assert isinstance(events[1], TriggersLost)
    assert events[1].count == 1
    device.edge(is_told=False)
    device.status()
    assert isinstance(sink.next(), TriggersLost)


def test_unplugged_and_plugged_in_again_it_knows_what_it_missed(
    device: PtyGate, gate: SerialGate, sink: Collector
) -> None:  # D8
    device.edge()
    assert isinstance(sink.next(), Trigger)
    device.unplug()
    lost = sink.next()
    assert isinstance(lost, GateLost)
    assert str(device.link) in lost.reason
    with pytest.raises(GateUnavailableError, match="is gone"):
        gate.arm(sink)
    gate.disarm()
    gate.close()
    with pytest.raises(GateUnavailableError, match=r"gate.*no such port.*by-id"):
        gate.open()
    for _ in range(3):
        device.edge()
    device.plug()
    gate.open()
    device.edge()  # nobody is armed yet: as lost as the others
    eventually(lambda: gate.counters.edges == 2)
    gate.arm(second := Collector())
    missed = second.next()
    assert isinstance(missed, TriggersLost)
    assert missed.count == 4
    device.edge()
    trigger = second.next()
    assert isinstance(trigger, Trigger)
    assert trigger.sequence == 6
    assert [type(event) for event in sink.events] == [Trigger, GateLost]


def last_count(device: PtyGate, gate: SerialGate) -> GateCount:
    """Let a stone fall, and return what the driver's process knows of the gate when it is killed after it."""
    gate.open()
    gate.arm(sink := Collector())
    device.edge()
    trigger = sink.next()
    gate.close()
    assert isinstance(trigger, Trigger)
    assert trigger.gate_count is not None
    return trigger.gate_count


@pytest.mark.parametrize(("n_known", "n_missed"), [(0, 3), (1, 2), (3, 0), (4, 0)])
def test_the_next_process_knows_what_fell_while_none_listened(
    device: PtyGate, settings: SerialGateSettings, n_known: int, n_missed: int
) -> None:
    count = last_count(device, SerialGate(settings))
    for _ in range(3):
        device.edge()
    successor = SerialGate(settings)
    try:
        successor.resume(count, n_known)
        successor.open()
        successor.arm(sink := Collector())
        device.edge()
        events = [sink.next() for _ in range(1 + (n_missed > 0))]
        assert isinstance(events[-1], Trigger)
        assert events[-1].sequence == device.last_sequence
        for event in events[:-1]:
            assert isinstance(event, TriggersLost)
            assert (event.count, event.while_down) == (n_missed, True)
        successor.disarm()
        device.edge()
        successor.arm(later := Collector())
        device.edge()
        assert isinstance(later.next(), Trigger)  # it owes nothing any more
    finally:
        successor.close()


def test_of_another_gate_nothing_is_known(device: PtyGate, settings: SerialGateSettings) -> None:
    count = last_count(device, SerialGate(settings))
    for _ in range(3):
        device.edge()
    successor = SerialGate(settings)
    try:
        successor.resume(replace(count, gate="other,1,1"), 0)
        successor.open()
        successor.arm(sink := Collector())
        device.edge()
        assert isinstance(sink.next(), Trigger)
    finally:
        successor.close()


def test_of_a_gate_without_power_meanwhile_the_next_process_knows_what_it_counted_since(
    device: PtyGate, settings: SerialGateSettings
) -> None:
    for _ in range(5):
        device.edge()
    count = last_count(device, SerialGate(settings))
    device.restart()
    for _ in range(2):
        device.edge()
    successor = SerialGate(settings)
    try:
        successor.resume(count, 0)
        successor.open()
        successor.arm(sink := Collector())
        lost = sink.next()
        assert isinstance(lost, TriggersLost)
        assert (lost.count, lost.while_down) == (2, True)
    finally:
        successor.close()


def test_a_disarmed_gate_owes_nothing(device: PtyGate, gate: SerialGate, sink: Collector) -> None:
    device.edge()
    sink.next()
    gate.disarm()
    device.edge()
    device.edge(is_told=False)
    device.status()
    eventually(lambda: gate.counters.missed == 1)
    gate.close()
    device.edge()
    gate.open()
    gate.arm(second := Collector())
    device.edge()
    trigger = second.next()
    assert isinstance(trigger, Trigger)
    assert trigger.sequence == 5
    assert len(sink.events) == 1


def test_silence_is_a_loss(device: PtyGate, settings: SerialGateSettings) -> None:
    gate = SerialGate(replace(settings, silence_s=1.1, answer_timeout_s=0.5))
    try:
        gate.open()
        gate.arm(sink := Collector())
        lost = sink.next()
        assert isinstance(lost, GateLost)
        assert "has sent nothing for 1.1 s" in lost.reason
        device.edge()
        gate.disarm()
        device.answers = False
        with pytest.raises(GateUnavailableError, match="sends no identity and status"):
            gate.open()
        device.answers = True
        gate.open()
        gate.arm(sink)
        assert isinstance(sink.next(), TriggersLost)  # what it owed it still owes
        assert sum(isinstance(event, GateLost) for event in sink.events) == 1
    finally:
        gate.close()


def test_a_gate_that_does_not_answer_is_not_there(device: PtyGate, settings: SerialGateSettings) -> None:
    device.answers = False
    gate = SerialGate(replace(settings, answer_timeout_s=0.1))
    with pytest.raises(
        GateUnavailableError, match=r"light gate .*gate: sends no identity and status within 0.1 s"
    ):
        gate.open()
    with pytest.raises(GateUnavailableError, match="is not open"):
        gate.arm(Collector())


def test_a_port_belongs_to_one(gate: SerialGate, settings: SerialGateSettings) -> None:
    gate.open()
    with pytest.raises(GateUnavailableError, match="in use by another program"):
        SerialGate(settings).open()


def test_a_port_of_others_says_which_group_to_join() -> None:
    assert "group dialout" in port_problem(PermissionError(errno.EACCES, os.strerror(errno.EACCES)))


def test_what_is_no_port_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(GateUnavailableError, match="Could not configure port"):
        SerialGate(SerialGateSettings(port=str(tmp_path / "file"))).open()


def test_a_test_pulse_exposes_the_empty_rig(device: PtyGate, gate: SerialGate, sink: Collector) -> None:
    gate.test_pulse()
    trigger = sink.next()
    assert isinstance(trigger, Trigger)
    assert trigger.kind is BundleKind.BACKGROUND
    device.answers = False
    with pytest.raises(GateUnavailableError, match="does not answer the command for a test pulse"):
        gate.test_pulse()
    gate.disarm()
    with pytest.raises(GateUnavailableError, match="is not armed"):
        gate.test_pulse()


def test_a_blocked_beam_is_a_warning(device: PtyGate, settings: SerialGateSettings) -> None:
    gate = SerialGate(replace(settings, blocked_s=0.05))

    def blocked() -> list[str]:  # a busy machine may have others
        return [warning for warning in gate.warnings if "the beam" in warning]

    try:
        gate.open()
        assert blocked() == []
        device.is_blocked = True
        device.status()
        eventually(lambda: bool(blocked()))
        (warning,) = blocked()
        assert str(device.link) in warning
        assert "clean and align" in warning
        device.is_blocked = False
        device.status()
        eventually(lambda: not blocked())
    finally:
        gate.close()


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"port": ""}, "port must be named"),
        ({"baud": 1 << 31}, "baud must be in"),
        ({"baud": 0}, "baud must be in 300..12000000, not 0"),
        ({"debounce_us": -1}, "debounce_us must not be negative"),
        ({"answer_timeout_s": 0}, "must be positive"),
        ({"silence_s": 1.0}, "silence_s must exceed"),
    ],
)
def test_settings_that_cannot_work_are_refused(changes: dict[str, object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        SerialGateSettings(**{"port": "x", **changes})
