"""A figure of a lot with its uncertainty: what the stones that happened to fall, and their measuring, leave open."""

from dataclasses import dataclass
from enum import StrEnum
from math import hypot
from typing import NamedTuple

from scipy.special import stdtrit

from pipeline.schema import SCHEMA

MIN_EFFECTIVE = 50.0
"""Effective number of stones below which no verdict is given: the interval of so few is not to be trusted."""
COVERAGE = 0.95


class State(StrEnum):
    """Whether a figure can be judged."""

    MEASURED = "measured"
    INSUFFICIENT = "insufficient"
    """Too few stones for a verdict; value and interval are given."""
    NOT_MEASURED = "not_measured"
    """Outside of the range of sizes that is measured, or no stone at all: there is no value."""


class Errors(NamedTuple):
    """Standard errors by cause."""

    sampling: float
    measuring: float
    systematic: float

    @property
    def joined(self) -> float:
        """All causes together."""
        return hypot(*self)

    def times(self, factor: float) -> "Errors":
        """Return the errors in another unit."""
        return Errors(*(factor * error for error in self))


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A figure with its uncertainty, in the unit of its name."""

    __pydantic_config__ = SCHEMA

    state: State
    """`insufficient`: too few stones for a verdict; `not_measured`: no value."""
    value: float | None = None
    """Value in the unit of the figure's name; null unless it was measured."""
    low: float | None = None
    """Lower end of the 95 % interval."""
    high: float | None = None
    """Upper end of it."""
    standard_error: float | None = None
    """Standard error of all causes together: the root of the sum of their squares."""
    sampling_se: float | None = None
    """Other stones might have fallen."""
    measuring_se: float | None = None
    """Random errors of each stone."""
    systematic_se: float | None = None
    """Errors that all stones share."""
    n_stones: int = 0
    """Stones that it rests on."""
    n_effective: float = 0.0
    """Effective sample size: number of equal-mass stones with the same sampling error."""

    @property
    def errors(self) -> Errors:
        """The standard errors; zero where there is no value."""
        return Errors(self.sampling_se or 0.0, self.measuring_se or 0.0, self.systematic_se or 0.0)


NOT_MEASURED = Estimate(state=State.NOT_MEASURED)


def estimate(
    value: float,
    interval: tuple[float, float],
    errors: Errors,
    n_stones: int,
    n_effective: float,
    min_stones: int = 0,
) -> Estimate:
    """Return an estimate that can be judged if it rests on enough stones."""
    enough = n_effective >= MIN_EFFECTIVE and n_stones >= min_stones
    return Estimate(
        state=State.MEASURED if enough else State.INSUFFICIENT,
        value=value,
        low=interval[0],
        high=interval[1],
        standard_error=errors.joined,
        sampling_se=errors.sampling,
        measuring_se=errors.measuring,
        systematic_se=errors.systematic,
        n_stones=n_stones,
        n_effective=n_effective,
    )


def standard_errors_to_either_end(degrees_of_freedom: float) -> float:
    """Return the half width of the confidence interval in standard errors, by Student's t."""
    return float(stdtrit(max(degrees_of_freedom, 1.0), (1 + COVERAGE) / 2))
