"""For a rig without a wire from the light gate to the cameras: the host triggers them at every stone."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace

from drivers.errors import DeviceError, DriverError, GateUnavailableError
from drivers.gates.gate_thread import trigger_at
from drivers.interfaces import DeviceEvent, EventSink, GateLost, LightGate, PulseEnded
from pipeline.frames import BundleKind, Trigger


class FiringGate:
    """Calls `fire` at every trigger of another gate, then passes the trigger on.

    `fire` runs on the gate's thread and must return within a millisecond: an action command is one datagram;
    software triggers, which may block for seconds, belong to threads of their own. It raises `OSError` or
    `DriverError` when no camera could be triggered. Then the stone is lost, which its trigger will tell, and
    so will be the next: the gate is given up as `GateLost`.
    """

    def __init__(self, gate: LightGate, fire: Callable[[], None]) -> None:
        self._gate = gate
        self._fire = fire
        self._sink: EventSink | None = None
        self._lock = threading.Lock()  # a test pulse comes from another thread than the gate's triggers
        self._n_fired = 0  # test pulses, which the other gate does not count
        self._shift = 0  # of the last trigger's number, and so of its width
        self._last_sequence = -1
        self._is_lost = False

    @property
    def warnings(self) -> tuple[str, ...]:
        return self._gate.warnings

    def open(self) -> None:
        self._gate.open()
        self._is_lost = False

    def arm(self, sink: EventSink) -> None:
        self._sink = sink
        try:
            self._gate.arm(self)
        except DeviceError:
            self._sink = None
            raise

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

    def disarm(self) -> None:
        self._gate.disarm()
        with self._lock:
            self._sink = None

    def close(self) -> None:
        self._gate.close()
        with self._lock:
            self._sink = None

    def deliver(self, event: DeviceEvent) -> bool:
        """Take what the other gate delivers; called on its thread."""
        with self._lock:
            if self._sink is None:
                return True
            match event:
                case Trigger():
                    return self._pass_on(event, self._sink)
                case PulseEnded():
                    return self._sink.deliver(replace(event, sequence=event.sequence + self._shift))
                case GateLost() if self._is_lost:
                    return True
            return self._sink.deliver(event)

    def _pass_on(self, trigger: Trigger, sink: EventSink) -> bool:
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
