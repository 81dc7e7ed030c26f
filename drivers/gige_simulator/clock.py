"""A camera's clock: its own offset and drift, latched, or slave of a PTP master (the host's UTC clock)."""

import random
import threading
import time

LISTENING_NS = 1_000_000_000
LOCKING_NS = 3_000_000_000
"""After so long PTP has chosen its master, has locked to it."""
LOCKED_NOISE_NS = 150
UNLOCKED_OFFSET_NS = 500_000


class CameraClock:
    """Nanoseconds as the camera counts them; `host_ns` is always `time.monotonic_ns()`."""

    def __init__(self, *, offset_ns: int, drift_ppm: float, seed: int) -> None:
        self._lock = threading.Lock()
        self._start = (time.monotonic_ns(), offset_ns)  # a moment on the host's clock and on ours
        self._rate = 1 + drift_ppm * 1e-6
        self._offset_ns = offset_ns
        self._ptp_since_ns: int | None = None
        self._random = random.Random(seed)  # noqa: S311 - repeatable, nothing secret

    def restart(self) -> None:
        """Power on: the clock starts at its offset again, free running."""
        with self._lock:
            self._start = (time.monotonic_ns(), self._offset_ns)
            self._ptp_since_ns = None

    def device_ns(self, host_ns: int) -> int:
        with self._lock:
            return self._device_ns(host_ns)

    def host_ns(self, device_ns: int) -> int:
        """When on the host's clock this clock shows `device_ns`, as it runs now."""
        with self._lock:
            now_ns = time.monotonic_ns()
            ahead_ns = device_ns - self._device_ns(now_ns)
            return now_ns + round(ahead_ns / (1 if self._is_locked(now_ns) else self._rate))

    def jump(self, by_ns: int) -> None:
        """Step; a PTP slave is back at its master's time once it has locked anew."""
        with self._lock:
            now_ns = time.monotonic_ns()
            self._start = (now_ns, self._device_ns(now_ns) + by_ns)
            if self._ptp_since_ns is not None:
                self._ptp_since_ns = now_ns

    def set_ptp(self, *, is_enabled: bool) -> None:
        """Start to synchronise, or go on free running from the time shown now."""
        with self._lock:
            if is_enabled == (self._ptp_since_ns is not None):
                return
            now_ns = time.monotonic_ns()
            self._start = (now_ns, self._device_ns(now_ns))
            self._ptp_since_ns = now_ns if is_enabled else None

    def ptp_state(self) -> str:
        with self._lock:
            if self._ptp_since_ns is None:
                return "Disabled"
            enabled_ns = time.monotonic_ns() - self._ptp_since_ns
        if enabled_ns < LISTENING_NS:
            return "Listening"
        return "Slave" if enabled_ns >= LOCKING_NS else "Uncalibrated"

    def ptp_offset_ns(self) -> int:
        """Return the offset from the master as the slave measures it; 0 while there is none."""
        state = self.ptp_state()
        with self._lock:
            noise = self._random.gauss(0, 1)
        match state:
            case "Slave":
                return round(noise * LOCKED_NOISE_NS)
            case "Uncalibrated":
                return round((1 + abs(noise)) * UNLOCKED_OFFSET_NS)
            case _:
                return 0

    def _is_locked(self, host_ns: int) -> bool:
        return self._ptp_since_ns is not None and host_ns - self._ptp_since_ns >= LOCKING_NS

    def _device_ns(self, host_ns: int) -> int:
        if self._is_locked(host_ns):
            return host_ns + (time.time_ns() - time.monotonic_ns())
        start_host_ns, start_device_ns = self._start
        return start_device_ns + round((host_ns - start_host_ns) * self._rate)
