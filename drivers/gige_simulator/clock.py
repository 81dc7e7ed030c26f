"""The clock of a simulated camera: free running with offset and drift, or slave of a PTP master (the host's UTC)."""

import random
import threading
import time

LISTENING_NS = 1_000_000_000
LOCKING_NS = 3_000_000_000
"""From switching PTP on until a master is chosen, and until the clock is locked to it."""
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
        """Start at the offset again, free running, as after power-on."""
        with self._lock:
            self._start = (time.monotonic_ns(), self._offset_ns)
            self._ptp_since_ns = None

    def device_ns(self, host_ns: int) -> int:
        """Convert monotonic time of the host, ns, to this clock's."""
        with self._lock:
            return self._device_ns(host_ns)

    def host_ns(self, device_ns: int) -> int:
        """Return the host's time at which this clock, as it runs now, shows `device_ns`."""
        with self._lock:
            now_ns = time.monotonic_ns()
            ahead_ns = device_ns - self._device_ns(now_ns)
            return now_ns + round(ahead_ns / (1 if self._is_locked(now_ns) else self._rate))

    def jump(self, by_ns: int) -> None:
        """Jump by `by_ns`; a PTP slave returns to its master's time once it has locked again."""
        with self._lock:
            now_ns = time.monotonic_ns()
            self._start = (now_ns, self._device_ns(now_ns) + by_ns)
            if self._ptp_since_ns is not None:
                self._ptp_since_ns = now_ns

    def set_ptp(self, *, is_enabled: bool) -> None:
        """Start to synchronise, or run freely from the time shown now."""
        with self._lock:
            if is_enabled == (self._ptp_since_ns is not None):
                return
            now_ns = time.monotonic_ns()
            self._start = (now_ns, self._device_ns(now_ns))
            self._ptp_since_ns = now_ns if is_enabled else None

    def ptp_state(self) -> str:
        """Return the value of the feature `PtpStatus`."""
        with self._lock:
            if self._ptp_since_ns is None:
                return "Disabled"
            enabled_ns = time.monotonic_ns() - self._ptp_since_ns
        if enabled_ns < LISTENING_NS:
            return "Listening"
        return "Slave" if enabled_ns >= LOCKING_NS else "Uncalibrated"

    def ptp_offset_ns(self) -> int:
        """Return the offset from the master as the slave measures it; 0 without a master."""
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
