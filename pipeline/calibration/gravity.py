"""Direction of gravity, from balls exposed at different times after the light gate.

A ball that is exposed later is further down. Over the few milliseconds while it is in the image, the fall is
straight and nearly uniform: p = p0 + d (v t + g t^2 / 2), a regression of the drops' places on their times.
Since balls are released at different places, the direction is used only if it is sharply determined.
"""

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.arrays import PointsMM, Values, Vector
from pipeline.calibration.report import FoundFall
from pipeline.fall import GRAVITY_MM_S2

MIN_SPAN_NS = 500_000
"""Least range of the times; a smaller one is the jitter of one delay."""
MAX_SPAN_NS = 40_000_000
"""Largest deviation from the median time. A ball is in the image for 20 ms: beyond, a clock was set between drops."""
SPEED_MM_S = (500.0, 5000.0)
"""Plausible range of the speed of fall."""
MAX_SD_DEG = 0.3
"""Largest standard deviation of a direction that is used."""
N_REWEIGHTINGS = 20
MIN_DROPS = 4


def fall_of(centers_mm: PointsMM, fall_ns: Sequence[int | None]) -> FoundFall | None:
    """Return the fall that D places at these times show, or `None` if it is not determined to 0.3 degrees."""
    is_timed = np.array([time is not None for time in fall_ns])
    times_ns = np.array([time for time in fall_ns if time is not None], dtype=np.int64)
    if len(times_ns) < MIN_DROPS:
        return None
    relative_ns = times_ns - np.sort(times_ns)[len(times_ns) // 2]
    is_near = np.abs(relative_ns) < MAX_SPAN_NS
    time_s, places_mm = relative_ns[is_near] * 1e-9, centers_mm[is_timed][is_near]
    if len(time_s) < MIN_DROPS or np.ptp(time_s) < MIN_SPAN_NS * 1e-9:
        return None
    velocity, sd = _regressed(time_s, places_mm)
    speed_mm_s = float(np.linalg.norm(velocity))
    if not SPEED_MM_S[0] < speed_mm_s < SPEED_MM_S[1]:
        return None
    sd_deg = float(np.rad2deg(sd / speed_mm_s))
    if sd_deg > MAX_SD_DEG:
        return None
    x, y, z = (float(value) for value in velocity / speed_mm_s)
    return FoundFall(direction=(x, y, z), speed_mm_s=speed_mm_s, sd_deg=sd_deg)


def upright(fall: FoundFall) -> Rotation:
    """Return the smallest rotation of the world after which the fall is along -z."""
    down = np.array([0.0, 0.0, -1.0])
    axis = np.cross(fall.direction, down)
    sine, cosine = float(np.linalg.norm(axis)), float(down @ fall.direction)
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine) if sine > 0 else np.zeros(3))


def _regressed(time_s: Values, places_mm: PointsMM) -> tuple[Vector, float]:
    """Return the velocity in mm/s at time 0 and the standard deviation of its components; robust regression."""
    velocity, weights = np.array([0.0, 0.0, -2426.0]), np.ones(len(time_s))
    for _ in range(N_REWEIGHTINGS):
        # free fall: v t + g t^2 / 2 along the direction of v
        way_s = time_s + GRAVITY_MM_S2 * time_s**2 / (2 * max(float(np.linalg.norm(velocity)), SPEED_MM_S[0]))
        total = weights.sum()
        centered_s = way_s - (weights * way_s).sum() / total
        centered_mm = places_mm - (weights[:, None] * places_mm).sum(axis=0) / total
        spread = (weights * centered_s**2).sum()
        velocity = (weights[:, None] * centered_s[:, None] * centered_mm).sum(axis=0) / spread
        misses_mm = np.linalg.norm(centered_mm - centered_s[:, None] * velocity, axis=1)
        typical_mm = max(float(np.median(misses_mm)), 1e-3)
        weights = 1 / np.sqrt(1 + (misses_mm / (2 * typical_mm)) ** 2)
    n = len(time_s)
    variance_mm2 = float((weights * misses_mm**2).sum() / total) / 3 * n / (n - 2)
    return velocity, float(np.sqrt(variance_mm2 / spread))
