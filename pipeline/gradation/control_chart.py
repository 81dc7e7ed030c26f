"""Control chart of single values, as of the verification sphere of each shift (ISO 7870-2)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SIGMAS = 3.0
MOVING_RANGE_FACTOR = 1.128
"""Mean difference of two normal values, in standard deviations (d2)."""
RUN = 9
"""Values in a row on one side of the centre that are a shift, even within the limits."""
MIN_BASELINE = 8
"""Values from which limits are computed at the least; before, there are none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlChart:
    """Centre, limits, and which of the values are out of control, by their places in the series."""

    centre: float
    lower: float | None  # None: too few values for limits
    upper: float | None
    beyond_limits: tuple[int, ...]
    shifted: tuple[int, ...]  # the ninth value in a row on one side, and those after it


def control_chart(
    values: Sequence[float], *, n_baseline: int | None = None, centre: float | None = None
) -> ControlChart:
    """Return the chart of a series, whose limits come from the moving range of its first `n_baseline` values.

    Without `n_baseline` all values are the baseline; without `centre` (as the sphere's true diameter) its mean is.

    Raises
    ------
    ValueError
        There is no value.
    """
    if not len(values):
        raise ValueError("a control chart needs a value")
    series = np.asarray(values, float)
    baseline = series[:n_baseline]
    middle = float(baseline.mean()) if centre is None else centre
    lower = upper = None
    beyond: tuple[int, ...] = ()
    if len(baseline) >= MIN_BASELINE:
        reach = SIGMAS * float(np.abs(np.diff(baseline)).mean()) / MOVING_RANGE_FACTOR
        lower, upper = middle - reach, middle + reach
        beyond = tuple(int(i) for i in np.flatnonzero((series < lower) | (series > upper)))
    return ControlChart(
        centre=middle,
        lower=lower,
        upper=upper,
        beyond_limits=beyond,
        shifted=_shifted(series > middle, series < middle),
    )


def _shifted(*sides: np.ndarray) -> tuple[int, ...]:
    """Return the places at which a run on one side is long enough."""
    places: list[int] = []
    for is_there in sides:
        run = 0
        for place, there in enumerate(is_there):
            run = run + 1 if there else 0
            if run >= RUN:
                places.append(place)
    return tuple(sorted(places))
