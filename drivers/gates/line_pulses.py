"""Turn the edges of a bare line, a modem line or a GPIO, into numbered events."""

import threading
import time
from collections.abc import Callable

from drivers.gates.edge_filter import Began, Bounced, EdgeFilter, Ended, Pulse
from drivers.gates.gate_thread import trigger_at
from drivers.interfaces import DeviceEvent, PulseEnded, TriggersIgnored, TriggersLost
from pipeline.frames import BundleKind


class LinePulses:
    """Debounces edges and delivers them as events; sequence numbers are never reset, and include lost stones."""

    def __init__(self, debounce_us: int, deliver: Callable[[DeviceEvent], None]) -> None:
        self._filter = EdgeFilter(debounce_us * 1000)
        self._deliver = deliver
        self._numbering = threading.Lock()  # a test pulse comes from another thread
        self._n_numbers = 0
        self._sequence = 0  # of the pulse in the filter

    def reset(self) -> None:
        """Forget the pulse that is going on."""
        self._filter.reset()

    def edge(self, *, is_closed: bool, at_ns: int) -> None:
        """Take an edge at `at_ns` of the host's clock."""
        for pulse in self._filter.edge(is_closed=is_closed, at_ns=at_ns):
            self._tell(pulse, at_ns)

    def settle(self, now_ns: int) -> None:
        """Deliver the end of the last pulse once it is certain."""
        for pulse in self._filter.settle(now_ns):
            self._tell(pulse, now_ns)

    def lose(self, count: int, reason: str) -> None:
        """Deliver `TriggersLost` for `count` stones whose edges were missed, and forget the pulse that is going on."""
        self._filter.reset()
        if count:
            self._next_number(count)
            now_ns = time.monotonic_ns()
            self._deliver(TriggersLost(received_ns=now_ns, count=count, reason=reason, by_host=True))

    def test_pulse(self, at_ns: int) -> None:
        """Deliver the `BACKGROUND` trigger of a test pulse."""
        self._deliver(trigger_at(at_ns, self._next_number(), kind=BundleKind.BACKGROUND))

    def _tell(self, pulse: Pulse, now_ns: int) -> None:
        match pulse:
            case Began(at_ns=at_ns):
                self._sequence = self._next_number()
                self._deliver(trigger_at(at_ns, self._sequence))
            case Ended(width_ns=0):
                pass  # both edges were found at one look, so the width is not known
            case Ended(width_ns=width_ns):
                self._deliver(PulseEnded(sequence=self._sequence, received_ns=now_ns, width_ns=width_ns))
            case Bounced(at_ns=at_ns):
                self._deliver(TriggersIgnored(received_ns=at_ns, count=1, reason="bounce"))

    def _next_number(self, count: int = 1) -> int:
        with self._numbering:
            self._n_numbers += count
            return self._n_numbers - 1
