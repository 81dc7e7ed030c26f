r"""Physics of the fall: a stone drops through the light gate and is photographed below it.

The beam is interrupted while the stone falls by its own vertical extent. With the speed v at the gate (zero if it
is released with its lowest point at the beam), interrupted for the time w, at the height h below the gate:

    extent = v w + g w^2 / 2        delay = (sqrt(v^2 + 2 g h) - v) / g        speed = sqrt(v^2 + 2 g h)

h is that of the stone's lowest point, which interrupts the beam: its centre is half its extent higher.

Drag is neglected. After 0.3 m a sphere of 4, 15 or 40 mm (2.65 g/cm3, drag coefficient 0.45) is 1.1, 0.3 or
0.1 mm higher than in a vacuum, 0.47, 0.13 or 0.05 ms late: little beside the 45 mm that the cameras see, and
its mean is part of the delay correction that is measured in the rig.
"""

from dataclasses import dataclass
from math import sqrt

GRAVITY_MM_S2 = 9806.65
"""Standard gravity; from 9780 at the equator to 9832 at the poles, 0.65 ms in the delay of 0.3 m."""


FALL_HEIGHT_MM = 300.0
"""From the beam of the light gate to the rig's centre, where nothing else is said."""


def speed_mm_s(height_mm: float, speed_at_gate_mm_s: float = 0.0) -> float:
    """Return the speed of a stone `height_mm` below the gate; 2426 mm/s after 300 mm from rest."""
    _require_not_negative(height_mm=height_mm, speed_at_gate_mm_s=speed_at_gate_mm_s)
    return sqrt(speed_at_gate_mm_s**2 + 2 * GRAVITY_MM_S2 * height_mm)


def fall_time_ms(height_mm: float, speed_at_gate_mm_s: float = 0.0) -> float:
    """Return the trigger delay: the time of fall to `height_mm` below the gate; 247.35 ms for 300 mm from rest."""
    return 1e3 * (speed_mm_s(height_mm, speed_at_gate_mm_s) - speed_at_gate_mm_s) / GRAVITY_MM_S2


def blur_px(duration_us: float, *, speed_mm_s: float, pixel_mm: float) -> float:
    """Return the path of the stone in the image, px, during an exposure or between the exposures of two cameras."""
    _require_not_negative(duration_us=duration_us, speed_mm_s=speed_mm_s)
    _require_positive(pixel_mm=pixel_mm)
    return duration_us * 1e-6 * speed_mm_s / pixel_mm


def longest_exposure_us(max_blur_px: float, *, speed_mm_s: float, pixel_mm: float) -> float:
    """Return the longest exposure, or skew, that blurs by `max_blur_px`; 19.8 us per px of 0.048 mm at 2426 mm/s."""
    _require_not_negative(max_blur_px=max_blur_px)
    _require_positive(speed_mm_s=speed_mm_s, pixel_mm=pixel_mm)
    return max_blur_px * pixel_mm / speed_mm_s * 1e6


def vertical_extent_mm(pulse_width_ns: int, speed_at_gate_mm_s: float = 0.0) -> float:
    """Return the vertical extent of a stone that interrupted the beam for `pulse_width_ns`."""
    _require_not_negative(pulse_width_ns=pulse_width_ns, speed_at_gate_mm_s=speed_at_gate_mm_s)
    width_s = pulse_width_ns * 1e-9
    return speed_at_gate_mm_s * width_s + GRAVITY_MM_S2 * width_s**2 / 2


def pulse_width_ns(extent_mm: float, speed_at_gate_mm_s: float = 0.0) -> int:
    """Return the time for which a stone of this vertical extent interrupts the beam; 55.3 ms for 15 mm from rest."""
    return round(fall_time_ms(extent_mm, speed_at_gate_mm_s) * 1e6)


def extent_is_plausible(
    extent_mm: float, measured_mm: tuple[float, float], *, tolerance_mm: float = 1.0, tolerance: float = 0.1
) -> bool:
    """True when a stone of this extent at the gate can be the body that was measured.

    `measured_mm` are the least and the greatest vertical extent that the body can have had at the gate: its minimum
    and maximum Feret diameter, since a stone rotates as it falls; if it is known not to, both are the range of its
    mesh in z. Allowed on top are `tolerance_mm`, for the edge of the beam and timing, and the fraction `tolerance` of
    the extent, which depends on the square of the pulse width and on the speed at the gate.
    """
    _require_not_negative(extent_mm=extent_mm, tolerance_mm=tolerance_mm, tolerance=tolerance)
    least_mm, greatest_mm = measured_mm
    slack_mm = tolerance_mm + tolerance * extent_mm
    return least_mm - slack_mm <= extent_mm <= greatest_mm + slack_mm


def _require_not_negative(**values: float) -> None:
    for name, value in values.items():
        if not value >= 0:
            raise ValueError(f"{name} must not be negative, not {value:g}")


def _require_positive(**values: float) -> None:
    for name, value in values.items():
        if not value > 0:
            raise ValueError(f"{name} must be positive, not {value:g}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Fall:
    """Free fall of stones in one rig."""

    height_mm: float = FALL_HEIGHT_MM
    """From the beam of the light gate to the rig's centre."""
    speed_at_gate_mm_s: float = 0.0
    """As the beam closes."""

    @property
    def speed_at_center_mm_s(self) -> float:
        """Speed at the rig's centre, where the cameras expose."""
        return speed_mm_s(self.height_mm, self.speed_at_gate_mm_s)

    def height_above_mm(self, later_ns: int) -> float:
        """Return the height of another stone's lowest point above that of a stone at the rig's centre, negative below.

        The other one reached the beam `later_ns` after it; one that has not yet is at the beam.
        """
        falling_s = fall_time_ms(self.height_mm, self.speed_at_gate_mm_s) / 1e3 - later_ns * 1e-9
        fallen_mm = self.speed_at_gate_mm_s * falling_s + GRAVITY_MM_S2 * falling_s**2 / 2
        return self.height_mm - (fallen_mm if falling_s > 0 else 0.0)
