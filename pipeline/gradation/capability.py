"""How well a process keeps its limits: the indices Cpk and Ppk (ISO 22514-2), for normal values."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np
from scipy.special import ndtri

from pipeline.gradation.control_chart import moving_range_sd
from pipeline.gradation.estimates import COVERAGE
from pipeline.schema import SCHEMA

MIN_CAPABILITY = 20
"""Values that an index rests on at the least: of 20 its interval still is a third of it either way."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capability:
    """Distance of the mean from the nearest limit, in three standard deviations."""

    __pydantic_config__ = SCHEMA

    cpk: float
    """By the standard deviation between neighbours: what the process can do; errors of sampling are part of it"""
    ppk: float
    """By the standard deviation of all values: what it did, slow changes included"""
    ppk_low: float
    """Lower end of the 95 % interval of `ppk` (Bissell 1990)"""
    ppk_high: float
    """Upper end of it"""
    n: int
    """Values that they rest on, at least 20"""


def capability(
    values: Sequence[float], lower: float | None = None, upper: float | None = None
) -> Capability | None:
    """Return the indices against one limit or two, None without a limit, of too few values, or of equal ones."""
    n = len(values)
    if n < MIN_CAPABILITY or (lower is None and upper is None):
        return None
    within, overall = moving_range_sd(values), float(np.std(values, ddof=1))
    if within == 0.0 or overall == 0.0:
        return None
    mean = float(np.mean(values))
    distance = min(
        inf if upper is None else upper - mean,
        inf if lower is None else mean - lower,
    )
    ppk = distance / (3 * overall)
    reach = float(ndtri((1 + COVERAGE) / 2)) * (1 / (9 * n) + ppk**2 / (2 * (n - 1))) ** 0.5
    return Capability(cpk=distance / (3 * within), ppk=ppk, ppk_low=ppk - reach, ppk_high=ppk + reach, n=n)
