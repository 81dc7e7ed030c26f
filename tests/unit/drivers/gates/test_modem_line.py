import errno
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.bare_lines import FakeLine
from support.sinks import Collector

from drivers.errors import GateUnavailableError
from drivers.gates.modem_line import COUNTS, EdgesBetween, Look, ModemLineGate, ModemLineSettings
from drivers.interfaces import GateLost, PulseEnded, TriggersIgnored
from pipeline.frames import Trigger

MS = 1_000_000


MakeGate = Callable[..., tuple[ModemLineGate, Collector]]


@pytest.fixture
def make_gate() -> Iterator[MakeGate]:
    gates = []

    def make(line: FakeLine, **changes: object) -> tuple[ModemLineGate, Collector]:
        settings = ModemLineSettings(**{"port": "/dev/ttyX", "debounce_us": 5_000, **changes})
        gates.append(gate := ModemLineGate(settings, lambda _: line))
        gate.open()
        gate.arm(sink := Collector())
        return gate, sink

    yield make
    for gate in gates:
        gate.close()


@pytest.mark.parametrize("counts", [True, False])
def test_a_pulse_is_a_trigger_and_its_width(make_gate: MakeGate, counts: bool) -> None:
    _, sink = make_gate(line := FakeLine(counts=counts))
    for number in range(2):
        line.switch()
        trigger = sink.next()
        line.switch()
        ended = sink.next()
        assert isinstance(trigger, Trigger)
        assert (trigger.sequence, trigger.device_ns) == (number, 0)
        assert isinstance(ended, PulseEnded)
        assert ended.sequence == number
        assert 1 * MS <= ended.width_ns <= ended.received_ns - trigger.received_ns


def test_an_inverted_line_is_off_while_the_beam_is_closed(make_gate: MakeGate) -> None:
    _, sink = make_gate(line := FakeLine(is_on=True), is_inverted=True)
    line.switch()
    assert isinstance(sink.next(), Trigger)


def test_a_pulse_between_two_looks_is_counted_but_has_no_width(make_gate: MakeGate) -> None:
    _, sink = make_gate(line := FakeLine())
    line.switch(times=2)
    assert isinstance(sink.next(), Trigger)
    line.switch()  # after the debounce time or within: a stone or a bounce, but no width of 0
    assert isinstance(sink.next(), Trigger | TriggersIgnored)


def test_bounces_between_two_looks_are_counted(make_gate: MakeGate) -> None:
    _, sink = make_gate(line := FakeLine())
    line.switch(times=5)
    events = [sink.next() for _ in range(3)]
    assert [type(event) for event in events] == [Trigger, TriggersIgnored, TriggersIgnored]


def test_a_line_that_is_gone_is_told_once(make_gate: MakeGate) -> None:
    gate, sink = make_gate(line := FakeLine())
    line.is_gone = True
    lost = sink.next()
    assert isinstance(lost, GateLost)
    assert "/dev/ttyX CTS" in lost.reason
    with pytest.raises(GateUnavailableError, match="light gate /dev/ttyX CTS"):
        gate.open()
    line.is_gone = False
    gate.open()
    gate.arm(second := Collector())
    line.switch()
    assert isinstance(second.next(), Trigger)
    gate.close()
    assert line.is_closed
    assert len(sink.events) == 1


def test_it_delivers_nothing_while_disarmed_but_counts_on(make_gate: MakeGate) -> None:
    gate, sink = make_gate(line := FakeLine(), debounce_us=0)
    gate.disarm()
    line.switch()
    line.switch()
    gate.arm(sink)
    line.switch()
    trigger = sink.next()
    assert isinstance(trigger, Trigger)
    assert trigger.sequence == 1


def test_a_line_that_dies_while_it_is_opened_or_closed_is_let_go(make_gate: MakeGate) -> None:
    class Dying(FakeLine):
        def close(self) -> None:
            super().close()
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    line = Dying()
    line.is_gone = True
    with pytest.raises(GateUnavailableError, match="light gate /dev/ttyX CTS"):
        make_gate(line)
    assert line.is_closed


def test_it_cannot_trigger_the_cameras(make_gate: MakeGate) -> None:
    gate, _ = make_gate(FakeLine())
    with pytest.raises(GateUnavailableError, match="cannot trigger the cameras"):
        gate.test_pulse()


def test_it_must_be_open_to_be_armed() -> None:
    gate = ModemLineGate(ModemLineSettings(port="/dev/ttyX"), lambda _: FakeLine())
    with pytest.raises(GateUnavailableError, match="is not open"):
        gate.arm(Collector())
    gate.close()


def test_a_port_without_modem_lines_is_refused() -> None:
    master, slave = os.openpty()
    try:
        gate = ModemLineGate(ModemLineSettings(port=os.ttyname(slave)))
        with pytest.raises(GateUnavailableError, match="has no modem lines"):
            gate.open()
        with pytest.raises(GateUnavailableError, match="no such port"):
            ModemLineGate(ModemLineSettings(port="/dev/no-such-port")).open()
    finally:
        os.close(master)
        os.close(slave)


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 2))), st.integers(0, COUNTS - 1))
def test_edges_are_told_once_though_count_and_level_disagree(
    steps: list[tuple[int, int]], first_count: int
) -> None:
    """Between reading the count and the level, edges may come: the level is ahead of the count."""
    n_edges = first_count
    between = EdgesBetween(Look(False, n_edges))
    n_told = n_before = 0
    for n_new, n_while_reading in [*steps, (0, 0)]:
        n_before += n_new
        n_edges = first_count + n_before
        n_before += n_while_reading
        n_told += between.step(Look(n_before % 2 == 1, n_edges % COUNTS))
        assert n_told % 2 == n_before % 2
        assert n_told <= n_before
    assert n_told == n_before


def test_without_a_count_only_changes_are_told() -> None:
    between = EdgesBetween(Look(False, None))
    assert [between.step(Look(is_on, None)) for is_on in (False, True, True, False)] == [0, 1, 0, 1]


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"port": ""}, "port must be named"),
        ({"line": "DTR"}, "line must be one of CTS, DSR, RI, CD, not 'DTR'"),
        ({"debounce_us": -1}, "debounce_us must not be negative"),
    ],
)
def test_settings_that_cannot_work_are_refused(changes: dict[str, object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        ModemLineSettings(**{"port": "x", **changes})


@pytest.mark.parametrize("answer", [errno.ENOTTY, errno.EINVAL, errno.EOPNOTSUPP])
def test_a_port_without_modem_lines_is_no_broken_one(answer: int) -> None:
    def refuse(_: ModemLineSettings) -> FakeLine:
        raise OSError(answer, os.strerror(answer))

    gate = ModemLineGate(ModemLineSettings(port="/dev/ttyGS0"), refuse)
    with pytest.raises(GateUnavailableError, match="has no modem lines"):
        gate.open()


@pytest.mark.parametrize(("line", "is_refused"), [("CTS", True), ("DSR", False), ("CD", False)])
def test_cts_of_a_port_that_always_shows_it_is_refused(tmp_path: Path, line: str, is_refused: bool) -> None:
    (tmp_path / "ttyACM0").touch()
    (by_id := tmp_path / "usb-gate").symlink_to("ttyACM0")
    gate = ModemLineGate(ModemLineSettings(port=str(by_id), line=line), lambda _: FakeLine())
    if is_refused:
        with pytest.raises(
            GateUnavailableError, match=r"its port has no CTS .*: wire the sensor to DSR or CD"
        ):
            gate.open()
    else:
        gate.open()
        gate.close()
