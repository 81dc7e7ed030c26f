"""The uplink that all cameras share behind a switch."""

import threading
import time


class Uplink:
    """Carries `rate_bytes_s`; packets beyond `buffer_bytes` waiting in the switch are dropped. Thread-safe."""

    def __init__(self, *, rate_bytes_s: float, buffer_bytes: int) -> None:
        if rate_bytes_s <= 0 or buffer_bytes <= 0:
            raise ValueError(
                f"rate_bytes_s and buffer_bytes must be positive, not {rate_bytes_s:g} and {buffer_bytes}"
            )
        self._rate_bytes_s = rate_bytes_s
        self._buffer_bytes = buffer_bytes
        self._lock = threading.Lock()
        self._waiting_bytes = 0.0
        self._at_s = time.monotonic()

    def carries(self, n_bytes: int) -> bool:
        """Take a packet of `n_bytes`; False when it is dropped."""
        with self._lock:
            now_s = time.monotonic()
            drained_bytes = (now_s - self._at_s) * self._rate_bytes_s
            self._waiting_bytes = max(0.0, self._waiting_bytes - drained_bytes)
            self._at_s = now_s
            if self._waiting_bytes + n_bytes > self._buffer_bytes:
                return False
            self._waiting_bytes += n_bytes
            return True
