"""The belt of the simulated rig: lets one stone after the other fall through the light gate."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from drivers.gige_simulator.hopper import Drop, Hopper

SETTLE_NS = 1_000_000_000
"""From the moment the rig is ready to the first stone: the host arms its gate last, which cannot be seen from here."""
LATE_NS = 10_000_000
"""When the thread wakes up later than this, all stones that follow are moved, so that none follows too soon."""
POLL_S = 0.05
MAX_RATE_HZ = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BeltCounters:
    """Counts of the stones that the belt dropped since it was opened."""

    stones: int = 0
    empty: int = 0  # recorded exposures of the empty rig
    late: int = 0  # of both, dropped later than planned


class Belt:
    """Runs at an even rate, or stands and drops single stones on request; its thread lives from `open` to `close`.

    `drop` is called on that thread with what falls and the moment (monotonic ns, just past) when it closes the beam.
    """

    def __init__(self, hopper: Hopper, drop: Callable[[Drop, int], None], *, rate_hz: float) -> None:
        self._hopper = hopper
        self._drop = drop
        self._changed = threading.Condition()
        self._is_closing = False
        self._is_ready: Callable[[], bool] | None = None  # set while the belt waits to start by itself
        self._next_ns: int | None = None  # when it runs
        self._n_single = 0
        self.ended = threading.Event()
        """Set when the last stone fell."""
        self.counters = BeltCounters()
        self.rate_hz = rate_hz
        self._thread = threading.Thread(target=self._run, name="simulated belt", daemon=True)

    @property
    def rate_hz(self) -> float:
        """Stones and recorded exposures of the empty rig per second."""
        return 1e9 / self._period_ns

    @rate_hz.setter
    def rate_hz(self, rate_hz: float) -> None:
        if not 0 < rate_hz <= MAX_RATE_HZ:
            raise ValueError(f"rate_hz must be above 0 and at most {MAX_RATE_HZ:g}, not {rate_hz:g}")
        self._period_ns = round(1e9 / rate_hz)

    @property
    def is_running(self) -> bool:
        return self._next_ns is not None and not self.ended.is_set()

    def open(self) -> None:
        self._hopper.start()
        self._thread.start()

    def close(self) -> None:
        with self._changed:
            self._is_closing = True
            self._changed.notify_all()
        self._hopper.close()
        self._thread.join()

    def start(self) -> None:
        """Run from now on."""
        with self._changed:
            self._is_ready = None
            self._next_ns = time.monotonic_ns()
            self._changed.notify_all()

    def start_when(self, is_ready: Callable[[], bool]) -> None:
        """Start a second after `is_ready` becomes true; it is called on the belt's thread."""
        with self._changed:
            self._is_ready = is_ready
            self._changed.notify_all()

    def stop(self) -> None:
        """Stop the belt, or do not start it; a stone that is falling goes on falling."""
        with self._changed:
            self._is_ready = None
            self._next_ns = None
            self._changed.notify_all()

    def drop_one(self) -> None:
        """Let one stone fall now."""
        with self._changed:
            self._n_single += 1
            self._changed.notify_all()

    # --- the thread ---

    def _run(self) -> None:
        while (fall := self._hopper.take()) is not None and (edge_ns := self._next_edge_ns()) is not None:
            counters = self.counters
            if fall.is_empty:
                self.counters = replace(counters, empty=counters.empty + 1)
            else:
                self.counters = replace(counters, stones=counters.stones + 1)
            self._drop(fall, edge_ns)
        self.ended.set()

    def _next_edge_ns(self) -> int | None:
        """Wait until the next stone is due and return when it closes the beam; None when the belt is closed."""
        with self._changed:
            while not self._is_closing:
                now_ns = time.monotonic_ns()
                if self._n_single:
                    self._n_single -= 1
                    return now_ns
                if self._is_ready is not None and self._is_ready():
                    self._is_ready = None
                    self._next_ns = now_ns + SETTLE_NS
                if self._next_ns is None:
                    self._changed.wait(None if self._is_ready is None else POLL_S)
                elif self._next_ns > now_ns:
                    self._changed.wait((self._next_ns - now_ns) / 1e9)
                else:
                    is_late = now_ns > self._next_ns + LATE_NS
                    self.counters = replace(self.counters, late=self.counters.late + is_late)
                    edge_ns = now_ns if is_late else self._next_ns
                    self._next_ns = edge_ns + self._period_ns
                    return edge_ns
        return None
