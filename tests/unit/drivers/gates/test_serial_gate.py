import errno
import grp
import os
import random
import re
import termios
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from support.eventually import eventually
from support.pty_gate import PtyGate, pty_settings, serial_gate
from support.sinks import Collector

from drivers.errors import GateUnavailableError
from drivers.gates.gate_listener import GateListener
from drivers.gates.gate_protocol import FIRMWARE_NAME, FIRMWARE_VERSION, STONEFALL, checksum, encode
from drivers.gates.gate_records import CameraPulses, Edge, Identity
from drivers.gates.port import keep_port, port_problem
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


def three_fallen_meanwhile(device: PtyGate, settings: SerialGateSettings) -> tuple[GateCount, SerialGate]:
    """Return the count at the end of one process, and the gate of the next: three edges came between."""
    count = last_count(device, SerialGate(settings))
    for _ in range(3):
        device.edge()
    return count, SerialGate(settings)


@pytest.mark.parametrize(("n_known", "n_missed"), [(0, 3), (1, 2), (3, 0), (4, 0)])
def test_the_next_process_knows_what_fell_while_none_listened(
    device: PtyGate, settings: SerialGateSettings, n_known: int, n_missed: int
) -> None:
    count, successor = three_fallen_meanwhile(device, settings)
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


@pytest.mark.parametrize(
    "at", ["2026-11-28T19:00:00.000Z", "2099-01-01T00:00:00Z", "yesterday", "2026-11-28T19:00:00"]
)
def test_no_time_that_was_noted_with_the_count_hinders_it(
    device: PtyGate, settings: SerialGateSettings, at: str
) -> None:
    count, successor = three_fallen_meanwhile(device, settings)
    try:
        successor.resume(replace(count, at=at), 0)
        successor.open()
        successor.arm(sink := Collector())
        lost = sink.next()
        assert isinstance(lost, TriggersLost)
        assert lost.count == 3
    finally:
        successor.close()


def test_of_another_gate_nothing_is_known(device: PtyGate, settings: SerialGateSettings) -> None:
    count, successor = three_fallen_meanwhile(device, settings)
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


