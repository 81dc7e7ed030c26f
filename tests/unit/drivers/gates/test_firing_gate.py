import pytest
from support.sinks import Collector

from drivers.errors import CameraUnavailableError, GateUnavailableError
from drivers.gates.firing import FiringGate
from drivers.interfaces import DeviceEvent, EventSink, GateLost, PulseEnded, TriggersIgnored
from pipeline.frames import BundleKind, Trigger


class HandGate:
    """A gate whose edges the test makes."""

    def __init__(self) -> None:
        self.sink: EventSink | None = None
        self.is_open = False

    def open(self) -> None:
        self.is_open = True

    def arm(self, sink: EventSink) -> None:
        if not self.is_open:
            raise GateUnavailableError("light gate", "is not open")
        self.sink = sink

    def test_pulse(self) -> None:
        raise GateUnavailableError("light gate", "cannot trigger the cameras")

    def disarm(self) -> None:
        self.sink = None

    def close(self) -> None:
        self.sink = None
        self.is_open = False

    def edge(self, sequence: int) -> None:
        self.deliver(Trigger(sequence=sequence, received_ns=0, device_ns=0, utc="2026-01-01T00:00:00Z"))

    def deliver(self, event: DeviceEvent) -> None:
        assert self.sink is not None
        assert self.sink.deliver(event)


class Shutter:
    """Counts how often it was fired, and how many events had come before; fails with `error`."""

    def __init__(self, sink: Collector) -> None:
        self.fired_after: list[int] = []
        self.error: Exception | None = None
        self._sink = sink

    def __call__(self) -> None:
        if self.error is not None:
            raise self.error
        self.fired_after.append(len(self._sink.events))


@pytest.fixture
def inner() -> HandGate:
    return HandGate()


@pytest.fixture
def sink() -> Collector:
    return Collector()


@pytest.fixture
def shutter(sink: Collector) -> Shutter:
    return Shutter(sink)


@pytest.fixture
def gate(inner: HandGate, shutter: Shutter, sink: Collector) -> FiringGate:
    gate = FiringGate(inner, shutter)
    gate.open()
    gate.arm(sink)
    return gate


def numbers(sink: Collector) -> list[int]:
    return [event.sequence for event in sink.events if isinstance(event, Trigger)]


def test_the_cameras_are_triggered_before_the_trigger_is_told(
    gate: FiringGate, inner: HandGate, shutter: Shutter, sink: Collector
) -> None:
    inner.edge(7)
    inner.deliver(TriggersIgnored(received_ns=1, count=1, reason="bounce"))
    inner.deliver(PulseEnded(sequence=7, received_ns=2, width_ns=3))
    inner.edge(8)
    assert shutter.fired_after == [0, 3]
    assert [type(event) for event in sink.events] == [Trigger, TriggersIgnored, PulseEnded, Trigger]
    assert numbers(sink) == [7, 8]


def test_a_test_pulse_is_counted_between_the_stones(
    gate: FiringGate, inner: HandGate, shutter: Shutter, sink: Collector
) -> None:
    gate.test_pulse()
    inner.edge(0)
    gate.test_pulse()
    inner.edge(1)
    gate.test_pulse()  # while the stone is still in the beam
    inner.deliver(PulseEnded(sequence=1, received_ns=2, width_ns=3))
    assert numbers(sink) == [0, 1, 2, 3, 4]
    assert [event.kind for event in sink.events if isinstance(event, Trigger)] == [
        BundleKind.BACKGROUND,
        BundleKind.PARTICLE,
        BundleKind.BACKGROUND,
        BundleKind.PARTICLE,
        BundleKind.BACKGROUND,
    ]
    assert sink.events[-1] == PulseEnded(sequence=3, received_ns=2, width_ns=3)
    assert len(shutter.fired_after) == 5


@pytest.mark.parametrize("error", [OSError("no network"), CameraUnavailableError("c01", "no network")])
def test_cameras_that_cannot_be_triggered_end_the_gate_but_hide_no_stone(
    gate: FiringGate, inner: HandGate, shutter: Shutter, sink: Collector, error: Exception
) -> None:
    shutter.error = error
    inner.edge(1)
    inner.edge(2)
    inner.deliver(GateLost(received_ns=0, reason="unplugged"))
    assert [type(event) for event in sink.events] == [Trigger, GateLost, Trigger]
    lost = sink.events[1]
    assert isinstance(lost, GateLost)
    assert "cannot trigger the cameras" in lost.reason
    assert "no network" in lost.reason
    with pytest.raises(GateUnavailableError, match=r"cannot trigger the cameras.*no network"):
        gate.test_pulse()
    gate.close()
    shutter.error = None
    gate.open()
    gate.arm(sink)
    inner.edge(3)
    assert numbers(sink) == [1, 2, 3]


def test_disarmed_it_neither_fires_nor_tells(
    gate: FiringGate, inner: HandGate, shutter: Shutter, sink: Collector
) -> None:
    gate.disarm()
    assert gate.deliver(Trigger(sequence=1, received_ns=0, device_ns=0, utc=""))  # was under way
    with pytest.raises(GateUnavailableError, match="is not armed"):
        gate.test_pulse()
    gate.close()
    with pytest.raises(GateUnavailableError, match="is not open"):
        gate.arm(sink)
    with pytest.raises(GateUnavailableError, match="is not armed"):
        gate.test_pulse()
    assert shutter.fired_after == []
    assert sink.events == []
