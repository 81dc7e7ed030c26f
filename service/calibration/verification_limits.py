"""What balls of a known diameter say about the rig, and what a good one keeps.

What is judged is the whole chain with the calibration in use: the mean error of the diameter, its scatter, and the
vertical against the horizontal diameter, which differ when a ball moves too far while it is exposed.
"""

from dataclasses import dataclass
from statistics import fmean, stdev


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifiedBall:
    """One ball as it was measured."""

    bundle: str
    equivalent_diameter_mm: float | None  # None: rejected, see `detail`
    vertical_minus_horizontal_mm: float | None
    detail: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Over the balls that were measured."""

    error_mm: float  # mean of the equivalent diameters minus the true one
    sd_mm: float
    vertical_minus_horizontal_mm: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class VerificationParameters:
    """How often a rig is verified, and what a good one keeps: 0.1 mm of 15 mm are 2 % of a stone's volume."""

    every_h: float = 0.0  # it is overdue so long after the last one; 0: never
    error_mm: float = 0.10  # of the mean of the equivalent diameter
    sd_mm: float = 0.05
    vertical_minus_horizontal_mm: float = 0.05  # 20 us of exposure

    def __post_init__(self) -> None:
        for name, low, high in (
            ("every_h", 0.0, 10_000.0),
            ("error_mm", 1e-3, 10.0),
            ("sd_mm", 1e-3, 10.0),
            ("vertical_minus_horizontal_mm", 1e-3, 10.0),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} must be in {low:g}..{high:g}, not {getattr(self, name):g}")

    def problems(self, balls: tuple[VerifiedBall, ...], diameter_mm: float) -> list[str]:
        """What is out of bounds, with the remedy."""
        summary = summarize(balls, diameter_mm)
        found = []
        if abs(summary.error_mm) > self.error_mm:
            found.append(
                f"the diameter is {summary.error_mm:+.3f} mm off on average, {self.error_mm:g} is the limit:"
                " is it the right ball? then calibrate anew"
            )
        if summary.sd_mm > self.sd_mm:
            found.append(
                f"the diameter scatters by {summary.sd_mm:.3f} mm, {self.sd_mm:g} is the limit:"
                " look at views that were dropped, at the light and at dust"
            )
        uneven_mm = summary.vertical_minus_horizontal_mm
        if uneven_mm is not None and abs(uneven_mm) > self.vertical_minus_horizontal_mm:
            found.append(
                f"the vertical diameter is {uneven_mm:+.3f} mm against the horizontal,"
                f" {self.vertical_minus_horizontal_mm:g} is the limit: expose for less, or calibrate anew"
            )
        return found


def summarize(balls: tuple[VerifiedBall, ...], diameter_mm: float) -> Summary:
    """Mean error and scatter of balls that were measured, at least one."""
    diameters_mm = [each for ball in balls if (each := ball.equivalent_diameter_mm) is not None]
    uneven_mm = [each for ball in balls if (each := ball.vertical_minus_horizontal_mm) is not None]
    return Summary(
        error_mm=fmean(diameters_mm) - diameter_mm,
        sd_mm=stdev(diameters_mm) if len(diameters_mm) > 1 else 0.0,
        vertical_minus_horizontal_mm=fmean(uneven_mm) if uneven_mm else None,
    )
