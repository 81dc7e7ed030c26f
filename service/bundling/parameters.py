"""Parameters of bundling: when the frames of a trigger are expected."""

from dataclasses import dataclass

IN_VIEW_NS = 50_000_000
"""A stone within this time after a test pulse is in the picture or at its edge: it crosses the picture in 20 ms."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BundlingParameters:
    """Times at which frames are expected, and the least time between two triggers."""

    expected_delay_ms: float = 259.4  # trigger delay 247.4, exposure, transfer
    window_ms: float = 100.0  # half width; more than jitter and packet resends take
    dead_time_ms: float = 220.0  # least time between two triggers, as the gate enforces it

    def __post_init__(self) -> None:
        if not 0 <= self.expected_delay_ms <= 10_000:
            raise ValueError(f"expected_delay_ms must be in 0..10000, not {self.expected_delay_ms:g}")
        if not 1 <= self.window_ms <= 5_000:
            raise ValueError(f"window_ms must be in 1..5000, not {self.window_ms:g}")
        if not self.dead_time_ms > 2 * self.window_ms:
            raise ValueError(
                f"dead_time_ms must exceed twice window_ms, {2 * self.window_ms:g}, not {self.dead_time_ms:g}"
            )

    @property
    def quiet_s(self) -> float:
        """Time after a trigger until its stone has left the field of view and the cameras can expose again."""
        return max(self.dead_time_ms, self.expected_delay_ms) / 1e3 + IN_VIEW_NS / 1e9
