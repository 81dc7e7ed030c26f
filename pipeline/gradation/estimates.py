"""A figure of a lot with its uncertainty: what the stones that happened to fall, and their measuring, leave open."""

from dataclasses import dataclass
from enum import StrEnum

MIN_EFFECTIVE = 50.0
"""Effective number of stones below which no verdict is given (ISO 14488's heaviest class decides it)."""


class State(StrEnum):
    """Whether a figure can be judged."""

    MEASURED = "measured"
    INSUFFICIENT = "insufficient"
    """Too few stones for a verdict; value and interval are given."""
    NOT_MEASURED = "not_measured"
    """Outside of the range of sizes that is measured, or no stone at all: there is no value."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A figure, its standard errors by cause, and its 95 % interval, all in the unit of the figure."""

    state: State
    value: float | None = None
    low: float | None = None  # 95 % interval
    high: float | None = None
    sampling_se: float | None = None  # other stones might have fallen
    measuring_se: float | None = None  # random errors of each stone; falls with the number of stones
    systematic_se: float | None = None  # errors that all stones share; no number of stones lowers it
    n_stones: int = 0
    n_effective: float = 0.0  # (sum m)² / sum m²: so many equal stones would tell as much

    @property
    def standard_error(self) -> float | None:
        """All causes together."""
        if self.sampling_se is None or self.measuring_se is None or self.systematic_se is None:
            return None
        return (self.sampling_se**2 + self.measuring_se**2 + self.systematic_se**2) ** 0.5


NOT_MEASURED = Estimate(state=State.NOT_MEASURED)
