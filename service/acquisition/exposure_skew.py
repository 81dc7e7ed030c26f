"""Do all cameras expose at the same moment? Compared by the intervals on their own clocks, which nobody synchronised.

From one bundle to the next every clock counts the same interval, but for its drift, which is steady, and
for what the camera's trigger came too early or too late, which is not. A stone falls 2.4 um in a
microsecond: 20 us are a pixel.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import median

from pipeline.frames import CameraId

MIN_CAMERAS = 3
"""The median of fewer says nothing about who is late."""
MAX_STEP_NS = 10_000_000_000
MAX_DRIFT = 5e-4
MAX_SKEW_NS = 2_000_000
"""A clock that differs by more than both was set."""
SMOOTHING = 0.1
"""Of a new interval in the estimate of a drift."""
SETTLING = 8
"""Intervals until the drifts are known."""


@dataclass(slots=True)
class _Clock:
    device_ns: int
    moment_ns: float  # the same on the common time
    drift: float = 0.0
    n_intervals: int = 0
    skew_us: float | None = None  # recent typical deviation


@dataclass(slots=True)
class ExposureSkew:
    """`feed` it the camera times of every bundle, in order."""

    _clocks: dict[CameraId, _Clock] = field(default_factory=dict)
    _moment_ns: float = 0.0  # of the last bundle, on the median of all clocks

    def feed(self, device_ns: Mapping[CameraId, int]) -> None:
        """Learn from one bundle; 0 is a camera without a clock."""
        known = {camera: self._clocks[camera] for camera in device_ns if camera in self._clocks}
        steps_ns = [
            clock.moment_ns + (device_ns[camera] - clock.device_ns) / (1 + clock.drift) - self._moment_ns
            for camera, clock in known.items()
        ]
        step_ns = median(steps_ns) if len(steps_ns) >= MIN_CAMERAS else 0
        self._moment_ns += step_ns
        for camera, now_ns in device_ns.items():
            clock = self._clocks.get(camera)
            if clock is not None and 0 < step_ns <= MAX_STEP_NS and _fits(clock, now_ns, self._moment_ns):
                _learn(clock, now_ns, self._moment_ns)
            elif now_ns:
                self._clocks[camera] = _Clock(now_ns, self._moment_ns)

    def skew_us(self, camera: CameraId) -> float | None:
        """By how much the camera's exposures lately differed from the others', None while nobody can know."""
        clock = self._clocks.get(camera)
        return None if clock is None else clock.skew_us


def _fits(clock: _Clock, now_ns: int, moment_ns: float) -> bool:
    passed_ns = moment_ns - clock.moment_ns
    return abs(now_ns - clock.device_ns - passed_ns) <= MAX_DRIFT * passed_ns + MAX_SKEW_NS


def _learn(clock: _Clock, now_ns: int, moment_ns: float) -> None:
    passed_ns = moment_ns - clock.moment_ns
    deviation_ns = now_ns - clock.device_ns - passed_ns * (1 + clock.drift)
    clock.device_ns, clock.moment_ns = now_ns, moment_ns
    clock.n_intervals += 1
    clock.drift += max(SMOOTHING, 1 / clock.n_intervals) * deviation_ns / passed_ns
    if clock.n_intervals > SETTLING:
        deviation_us = abs(deviation_ns) / 1e3
        before_us = deviation_us if clock.skew_us is None else clock.skew_us
        clock.skew_us = before_us + SMOOTHING * (deviation_us - before_us)
