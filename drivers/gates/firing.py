"""A light gate that wraps another one and triggers the cameras from the host, for rigs without a trigger wire."""

import time
from collections.abc import Callable
from dataclasses import replace

from drivers.errors import DriverError, GateUnavailableError
from drivers.gates.gate_thread import trigger_at
from drivers.gates.wrapped import WrappedGate
from drivers.interfaces import DeviceEvent, EventSink, GateLost, LightGate, PulseEnded
from pipeline.frames import BundleKind, Trigger


class FiringGate(WrappedGate):
    """Calls `fire` at every trigger of the wrapped gate, then passes the trigger on.

    `fire` runs on the gate's thread and must return within a millisecond: an action command is one datagram;
    software triggers, which may block for seconds, need threads of their own. It raises `OSError` or `DriverError`
    when no camera could be triggered. The trigger is delivered all the same, so that the stone is counted as lost,
    followed by `GateLost`, as the next stones would be lost as well.
    """

    def __init__(self, gate: LightGate, fire: Callable[[], None]) -> None:
        super().__init__(gate)
        self._fire = fire
        self._n_fired = 0  # test pulses, which the wrapped gate does not count
        self._shift = 0  # added to the number of the last trigger, and so to that of its pulse width
        self._last_sequence = -1

    def test_pulse(self) -> None:
        """Trigger the cameras and deliver a `BACKGROUND` trigger; raises `GateUnavailableError`."""
        with self._lock:
            sink = self._sink
            if sink is None:
                raise GateUnavailableError("light gate", "is not armed")
            at_ns = time.monotonic_ns()
            try:
                self._fire()
            except (OSError, DriverError) as err:
                raise GateUnavailableError("light gate", f"cannot trigger the cameras: {err}") from err
            self._n_fired += 1
            self._last_sequence += 1
            sink.deliver(trigger_at(at_ns, self._last_sequence, kind=BundleKind.BACKGROUND))

    def _pass_on(self, event: DeviceEvent, sink: EventSink) -> bool:
        match event:
            case Trigger():
                return self._fire_for(event, sink)
            case PulseEnded():
                return sink.deliver(replace(event, sequence=event.sequence + self._shift))
            case GateLost() if self._is_lost:
                return True
        return sink.deliver(event)

    def _fire_for(self, trigger: Trigger, sink: EventSink) -> bool:
        problem = None
        try:
            self._fire()
        except (OSError, DriverError) as err:
            problem = f"cannot trigger the cameras: {err}"
        self._shift = self._n_fired
        self._last_sequence = trigger.sequence + self._shift
        is_taken = sink.deliver(replace(trigger, sequence=self._last_sequence))
        if problem is not None and not self._is_lost:
            self._is_lost = True
            sink.deliver(GateLost(received_ns=time.monotonic_ns(), reason=problem))
        return is_taken
