"""Parameters of bundling: when the frames of a trigger are expected."""

from dataclasses import dataclass

from service.base.schema import require_ranges

IN_VIEW_NS = 50_000_000
"""A stone within this time after a test pulse is in the picture or at its edge: it crosses the picture in 20 ms."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BundlingParameters:
    """Times at which frames are expected, and the least time between two triggers."""

    expected_delay_ms: float = 259.4  # trigger delay 247.4, exposure, transfer
    window_ms: float = 100.0  # half width; more than jitter and packet resends take
    dead_time_ms: float = 220.0  # least time between two triggers, as the gate enforces it

    def __post_init__(self) -> None:
        require_ranges(self, expected_delay_ms=(0, 10_000), window_ms=(1, 5_000))
        if not self.dead_time_ms > 2 * self.window_ms:
            raise ValueError(
                f"dead_time_ms must exceed twice window_ms, {2 * self.window_ms:g}, not {self.dead_time_ms:g}"
            )

    @property
    def quiet_s(self) -> float:
        """Time after a trigger until its stone has left the field of view and the cameras can expose again."""
        return max(self.dead_time_ms, self.expected_delay_ms) / 1e3 + IN_VIEW_NS / 1e9
