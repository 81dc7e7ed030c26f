"""Control charts of single values: Shewhart's limits, runs rules, and the exponentially weighted mean (EWMA).

A value's standard deviation is that of the process and the value's own error of sampling together, so that the limits
of a lot of few stones are wider than those of a large one. All else is said of standardised deviations from the
centre: they are taken for normal and independent of each other. Shewhart: ISO 7870-2; EWMA: ISO 7870-6.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pipeline.arrays import Values

SIGMAS = 3.0
MOVING_RANGE_FACTOR = 1.128
"""Mean difference of two normal values, in standard deviations (d2)."""
ROUNDING = 1e-12
MIN_BASELINE = 8
"""Values from which limits are computed at the least; before, there are none."""
EWMA_WEIGHT, EWMA_SIGMAS = 0.1, 2.7
"""Weight of the newest value (lambda) and width of the limits (L), as Montgomery has them. Within ten values 4 of 100
series in control give a false signal, and of 100 that are off by a standard deviation 78 give one (its test)."""


class RuleName(StrEnum):
    """A pattern that chance alone seldom makes."""

    BEYOND_LIMITS = "beyond_limits"
    """A value more than 3 standard deviations from the centre."""
    TWO_OF_THREE = "two_of_three"
    """2 of 3 values more than 2 standard deviations from it, on the same side."""
    FOUR_OF_FIVE = "four_of_five"
    """4 of 5 values more than 1 standard deviation from it, on the same side."""
    RUN = "run"
    """8 values in a row on one side of it; 9 on the chart of verifications."""
    TREND = "trend"
    """6 values in a row that rise or fall."""
    EWMA = "ewma"
    """The weighted mean of all values until then is beyond its limits: a small shift that lasts."""


@dataclass(frozen=True, slots=True)
class RunsRule:
    """`n` of `of` values in a row, the newest among them, beyond so many standard deviations on the same side."""

    name: RuleName
    n: int
    of: int
    sigmas: float = 0.0
    of_differences: bool = False  # each value less the one before, in the place of values


WESTERN_ELECTRIC = (
    RunsRule(RuleName.BEYOND_LIMITS, 1, 1, SIGMAS),
    RunsRule(RuleName.TWO_OF_THREE, 2, 3, 2.0),
    RunsRule(RuleName.FOUR_OF_FIVE, 4, 5, 1.0),
    RunsRule(RuleName.RUN, 8, 8),
)
"""Western Electric, Statistical Quality Control Handbook, 1956. In control, all four together give a false signal every
92 values (Champ and Woodall, Technometrics 29, 1987), the first alone every 370."""
TREND = RunsRule(RuleName.TREND, 5, 5, of_differences=True)
"""Third test of Nelson, Journal of Quality Technology 16, 1984."""
NELSON_RUN = RunsRule(RuleName.RUN, 9, 9)
"""Second test of Nelson."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """Centre, and standard deviation of the process without errors of sampling."""

    centre: float
    sd: float


@dataclass(frozen=True, slots=True)
class Violation:
    """A rule that a value completes."""

    place: int
    rule: RuleName
    began: int
    """Place of the first value of the pattern."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlChart:
    """A series beside its limits, by place: (n,) each."""

    sds: Values
    """Standard deviation of each value, that of sampling included; limits are `SIGMAS` of it from the centre."""
    ewma: Values
    ewma_reach: Values
    """Distance of the limits of `ewma` from the centre, exact from the first value on."""
    violations: tuple[Violation, ...]


def baseline_of(
    values: Sequence[float], errors: Sequence[float] | None = None, centre: float | None = None
) -> Baseline | None:
    """Return the baseline of a series by its mean and mean moving range, None of fewer than `MIN_BASELINE` values.

    `errors` are standard errors of sampling, which the moving range contains: their mean square is taken off. A given
    `centre` is not estimated.
    """
    if len(values) < MIN_BASELINE:
        return None
    variance = moving_range_sd(values) ** 2
    if errors is not None:
        variance = max(variance - float(np.mean(np.square(errors))), 0.0)
    return Baseline(float(np.mean(values)) if centre is None else centre, variance**0.5)


def moving_range_sd(values: Sequence[float]) -> float:
    """Return the standard deviation within a series of two values at least, blind to slow changes."""
    return float(np.abs(np.diff(values)).mean()) / MOVING_RANGE_FACTOR


def control_chart(
    values: Sequence[float],
    baseline: Baseline,
    errors: Sequence[float] | None = None,
    rules: Sequence[RunsRule] = (*WESTERN_ELECTRIC, TREND),
) -> ControlChart:
    """Return a series with its limits, its EWMA, and the rules that it violates, in the order of places.

    `errors`: standard error of sampling of each value; None: they are part of the baseline's standard deviation.
    """
    series = np.asarray(values, float) - baseline.centre
    series[np.abs(series) <= ROUNDING * abs(baseline.centre)] = (
        0.0  # equal values whose mean differs in the last digit
    )
    sds = np.hypot(baseline.sd, np.zeros(len(series)) if errors is None else np.asarray(errors, float))
    ewma, reach = _ewma(series, sds)
    found = [violation for rule in rules for violation in _violations(rule, series, sds)]
    found += _ewma_violations(ewma, reach)
    return ControlChart(
        sds=sds,
        ewma=ewma + baseline.centre,
        ewma_reach=reach,
        violations=tuple(sorted(found, key=lambda each: each.place)),
    )


def _ewma(series: Values, sds: Values) -> tuple[Values, Values]:
    """Return the EWMA of deviations, and `EWMA_SIGMAS` of its standard deviation.

    The variance follows the same recursion as the mean: for equal ones that is lambda / (2 - lambda)
    (1 - (1 - lambda)^2i), the exact limits of ISO 7870-6. After a signal, a value on the other side of the centre
    begins both anew: else the mean would be beyond its limits for a dozen values after the cause was removed.
    """
    ewma, variances = np.zeros(len(series)), np.zeros(len(series))
    mean = variance = 0.0
    for place, (value, sd) in enumerate(zip(series, sds, strict=True)):
        if mean * value < 0 and abs(mean) > EWMA_SIGMAS * variance**0.5:
            mean = variance = 0.0
        mean = EWMA_WEIGHT * value + (1 - EWMA_WEIGHT) * mean
        variance = (EWMA_WEIGHT * sd) ** 2 + (1 - EWMA_WEIGHT) ** 2 * variance
        ewma[place], variances[place] = mean, variance
    return ewma, EWMA_SIGMAS * np.sqrt(variances)


def _violations(rule: RunsRule, series: Values, sds: Values) -> Iterator[Violation]:
    looked_at = np.diff(series) if rule.of_differences else series
    reach = rule.sigmas * sds[len(series) - len(looked_at) :]
    for side in (1, -1):
        is_beyond = side * looked_at > reach
        for place in map(int, np.flatnonzero(is_beyond)):
            first = max(place - rule.of + 1, 0)
            if np.count_nonzero(is_beyond[first : place + 1]) >= rule.n:
                began = first + int(np.argmax(is_beyond[first : place + 1]))
                yield Violation(place + rule.of_differences, rule.name, began)


def _ewma_violations(ewma: Values, reach: Values) -> Iterator[Violation]:
    """Yield the places beyond the limits; the shift began when the mean was last on the other side of the centre."""
    for place in np.flatnonzero(np.abs(ewma) > reach):
        others = np.flatnonzero(ewma[:place] * ewma[place] <= 0)
        yield Violation(int(place), RuleName.EWMA, int(others[-1]) + 1 if len(others) else 0)
