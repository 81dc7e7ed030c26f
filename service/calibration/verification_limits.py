"""Figures and limits of a verification with balls of known diameter.

They judge the whole measuring chain with the calibration in use: mean error and scatter of the diameter, and the
vertical against the horizontal diameter, which differ when a ball moves too far during the exposure.
"""

from statistics import fmean, stdev

from service.base.messages import Code, CodedFinding, CodedText, message
from service.base.schema import require_ranges, served

MAX_SIZE_RATIO = 1.1
"""Of measured and stated diameter; what differs more is something else, however badly the rig is calibrated."""


@served
class VerifiedBall:
    """One ball of a verification."""

    bundle: str
    """Name of the bundle of images."""
    equivalent_diameter_mm: float | None
    """Diameter of the sphere of equal volume, mm; null when rejected, or far from the stated one."""
    vertical_minus_horizontal_mm: float | None
    """Vertical minus horizontal diameter, mm; null: unknown."""
    detail: str | None = None
    """Why it does not count; null when it does."""
    findings: tuple[CodedFinding, ...] = ()
    """What `detail` says, as codes with their parameters; empty of a rejected ball, whose `reason` its result has."""


@served
class Summary:
    """Averages over the balls measured so far; the limits are those of `[verification]` in the configuration."""

    error_mm: float
    """Mean of the equivalent diameters minus the true one, mm; default limit 0.10 either way."""
    sd_mm: float
    """Standard deviation of the equivalent diameters, mm; default limit 0.05."""
    vertical_minus_horizontal_mm: float | None
    """Mean of vertical minus horizontal diameter, mm; default limit 0.05 either way."""


@served
class VerificationParameters:
    """Interval and limits of verifications; 0.1 mm of 15 mm are 2 % of a stone's volume."""

    every_h: float = 0.0
    """A verification is overdue so long after the latest, hours; 0: never."""
    error_mm: float = 0.10
    """Limit of the mean error, either way, mm."""
    sd_mm: float = 0.05
    """Limit of the standard deviation, mm."""
    vertical_minus_horizontal_mm: float = 0.05
    """Limit of vertical minus horizontal diameter, either way, mm."""

    def __post_init__(self) -> None:
        limits_mm = dict.fromkeys(("error_mm", "sd_mm", "vertical_minus_horizontal_mm"), (1e-3, 10.0))
        require_ranges(self, every_h=(0, 10_000), **limits_mm)

    def problems(self, balls: tuple[VerifiedBall, ...], diameter_mm: float) -> list[CodedText]:
        """Return the figures that exceed their limits, each with the remedy."""
        summary = summarize(balls, diameter_mm)
        found = []
        if abs(summary.error_mm) > self.error_mm:
            found.append(message(Code.DIAMETER_OFF, error_mm=summary.error_mm, limit_mm=self.error_mm))
        if summary.sd_mm > self.sd_mm:
            found.append(message(Code.DIAMETER_SCATTERS, sd_mm=summary.sd_mm, limit_mm=self.sd_mm))
        difference_mm = summary.vertical_minus_horizontal_mm
        if difference_mm is not None and abs(difference_mm) > self.vertical_minus_horizontal_mm:
            limit_mm = self.vertical_minus_horizontal_mm
            found.append(message(Code.DIAMETERS_DIFFER, difference_mm=difference_mm, limit_mm=limit_mm))
        return found


def size_refusal(measured_mm: float, diameter_mm: float) -> CodedText | None:
    """Return the reason why a body of this size is not the ball of the stated diameter, None when it may be."""
    if 1 / MAX_SIZE_RATIO <= measured_mm / diameter_mm <= MAX_SIZE_RATIO:
        return None
    return message(Code.BALL_OF_OTHER_SIZE, measured_mm=measured_mm, diameter_mm=diameter_mm)


def summarize(balls: tuple[VerifiedBall, ...], diameter_mm: float) -> Summary:
    """Return mean error and scatter of measured balls, of which there must be one at least."""
    diameters_mm = [each for ball in balls if (each := ball.equivalent_diameter_mm) is not None]
    differences_mm = [each for ball in balls if (each := ball.vertical_minus_horizontal_mm) is not None]
    return Summary(
        error_mm=fmean(diameters_mm) - diameter_mm,
        sd_mm=stdev(diameters_mm) if len(diameters_mm) > 1 else 0.0,
        vertical_minus_horizontal_mm=fmean(differences_mm) if differences_mm else None,
    )
