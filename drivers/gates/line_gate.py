"""The base of gates on a bare line, a modem line or a GPIO, which a thread of the host polls."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

from drivers.errors import GateUnavailableError
from drivers.gates.gate_thread import GateThread
from drivers.gates.line_pulses import LinePulses
from drivers.interfaces import EventSink
from pipeline.frames import GateCount


class Closable(Protocol):
    """Anything that is held open and can be closed."""

    def close(self) -> None: ...


class LineGate(ABC):
    """A `LightGate` on a bare line: delivers `Trigger`, `PulseEnded`, `TriggersIgnored` and, once, `GateLost`.

    The line itself counts nothing: sequence numbers start at 0 when the object is made.
    """

    def __init__(self, name: str, debounce_us: int) -> None:
        self._thread = GateThread(name)
        self._pulses = LinePulses(debounce_us, self._thread.deliver)
        self._held: Closable | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        return ()

    def resume(self, count: GateCount, n_known: int) -> None:
        return  # what passes while no process listens is not counted

    def open(self) -> None:
        if self._thread.is_running and self._thread.failure is None:
            return
        self.close()
        try:
            turn = self._connect()
        except GateUnavailableError:
            self.close()
            raise
        self._pulses.reset()
        self._thread.start(turn)

    def arm(self, sink: EventSink) -> None:
        self._thread.arm(sink)

    def disarm(self) -> None:
        self._thread.disarm()

    def close(self) -> None:
        self._thread.stop()
        if self._held is not None:
            with suppress(OSError):  # it may be gone
                self._held.close()
            self._held = None

    @abstractmethod
    def _connect(self) -> Callable[[], None]:
        """Open the line, set `_held`, and return the function that the thread calls; raises `GateUnavailableError`."""