def test_a_port_of_others_says_which_group_to_join(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    denied = PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    assert "the group dialout, to which" in port_problem(denied, str(tmp_path / "unreadable" / "port"))
    (port := tmp_path / "port").touch()
    groups = {port.stat().st_gid: "plugdev"}
    monkeypatch.setattr("grp.getgrgid", lambda gid: grp.struct_group((groups[gid], "x", gid, [])))
    assert "the group plugdev, to which" in port_problem(
        denied, str(port)
    )  # some give their ports to another one
    groups.clear()
    assert f"the group {port.stat().st_gid}, to which" in port_problem(denied, str(port))


def test_closing_a_port_leaves_its_lines_up(device: PtyGate, gate: SerialGate) -> None:
    """DTR that falls at each end of the daemon resets many boards, with all that they had counted."""
    fd = os.open(device.link, os.O_RDWR | os.O_NOCTTY)
    try:
        mode = termios.tcgetattr(fd)
        mode[2] |= termios.HUPCL
        termios.tcsetattr(fd, termios.TCSANOW, mode)
        gate.open()
        gate.close()
        assert not termios.tcgetattr(fd)[2] & termios.HUPCL
    finally:
        os.close(fd)


@pytest.mark.parametrize("is_pty", [False, True])
def test_no_other_program_may_read_the_port(
    device: PtyGate, monkeypatch: pytest.MonkeyPatch, is_pty: bool
) -> None:
    """A pseudo-terminal would keep the mark for the next process."""
    asked: list[int] = []
    monkeypatch.setattr("fcntl.ioctl", lambda _, request: asked.append(request))
    if not is_pty:
        monkeypatch.setattr("drivers.gates.port.PTY_MAJORS", range(0))
    fd = os.open(device.link, os.O_RDWR | os.O_NOCTTY)
    try:
        keep_port(fd)
    finally:
        os.close(fd)
    assert asked == [] if is_pty else [termios.TIOCEXCL]


def test_a_port_that_cannot_be_kept_is_used_as_it_is(tmp_path: Path) -> None:
    with (tmp_path / "file").open("w") as file:
        keep_port(file.fileno())


NOISE = bytes([0xFF, 0x80, 0xF8, 0x7C, 0x1E, 0x06])
FOREIGN = b"beam broken, 17 objects\r\n"


@pytest.mark.parametrize(
    ("received", "problem"),
    [
        (NOISE * 30 + b"\n", "sends damaged lines only: [1-9][0-9]* and no valid one within 0.3 s"),
        (NOISE, "sends damaged lines only: [0-9]+ and no valid one"),  # no line end is among it
        (FOREIGN, 'sends text, but within 0.3 s no line of the protocol.*"beam broken, 17 objects"'),
        (b"$S,1,2,0,0*abcd\r", r'sends text, but .*"\$S,1,2,0,0\*abcd"'),
    ],
)
def test_what_cannot_be_read_is_noise_or_text_of_others(received: bytes, problem: str) -> None:
    listener = GateListener(STONEFALL, baud=115_200, debounce_ns=1000)
    for _ in range(10):
        listener.hear(received, 0)
    assert re.search(problem, listener.not_understood(0.3) or "")
    listener.reopen()
    assert listener.not_understood(0.3) is None


@pytest.mark.parametrize(
    ("sent", "problem"),
    [
        (NOISE * 30 + b"\n", "sends damaged lines only: [1-9][0-9]* and no valid one within 1 s"),
        (b"", r"sends no identity and status within 1 s \(0 damaged lines\)"),
    ],
)
def test_what_cannot_be_read_is_no_silence_when_it_is_opened(
    device: PtyGate, settings: SerialGateSettings, sent: bytes, problem: str
) -> None:
    device.answers = False
    sending = threading.Event()
    sender = threading.Thread(target=send_until, args=(sending, device, sent))
    sender.start()
    try:
        with pytest.raises(GateUnavailableError, match=problem):
            SerialGate(replace(settings, answer_timeout_s=1.0)).open()
    finally:
        sending.set()
        sender.join()


def send_until(stopping: threading.Event, device: PtyGate, data: bytes) -> None:
    while not stopping.wait(0.02):
        device.send_bytes(data)


@pytest.mark.parametrize(
    ("sent", "problem"),
    [(NOISE * 30, "sends damaged lines only"), (FOREIGN, "sends text"), (b"", "has sent nothing for 1.1 s")],
)
def test_what_cannot_be_read_is_no_silence_of_an_armed_gate(
    device: PtyGate, settings: SerialGateSettings, sent: bytes, problem: str
) -> None:
    gate = SerialGate(replace(settings, silence_s=1.1))
    sending = threading.Event()
    sender = threading.Thread(target=send_until, args=(sending, device, sent))
    try:
        gate.open()
        gate.arm(sink := Collector())
        sender.start()
        lost = sink.next()
        assert isinstance(lost, GateLost)
        assert problem in lost.reason
    finally:
        sending.set()
        sender.join()
        gate.close()


def test_opening_waits_its_own_time_and_no_silence(device: PtyGate, settings: SerialGateSettings) -> None:
    """However the two times are set, an opening that fails says that the gate did not answer."""
    device.answers = False
    gate = SerialGate(replace(settings, answer_timeout_s=1.3, silence_s=1.1))
    with pytest.raises(GateUnavailableError, match=r"sends no identity and status within 1\.3 s"):
        gate.open()


def test_whole_lines_of_another_version_are_left_out_and_named(
    device: PtyGate, gate: SerialGate, sink: Collector
) -> None:
    for body in (b"V,24.1,3.3", b"E,007,12"):  # a record to come, and a number out of form
        device.send_bytes(b"$%b*%04X\r\n" % (body, checksum(body)))
    device.edge()
    assert isinstance(sink.next(), Trigger)
    assert (gate.counters.unknown, gate.counters.garbage) == (2, 0)
    (warning,) = [text for text in gate.warnings if "does not know" in text]
    assert "sent 2 lines with a valid checksum within the last minute" in warning
    assert '"$E,007,12*' in warning


@pytest.mark.parametrize(
    ("name", "version", "is_old"),
    [
        (FIRMWARE_NAME, "0.9", True),
        (FIRMWARE_NAME, "0.10", True),
        (FIRMWARE_NAME, FIRMWARE_VERSION, False),
        (FIRMWARE_NAME, f"{FIRMWARE_VERSION}.1", False),
        (FIRMWARE_NAME, "100.0", False),
        ("other-gate", "0.9", False),
    ],
)
def test_an_old_firmware_of_ours_is_named(
    device: PtyGate, gate: SerialGate, name: str, version: str, is_old: bool
) -> None:
    device.identity = Identity(name=name, serial="7", version=version)
    gate.open()
    named = [warning for warning in gate.warnings if f"its firmware is version {version}" in warning]
    assert bool(named) == is_old


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


AT_ONCE = CameraPulses(delay_us=0, pulse_us=100, places=8, unmade=0)


def test_the_delay_is_set_when_the_gate_is_opened_and_only_if_it_is_another(tmp_path: Path) -> None:
    with serial_gate(tmp_path / "gate", delay_us=247_350) as (gate, device):
        device.pulses = AT_ONCE
        gate.open()
        assert gate.pulses == device.pulses == replace(AT_ONCE, delay_us=247_350)
        gate.close()
        device.longest_delay_us = 0  # it would refuse to be set again
        gate.open()
        assert gate.pulses == replace(AT_ONCE, delay_us=247_350)


def test_a_delay_left_over_from_another_rig_is_put_back(gate: SerialGate, device: PtyGate) -> None:
    device.pulses = replace(AT_ONCE, delay_us=200_000)
    gate.open()
    assert device.pulses == AT_ONCE


def test_a_gate_that_cannot_delay_is_refused_where_the_cameras_count_on_it(tmp_path: Path) -> None:
    with serial_gate(tmp_path / "gate", delay_us=247_350) as (gate, device):
        with pytest.raises(GateUnavailableError, match="makes no delay, and 247350 us are wanted of it"):
            gate.open()
        device.pulses, device.longest_delay_us = AT_ONCE, 100_000
        with pytest.raises(
            GateUnavailableError, match=r"cannot be set to a delay of 247350 us .* stays at 0 us"
        ):
            gate.open()
        device.longest_delay_us = 300_000
        gate.open()


def test_a_gate_that_forgets_its_delay_is_lost_until_it_is_set_again(tmp_path: Path) -> None:
    with serial_gate(tmp_path / "gate", delay_us=247_350) as (gate, device):
        device.pulses = AT_ONCE
        gate.open()
        gate.arm(sink := Collector())
        device.edge()
        assert isinstance(sink.next(), Trigger)
        device.restart()  # unseen by the line; its memory is damaged
        device.pulses = AT_ONCE
        device.edge()
        while not isinstance(lost := sink.next(), GateLost):
            pass
        assert "makes a delay of 0 us" in lost.reason
        gate.open()
        gate.arm(Collector())
        assert gate.pulses == replace(AT_ONCE, delay_us=247_350)


def test_pulses_without_a_place_are_told_for_a_minute(device: PtyGate, gate: SerialGate) -> None:
    device.pulses = replace(AT_ONCE, unmade=3)
    gate.open()
    assert gate.warnings == ()
    device.send(replace(AT_ONCE, unmade=5))
    eventually(lambda: gate.counters.unmade == 2)
    (warning,) = gate.warnings
    assert "did not trigger the cameras 2 times within the last minute, as 8 pulses waited" in warning
