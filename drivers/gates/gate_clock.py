"""Convert times of a gate's clock to the host's clock.

Every line of the gate is read some time after the moment that it reports: transmission, 1 to 16 ms of a USB
converter, other work of the host. The line with the least delay gives the offset of the two clocks, and so dates
all others. Clocks drift apart: only the lines of the last seconds count.
"""

from collections import deque

WINDOW_NS = 20_000_000_000
"""Long enough to hold a prompt line where one comes each second; a crystal that is off by 100 ppm drifts by 2 ms."""
MAX_LINES = 256


class GateClock:
    """The offset between the clocks of gate and host, estimated from every line that carries the gate's time."""

    def __init__(self) -> None:
        self._lines: deque[tuple[int, int]] = deque(maxlen=MAX_LINES)  # host's time, host's minus gate's time

    def restart(self) -> None:
        """Forget everything: the gate's clock began again."""
        self._lines.clear()

    def host_ns(self, device_ns: int, latest_ns: int) -> int:
        """Return the host's time of `device_ns`, which the host learnt at `latest_ns`; it is never later than that."""
        self._lines.append((latest_ns, latest_ns - device_ns))
        while latest_ns - self._lines[0][0] > WINDOW_NS:
            self._lines.popleft()
        return device_ns + self._offset_ns

    def device_ns(self, host_ns: int) -> int | None:
        """Return the gate's time of `host_ns`, rather too early than too late; None before the first line."""
        return host_ns - self._offset_ns if self._lines else None

    @property
    def _offset_ns(self) -> int:
        return min(offset_ns for _, offset_ns in self._lines)
