"""Correction of a stone's volume, from the volumes of its visual hull and of the estimated body.

The hull is always too large, and its gap g to the estimate says by how much:

    ln V = ln V_hull - gap_share g - hidden_share,    g = ln(V_hull / V_estimate).

With `gap_share` 1 the volume is the estimate's; a little more corrects the excess that the estimate still has on
average, `hidden_share` corrects for dents and pores that no silhouette shows. Known bodies determine the first,
weighed stones of the quarry both. Fewer views leave a larger gap, so the same coefficients serve them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True, kw_only=True)
class VolumeModel:
    """Coefficients of the correction, fitted to known bodies or to weighed stones."""

    id: str  # named in every result
    gap_share: float
    hidden_share: float = 0.0

    def __post_init__(self) -> None:
        if not self.id:
            raise ValueError("id must not be empty")
        if not 0 <= self.gap_share <= 3:
            raise ValueError(f"gap_share must be in 0..3, not {self.gap_share}")
        if not -0.2 <= self.hidden_share <= 0.5:
            raise ValueError(f"hidden_share must be in -0.2..0.5, not {self.hidden_share}")

    def volume_mm3(self, hull_mm3: float, estimate_mm3: float) -> float:
        """Return the corrected volume, never more than the hull's."""
        missing = self.gap_share * math.log(hull_mm3 / estimate_mm3) + self.hidden_share
        return hull_mm3 * math.exp(-max(missing, 0.0))


SYNTHETIC = VolumeModel(id="synthetic-3", gap_share=1.03)
"""Default coefficients, fitted by tests/accuracy/fit_estimate.py to bodies without hidden dents."""

MIN_BODIES = 5
"""Least number of bodies to fit coefficients to."""


def fit_volume_model(
    id: str, hull_mm3: Sequence[float], estimate_mm3: Sequence[float], true_mm3: Sequence[float]
) -> VolumeModel:
    """Fit the coefficients to bodies of known volume, by least squares of the logarithms.

    Raises
    ------
    ValueError
        Fewer than `MIN_BODIES`, bodies so alike that they do not tell the coefficients apart, or
        coefficients that no stones can have.
    """
    if not len(hull_mm3) == len(estimate_mm3) == len(true_mm3) >= MIN_BODIES:
        raise ValueError(f"{len(true_mm3)} bodies of known volume are too few, {MIN_BODIES} are needed")
    gaps = np.log(hull_mm3) - np.log(estimate_mm3)
    missing = np.log(hull_mm3) - np.log(true_mm3)
    if np.ptp(gaps) < 0.005:
        raise ValueError(
            "the gaps between hull and estimate are too much alike to be fitted: add other forms of stones"
        )
    (gap_share, hidden_share), *_ = np.linalg.lstsq(
        np.column_stack([gaps, np.ones_like(gaps)]), missing, rcond=None
    )
    return VolumeModel(id=id, gap_share=float(gap_share), hidden_share=float(hidden_share))
