"""The base of gates that wrap another gate."""

import threading
from abc import ABC, abstractmethod

from drivers.errors import DeviceError
from drivers.interfaces import DeviceEvent, EventSink, LightGate
from pipeline.frames import GateCount


class WrappedGate(ABC):
    """Passes all calls on to the wrapped gate, and is its sink from `arm` to `disarm`."""

    def __init__(self, gate: LightGate) -> None:
        self._gate = gate
        self._sink: EventSink | None = None
        self._lock = threading.Lock()  # events come on another thread than calls
        self._is_lost = False

    @property
    def warnings(self) -> tuple[str, ...]:
        return self._gate.warnings

    def resume(self, count: GateCount, n_known: int) -> None:
        self._gate.resume(count, n_known)

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
        self._gate.test_pulse()

    def disarm(self) -> None:
        self._gate.disarm()
        with self._lock:
            self._sink = None

    def close(self) -> None:
        self._gate.close()
        with self._lock:
            self._sink = None

    def deliver(self, event: DeviceEvent) -> bool:
        """Take an event of the wrapped gate; called on its thread."""
        with self._lock:
            return True if self._sink is None else self._pass_on(event, self._sink)

    @abstractmethod
    def _pass_on(self, event: DeviceEvent, sink: EventSink) -> bool:
        """Deliver to `sink` what becomes of an event; returns whether all of it was taken."""
