"""Repeatability and reproducibility of a figure, from repeated runs of one sample (ISO 5725-2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.special import chdtri

from pipeline.schema import SCHEMA

LIMIT_FACTOR = 2.8
"""1.96 sqrt(2): two results differ by less than so many standard deviations in 95 % of cases."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeatability:
    """How far the runs of a sample lie apart in one figure."""

    __pydantic_config__ = SCHEMA

    mean: float
    """Mean of all runs, in the unit of the figure's name."""
    n_groups: int
    """Groups of runs under equal conditions."""
    n_runs: int
    """All runs."""
    repeatability_sd: float
    """s_r: of runs under equal conditions."""
    repeatability_sd_low: float
    """Lower end of the 95 % interval of s_r, by chi-square with as many degrees of freedom as runs less groups."""
    repeatability_sd_high: float
    """Upper end of it."""
    between_sd: float | None
    """s_L: between groups, beyond what s_r explains; null with one."""
    reproducibility_sd: float | None
    """s_R: both together; null with one group."""

    repeatability_limit: float
    """r = 2.8 s_r: two runs under equal conditions differ by less, 95 %."""
    reproducibility_limit: float | None
    """R = 2.8 s_R; null with one group."""


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
    repeatability_sd = sqrt(within)
    freedom = n_runs - n_groups
    low, high = (repeatability_sd * sqrt(freedom / chdtri(freedom, above)) for above in (0.025, 0.975))
    reproducibility_sd = None if between_sd is None else sqrt(between_sd**2 + within)
    return Repeatability(
        mean=mean,
        n_groups=n_groups,
        n_runs=int(n_runs),
        repeatability_sd=repeatability_sd,
        repeatability_sd_low=float(low),
        repeatability_sd_high=float(high),
        between_sd=between_sd,
        reproducibility_sd=reproducibility_sd,
        repeatability_limit=LIMIT_FACTOR * repeatability_sd,
        reproducibility_limit=None if reproducibility_sd is None else LIMIT_FACTOR * reproducibility_sd,
    )
