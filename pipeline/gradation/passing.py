"""Gradation of a set of stones: percent passing by mass, each stone at its own sieve size.

All stones are taken to have one density: mass is then proportional to volume, and the density cancels.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

SIEVES_MM = (
    2.0,
    2.8,
    4.0,
    5.0,
    5.6,
    6.3,
    8.0,
    10.0,
    11.2,
    12.5,
    14.0,
    16.0,
    20.0,
    22.4,
    25.0,
    31.5,
    40.0,
    45.0,
    63.0,
)
"""Apertures in mm: EN 933-2's basic set and sets 1 and 2 in the measured range, and sizes of R 20 between them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LotGradation:
    """Cumulative curve: `passing_percent[i]` is the share of the volume with a sieve size up to `sieves_mm[i]`."""

    n_stones: int
    volume_mm3: float
    sieves_mm: tuple[float, ...]
    passing_percent: tuple[float, ...]
    quantiles_mm: dict[str, float | None]  # D10...D90; None beyond the ends of the curve


def gradation(
    sieve_sizes_mm: Sequence[float], volumes_mm3: Sequence[float], sieves_mm: Sequence[float] = SIEVES_MM
) -> LotGradation:
    """Return the gradation P(s) = 100 sum(V_i [d_i <= s]) / sum(V_i); a stone of size s passes the sieve s.

    Raises
    ------
    ValueError
        The two sequences differ in length, or a volume or size is not positive.
    """
    sizes, volumes = np.asarray(sieve_sizes_mm, float), np.asarray(volumes_mm3, float)
    if sizes.shape != volumes.shape:
        raise ValueError(
            f"each stone needs a sieve size and a volume, not {sizes.shape} sizes, {volumes.shape} volumes"
        )
    if (sizes <= 0).any() or (volumes <= 0).any():
        raise ValueError("sieve sizes and volumes must be positive")
    total_mm3 = float(volumes.sum())
    passing = [
        float(100 * (volumes[sizes <= sieve].sum() / total_mm3)) if total_mm3 else 0.0 for sieve in sieves_mm
    ]
    return LotGradation(
        n_stones=len(sizes),
        volume_mm3=total_mm3,
        sieves_mm=tuple(sieves_mm),
        passing_percent=tuple(passing),
        quantiles_mm={f"D{p}": quantile_mm(sieves_mm, passing, p) for p in (10, 30, 50, 60, 90)},
    )


def quantile_mm(sieves_mm: Sequence[float], passing_percent: Sequence[float], percent: float) -> float | None:
    """Return the size that `percent` pass: log-linear between neighbouring sieves, `None` beyond the curve's ends."""
    sieves, passing = np.asarray(sieves_mm, float), np.asarray(passing_percent, float)
    above = np.flatnonzero(passing >= percent)
    if len(above) == 0 or above[0] == 0:
        return None
    high = int(above[0])
    low = high - 1
    share = (percent - passing[low]) / (passing[high] - passing[low])
    return float(np.exp(np.log(sieves[low]) + share * np.log(sieves[high] / sieves[low])))
