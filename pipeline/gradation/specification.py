"""Specifications of a product, and the verdict on a lot: conforms, does not, or undecided, and for how long."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from pipeline.gradation.estimates import Estimate
from pipeline.gradation.evaluation import Gradation


class Verdict(StrEnum):
    """Whether a figure meets its limits; a word of the REST contract."""

    CONFORMS = "conforms"
    """The 95 % interval is inside the limits."""
    DOES_NOT_CONFORM = "does_not_conform"
    """The interval is outside."""
    UNDECIDED = "undecided"
    """The interval reaches over a limit: more stones are needed."""
    INSUFFICIENT = "insufficient"
    """Too few stones for any verdict."""
    NOT_MEASURED = "not_measured"
    """Not in the range of sizes that is measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Least and greatest percent; both are allowed themselves."""

    min_percent: float = 0.0
    max_percent: float = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Specification:
    """What a product must be: limits of the passing by sieve, and of the indices."""

    name: str
    source: str
    passing: Mapping[float, Limits]  # by aperture in mm
    flakiness: Limits | None = None
    shape: Limits | None = None
    step_percent: float = (
        1.0  # results are rounded to it before they are compared, as the standards report them
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """The verdict on one figure, and the stones until it is expected to be decided."""

    verdict: Verdict
    limits: Limits
    estimate: Estimate
    more_stones: int | None = None  # None: decided, or no number of stones is expected to decide

    def seconds(self, stones_per_s: float) -> float | None:
        """Return the time until it is expected to be decided."""
        return None if self.more_stones is None or stones_per_s <= 0 else self.more_stones / stones_per_s


@dataclass(frozen=True, slots=True, kw_only=True)
class LotJudgement:
    """The verdict on a lot: the worst of all figures that were measured."""

    verdict: Verdict
    is_partial: bool  # some figures of the specification were not measured
    passing: Mapping[float, Judgement]  # by aperture in mm
    flakiness: Judgement | None
    shape: Judgement | None
    more_stones: int | None


def judge(specification: Specification, gradation: Gradation) -> LotJudgement:
    """Return the verdict; the gradation must have been evaluated at the sieves of the specification."""
    raise NotImplementedError
