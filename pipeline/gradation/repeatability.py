"""Repeatability and reproducibility of a figure, from repeated runs of one sample (ISO 5725-2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

LIMIT_FACTOR = 2.8
"""1.96 sqrt(2): two results differ by less than so many standard deviations in 95 % of cases."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeatability:
    """Standard deviations of a figure: within a group of runs, between groups, and both."""

    mean: float
    n_groups: int
    n_runs: int
    repeatability_sd: float  # s_r
    between_sd: float | None  # s_L; None with one group
    reproducibility_sd: float | None  # s_R

    @property
    def repeatability_limit(self) -> float:
        """Least difference of two runs of one group that is remarkable: r."""
        return LIMIT_FACTOR * self.repeatability_sd

    @property
    def reproducibility_limit(self) -> float | None:
        """Least difference of two runs of different groups that is remarkable: R."""
        return None if self.reproducibility_sd is None else LIMIT_FACTOR * self.reproducibility_sd


def repeatability(groups: Sequence[Sequence[float]]) -> Repeatability:
    """Return s_r, s_L and s_R; a group holds the runs under equal conditions: a day, an operator, an instrument.

    Raises
    ------
    ValueError
        No group has two runs.
    """
    runs = [np.asarray(group, float) for group in groups if len(group)]
    numbers = np.array([len(group) for group in runs], float)
    n_runs, n_groups = numbers.sum(), len(runs)
    if n_runs <= n_groups:
        raise ValueError("repeatability needs a group with two runs or more")
    mean = float(np.concatenate(runs).mean())
    within = sum(float(np.sum((group - group.mean()) ** 2)) for group in runs) / (n_runs - n_groups)
    between_sd = None
    if n_groups > 1:
        of_means = sum(len(group) * (float(group.mean()) - mean) ** 2 for group in runs) / (n_groups - 1)
        typical_number = (n_runs - float(np.sum(numbers**2)) / n_runs) / (n_groups - 1)
        between_sd = sqrt(max((of_means - within) / typical_number, 0.0))
    return Repeatability(
        mean=mean,
        n_groups=n_groups,
        n_runs=int(n_runs),
        repeatability_sd=sqrt(within),
        between_sd=between_sd,
        reproducibility_sd=None if between_sd is None else sqrt(between_sd**2 + within),
    )
