"""When by the host's clock something happened that a gate dates by its own.

Every line of the gate is read some time after the moment it tells of: transmission, 1 to 16 ms of a USB
converter, whatever the host was busy with. The line that took least tells how the two clocks stand to each
other, and so dates all others. Clocks drift apart: only the lines of the last seconds count.
"""

from collections import deque

WINDOW_NS = 20_000_000_000
"""Long enough for a prompt line among one a second; a crystal that is off by 100 ppm moves by 2 ms in it."""
MAX_LINES = 256


class GateClock:
    """Dates what a gate tells; feed it every line that carries the gate's time."""

    def __init__(self) -> None:
        self._lines: deque[tuple[int, int]] = deque(maxlen=MAX_LINES)  # latest time, host's minus gate's

    def restart(self) -> None:
        """Forget everything: the gate's clock began again."""
        self._lines.clear()

    def host_ns(self, device_ns: int, latest_ns: int) -> int:
        """Host time of the gate's `device_ns`, of which the host knew at `latest_ns`; never later than that."""
        self._lines.append((latest_ns, latest_ns - device_ns))
        while latest_ns - self._lines[0][0] > WINDOW_NS:
            self._lines.popleft()
        return device_ns + self._offset_ns

    def device_ns(self, host_ns: int) -> int | None:
        """Time on the gate's clock, rather too early than too late; nothing before the first line."""
        return host_ns - self._offset_ns if self._lines else None

    @property
    def _offset_ns(self) -> int:
        return min(offset_ns for _, offset_ns in self._lines)
