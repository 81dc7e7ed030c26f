"""The uplink that all cameras share behind a switch."""

import threading
from itertools import count

_N_SLOTS = 32
"""How many slots of time the uplink takes to empty a full buffer."""
_KEPT_S = 2.0
"""Longest time by which the thread of a camera may be later than those of others."""


class Uplink:
    """Carries `rate_bytes_s`; packets beyond `buffer_bytes` waiting in the switch are dropped. Thread-safe.

    A packet counts at the time at which it leaves its camera, not when a busy machine comes to send it. So packets come
    in any order: one that leaves early is dropped where the buffer overflows with it, then or later.
    """

    def __init__(self, *, rate_bytes_s: float, buffer_bytes: int) -> None:
        if rate_bytes_s <= 0 or buffer_bytes <= 0:
            raise ValueError(
                f"rate_bytes_s and buffer_bytes must be positive, not {rate_bytes_s:g} and {buffer_bytes}"
            )
        self._buffer_bytes = buffer_bytes
        self._slot_bytes = buffer_bytes / _N_SLOTS
        self._slot_s = self._slot_bytes / rate_bytes_s
        self._lock = threading.Lock()
        self._slots: dict[
            int, tuple[float, float]
        ] = {}  # bytes that it can still take, and that wait at its end

    def carries(self, n_bytes: int, at_s: float) -> bool:
        """Take a packet of `n_bytes` that leaves its camera at `at_s`; False when it is dropped."""
        with self._lock:
            rest, first = float(n_bytes), int(at_s / self._slot_s)
            changed: dict[int, tuple[float, float]] = {}
            for slot in count(first):
                free, waiting = self._slots.get(slot, (self._slot_bytes, 0.0))
                taken = min(free, rest)
                rest -= taken
                changed[slot] = free - taken, waiting + rest
                if waiting + rest > self._buffer_bytes:
                    return False
                if rest <= 0:
                    break
            self._slots |= changed
            if len(self._slots) > 4 * _KEPT_S / self._slot_s:
                oldest = first - _KEPT_S / self._slot_s
                self._slots = {slot: state for slot, state in self._slots.items() if slot >= oldest}
            return True
