"""Whether a figure of two groups of stones differs by more than chance explains."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np
from scipy.special import stdtr

from pipeline.gradation.estimates import MIN_EFFECTIVE, standard_errors_to_either_end
from pipeline.gradation.influences import Influences

ALPHA = 0.05
"""Chance that any of the figures that are looked at together is called significant though nothing has changed."""
MIN_BLOCKS, MAX_BLOCKS = 5, 20
"""Blocks in time that a group of stones is parted into."""
EFFECTIVE_A_BLOCK = 10.0
"""Effective number of stones that a block has, as long as there are `MIN_BLOCKS`."""
MAX_CORRELATION = 0.8
"""Greatest correlation of neighbouring blocks that is believed: with more there are too few blocks to tell."""


class Spread(NamedTuple):
    """Variance of a figure, and the degrees of freedom that it is known with."""

    variance: float
    freedom: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Difference:
    """A figure of the second group less that of the first, with its 95 % interval."""

    value: float
    low: float
    high: float
    standard_error: float
    p_value: float  # two-sided; 1.0 where nothing differs
    can_be_judged: bool  # both groups are large enough


def difference_in_time(before: Influences, after: Influences) -> Difference:
    """Return the difference of two groups of stones, each in the order in which they fell.

    Stones that fall soon after each other are alike, so the variance is that of sums over blocks in time (batch means,
    with the correlation of neighbouring ones), never below the one that independent stones would have.
    """
    return _difference(before, after, [_spread_in_time(before), _spread_in_time(after)])


def difference_of_lots(first: Influences, second: Influences) -> Difference:
    """Return the difference of two lots without a common stone."""
    return _difference(
        first, second, [Spread(each.variance, each.n_effective - 1) for each in (first, second)]
    )


def difference_of_versions(
    first: Influences, second: Influences, first_ids: Sequence[str], second_ids: Sequence[str]
) -> Difference:
    """Return the difference of one lot measured twice: what stones that are in both do to both cancels."""
    places = {name: place for place, name in enumerate(dict.fromkeys((*first_ids, *second_ids)))}
    changes = np.zeros(len(places))
    changes[[places[name] for name in second_ids]] += second.of_stones
    changes[[places[name] for name in first_ids]] -= first.of_stones
    freedom = min(first.n_effective, second.n_effective) - 1
    return _difference(first, second, [Spread(float(np.sum(changes**2)), freedom)])


def significant(p_values: Mapping[str, float]) -> set[str]:
    """Return those of several figures that differ by more than chance, by Holm's step-down method."""
    found: set[str] = set()
    for n_done, (name, p_value) in enumerate(sorted(p_values.items(), key=lambda item: item[1])):
        if p_value > ALPHA / (len(p_values) - n_done):
            break
        found.add(name)
    return found


def _spread_in_time(figure: Influences) -> Spread:
    """Return the spread of a figure by blocks of stones that fell one after the other."""
    n_blocks = int(np.clip(figure.n_effective / EFFECTIVE_A_BLOCK, MIN_BLOCKS, MAX_BLOCKS))
    sums = np.array([block.sum() for block in np.array_split(figure.of_stones, n_blocks)])
    squares = float(np.sum(sums**2))
    if not squares:
        return Spread(figure.variance, n_blocks - 1)
    # of sums that add up to zero the correlation is too low, by about one over their number
    correlation = float(np.clip(np.sum(sums[1:] * sums[:-1]) / squares + 1 / n_blocks, 0, MAX_CORRELATION))
    n_alike = (1 + correlation) / (1 - correlation)  # blocks that tell as much as one
    by_blocks = n_alike * n_blocks / (n_blocks - 1) * squares
    return Spread(max(by_blocks, figure.variance), (n_blocks - 1) / n_alike)


def _difference(first: Influences, second: Influences, spreads: Sequence[Spread]) -> Difference:
    """Return the difference with its interval, by Welch's t."""
    value, variance = second.value - first.value, sum(each.variance for each in spreads)
    standard_error, freedom = sqrt(variance), 1.0
    p_value = 1.0 if value == 0 else 0.0
    if variance:
        freedom = variance**2 / sum(each.variance**2 / max(each.freedom, 1.0) for each in spreads)
        p_value = 2 * float(stdtr(freedom, -abs(value) / standard_error))
    half = standard_errors_to_either_end(freedom) * standard_error
    return Difference(
        value=value,
        low=value - half,
        high=value + half,
        standard_error=standard_error,
        p_value=p_value,
        can_be_judged=min(first.n_effective, second.n_effective) >= MIN_EFFECTIVE,
    )
