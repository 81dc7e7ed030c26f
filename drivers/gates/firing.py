"""For a rig without a wire from the light gate to the cameras: the host triggers them at every stone."""

import time
from collections.abc import Callable
from dataclasses import replace

from drivers.errors import DriverError, GateUnavailableError
from drivers.gates.gate_thread import trigger_at
from drivers.gates.wrapped import WrappedGate
from drivers.interfaces import DeviceEvent, EventSink, GateLost, LightGate, PulseEnded
from pipeline.frames import BundleKind, Trigger


class FiringGate(WrappedGate):
    """Calls `fire` at every trigger of another gate, then passes the trigger on.

    `fire` runs on the gate's thread and must return within a millisecond: an action command is one datagram;
    software triggers, which may block for seconds, belong to threads of their own. It raises `OSError` or
    `DriverError` when no camera could be triggered. Then the stone is lost, which its trigger will tell, and
    so will be the next: the gate is given up as `GateLost`.
    """

    def __init__(self, gate: LightGate, fire: Callable[[], None]) -> None:
        super().__init__(gate)
        self._fire = fire
        self._n_fired = 0  # test pulses, which the other gate does not count
        self._shift = 0  # of the last trigger's number, and so of its width
        self._last_sequence = -1

    def test_pulse(self) -> None:
        """Trigger the cameras."""
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
