"""The request for a calibration: method and balls."""

from dataclasses import dataclass
from enum import StrEnum

BALL_DIAMETERS_MM = (1.0, 45.0)
"""Range of diameters that the cameras resolve and that fit into their images."""
MIN_SIZE_RATIO = 1.2
"""Least ratio of two diameters: balls closer in size cannot be told apart before the rig is calibrated."""


class Method(StrEnum):
    """Method of calibration."""

    BUNDLE = "bundle"
    """Bundle adjustment of all cameras and balls."""
    PAPER = "paper"
    """Algorithm 1 of the paper."""
    STONES = "stones"
    """New poses for cameras that moved, from any stones, without a ball."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationPlan:
    """Bodies to calibrate with: one ball, two balls of different size, or any stones."""

    ball_diameters_mm: tuple[float, ...] = ()
    method: Method = Method.BUNDLE
    note: str | None = None
    by: str | None = None

    def __post_init__(self) -> None:
        n_needed = (0,) if self.method is Method.STONES else (1, 2)
        if len(self.ball_diameters_mm) not in n_needed:
            raise ValueError(
                f"ball_diameters_mm: method {self.method} takes {' or '.join(map(str, n_needed))} diameters,"
                f" not {len(self.ball_diameters_mm)}"
            )
        low_mm, high_mm = BALL_DIAMETERS_MM
        if not all(low_mm <= each <= high_mm for each in self.ball_diameters_mm):
            raise ValueError(
                f"ball_diameters_mm must be in {low_mm:g}..{high_mm:g}, not {list(self.ball_diameters_mm)}"
            )
        if len(self.ball_diameters_mm) == 2:
            small_mm, large_mm = sorted(self.ball_diameters_mm)
            if large_mm < MIN_SIZE_RATIO * small_mm:
                raise ValueError(
                    f"ball_diameters_mm: {small_mm:g} and {large_mm:g} cannot be told apart before the rig is"
                    f" calibrated: take balls that differ by a factor of {MIN_SIZE_RATIO:g} or more"
                )
