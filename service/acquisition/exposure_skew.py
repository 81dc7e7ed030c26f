"""Check that all cameras expose at the same moment, by the intervals on their own, unsynchronised clocks.

From one bundle to the next every clock counts the same interval, except for its drift, which is steady, and
for the error of the camera's trigger, which is not. A stone falls 2.4 um in a microsecond: 20 us are a pixel.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import median

from pipeline.frames import CameraId

MIN_CAMERAS = 3
"""Fewest cameras whose median tells which of them is late."""
MAX_INTERVAL_NS = 10_000_000_000
"""Longest interval between two bundles over which clocks are compared."""
MAX_DRIFT = 5e-4
MAX_SKEW_NS = 2_000_000
"""A clock that differs by more than `MAX_DRIFT` of the interval and this together was set anew."""
SMOOTHING = 0.1
"""Weight of a new interval in the estimates of drift and skew."""
SETTLING = 8
"""Intervals until a drift is known."""


@dataclass(slots=True)
class _Clock:
    device_ns: int
    common_ns: float  # the same moment in the common time
    drift: float = 0.0
    n_intervals: int = 0
    skew_us: float | None = None  # recent typical deviation

    def follow(self, now_ns: int, common_ns: float) -> bool:
        """Update drift and skew from one interval; return False if the clock was set within it."""
        passed_ns = common_ns - self.common_ns
        by_clock_ns = now_ns - self.device_ns
        if abs(by_clock_ns - passed_ns) > MAX_DRIFT * passed_ns + MAX_SKEW_NS:
            return False
        deviation_ns = by_clock_ns - passed_ns * (1 + self.drift)
        self.device_ns, self.common_ns = now_ns, common_ns
        self.n_intervals += 1
        self.drift += max(SMOOTHING, 1 / self.n_intervals) * deviation_ns / passed_ns
        if self.n_intervals > SETTLING:
            deviation_us = abs(deviation_ns) / 1e3
            before_us = deviation_us if self.skew_us is None else self.skew_us
            self.skew_us = before_us + SMOOTHING * (deviation_us - before_us)
        return True


@dataclass(slots=True)
class ExposureSkew:
    """Estimates the skew of every camera's exposures; `feed` it the camera times of every bundle, in order."""

    _clocks: dict[CameraId, _Clock] = field(default_factory=dict)
    _common_ns: float = 0.0  # time of the last bundle: the median of all clocks

    def feed(self, device_ns: Mapping[CameraId, int]) -> None:
        """Update the estimates from one bundle; 0 is a camera without a clock."""
        intervals_ns = [
            clock.common_ns + (device_ns[camera] - clock.device_ns) / (1 + clock.drift) - self._common_ns
            for camera, clock in self._clocks.items()
            if camera in device_ns
        ]
        interval_ns = median(intervals_ns) if len(intervals_ns) >= MIN_CAMERAS else 0
        self._common_ns += interval_ns
        is_comparable = 0 < interval_ns <= MAX_INTERVAL_NS
        for camera, now_ns in device_ns.items():
            clock = self._clocks.get(camera)
            has_run_on = clock is not None and is_comparable and clock.follow(now_ns, self._common_ns)
            if now_ns and not has_run_on:
                self._clocks[camera] = _Clock(now_ns, self._common_ns)

    def skew_us(self, camera: CameraId) -> float | None:
        """Smoothed deviation of the camera's exposure times from the others', us; None while unknown."""
        clock = self._clocks.get(camera)
        return None if clock is None else clock.skew_us
