"""Stones as a gradation sees them, and the lot that they are folded into."""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, astuple, dataclass, field, fields, replace
from enum import StrEnum
from math import isfinite, isnan, nan, pi
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Floats, Values
from pipeline.schema import SCHEMA

UNKNOWN = nan
"""Default of a measure of `Stone` that stones of earlier versions lack: a figure leaves out those without it."""


class Fate(StrEnum):
    """Fate of a stone; the words of a result's outcome."""

    MEASURED = "measured"
    REJECTED = "rejected"
    LOST = "lost"


@dataclass(frozen=True, slots=True, kw_only=True)
class Stone:
    """The measures of one stone, each standard deviation that of its random error.

    Errors that all stones share, as that of the calibration's scale, belong to `evaluate(..., scale_sd=)`.
    """

    volume_mm3: float
    sieve_size_mm: float
    max_feret_mm: float
    min_feret_mm: float
    length_mm: float
    width_mm: float
    thickness_mm: float
    volume_sd: float = 0.0  # relative
    sieve_size_sd_mm: float = 0.0
    feret_sd_mm: float = 0.0  # of the two Ferets and of length, width and thickness
    elongation_ratio: float = UNKNOWN
    flatness_ratio: float = UNKNOWN
    sphericity: float = UNKNOWN
    convexity: float = UNKNOWN
    angularity: float = UNKNOWN
    quality: str = "good"

    def __post_init__(self) -> None:
        for name in MEASURES:
            value = getattr(self, name)
            if name in OPTIONAL and isnan(value):
                continue
            if not isfinite(value) or value < 0 or (value == 0 and name in REQUIRED):
                raise ValueError(f"{name} of a stone must be positive, not {value!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class UnmeasuredStone:
    """A stone that fell and has no measures, or as many as `n_stones`: rejected or lost, for a reason."""

    fate: Fate
    reason: str
    n_stones: int = 1


MEASURES = tuple(item.name for item in fields(Stone) if item.name != "quality")
"""The numbers of a stone, in the order of the columns of `Lot`."""
REQUIRED = tuple(item.name for item in fields(Stone) if item.default is MISSING)
"""Measures that every stone has."""
OPTIONAL = tuple(item.name for item in fields(Stone) if item.default is UNKNOWN)
"""Measures that a stone may lack."""
DEVIATIONS = tuple(name for name in MEASURES if name not in (*REQUIRED, *OPTIONAL))
POWERS_OF_LENGTH = {"mm": 1, "mm2": 2, "mm3": 3}
"""Power of the lengths that a measure grows with, by the unit that ends its name; others are ratios."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lot:
    """All that a gradation needs of the stones of a lot; `fold` and `merge` make larger ones.

    Every statistic of a lot is that of its stones in one canonical order, so it does not depend, to the last digit,
    on how the lot was put together.
    """

    measures: Floats = field(
        default_factory=lambda: np.empty((len(MEASURES), 0))
    )  # a row for each of MEASURES
    counts: Mapping[tuple[Fate, str], int] = field(default_factory=lambda: MappingProxyType({}))
    """Number of stones by fate, and by quality or reason."""

    def column(self, name: str) -> Values:
        """Return one measure of all stones; `name` is one of `MEASURES`."""
        return self.measures[MEASURES.index(name)]

    @property
    def n_measured(self) -> int:
        """Number of stones with measures."""
        return self.measures.shape[1]

    def canonical(self) -> "Lot":
        """Return the lot with its stones by size; equal ones are interchangeable."""
        return replace(self, measures=self.measures[:, self.order()])

    def order(self) -> NDArray[np.intp]:
        """Return the places of the stones in the order of `canonical`."""
        return np.lexsort((*self.measures, self.column("sieve_size_mm")))

    def where(self, is_wanted: NDArray[np.bool_]) -> "Lot":
        """Return some of the measured stones, in the same order; their qualities are counted no more."""
        return Lot(measures=self.measures[:, is_wanted])

    def scaled(self, factor: float) -> "Lot":
        """Return the lot as an instrument sees it whose lengths are larger by `factor`."""
        powers = [POWERS_OF_LENGTH.get(name.rpartition("_")[2], 0) for name in MEASURES]
        return replace(self, measures=self.measures * factor ** np.array(powers)[:, None])

    def without_errors(self) -> "Lot":
        """Return the lot as measured, taken for the truth."""
        is_measure = [name not in DEVIATIONS for name in MEASURES]
        return replace(self, measures=self.measures * np.array(is_measure)[:, None])

    def with_sizes(self, sieve_sizes_mm: Values) -> "Lot":
        """Return the lot with other sieve sizes."""
        measures = self.measures.copy()
        measures[MEASURES.index("sieve_size_mm")] = sieve_sizes_mm
        return replace(self, measures=measures)


def lot_of(stones: Iterable[Stone | UnmeasuredStone]) -> Lot:
    """Return the lot of these stones."""
    counts: Counter[tuple[Fate, str]] = Counter()
    rows = []
    for stone in stones:
        if isinstance(stone, UnmeasuredStone):
            counts[stone.fate, stone.reason] += stone.n_stones
        else:
            counts[Fate.MEASURED, stone.quality] += 1
            rows.append(astuple(stone)[: len(MEASURES)])
    return Lot(
        measures=np.array(rows, float).reshape(-1, len(MEASURES)).T, counts=MappingProxyType(dict(counts))
    )


def fold(lot: Lot, stone: Stone | UnmeasuredStone) -> Lot:
    """Return the lot with one more stone."""
    return merge(lot, lot_of([stone]))


def merge(a: Lot, b: Lot) -> Lot:
    """Return the lot of the stones of both."""
    return Lot(
        measures=np.hstack((a.measures, b.measures)),
        counts=MappingProxyType(dict(Counter(a.counts) + Counter(b.counts))),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Unmeasured:
    """Stones that fell and are in no figure, and what they may have weighed."""

    __pydantic_config__ = SCHEMA

    n_stones: int
    """Rejected and lost stones"""
    by_reason: Mapping[str, int]
    """By outcome and reason, such as `rejected: clipped`"""
    expected_percent: float | None
    """Share of the measured mass, if each was as heavy as the mean"""
    at_most_percent: float | None
    """The same if each was as heavy as the heaviest, or as a sphere that fills the view"""


def unmeasured_mass(lot: Lot, largest_mm: float) -> Unmeasured:
    """Return the mass that may be missing in the curve, in percent of the measured mass, None while that is nothing.

    `largest_mm` is the largest size that can be measured: a clipped stone may be just that large.
    """
    by_reason = {
        f"{fate}: {reason}": n
        for (fate, reason), n in sorted(lot.counts.items())
        if fate is not Fate.MEASURED
    }
    n_stones, volumes_mm3 = sum(by_reason.values()), np.sort(lot.column("volume_mm3"))
    if not len(volumes_mm3):
        return Unmeasured(n_stones=n_stones, by_reason=by_reason, expected_percent=None, at_most_percent=None)
    largest_mm3 = max(float(volumes_mm3[-1]), pi / 6 * largest_mm**3)
    return Unmeasured(
        n_stones=n_stones,
        by_reason=by_reason,
        expected_percent=100 * n_stones / len(volumes_mm3),
        at_most_percent=100 * n_stones * largest_mm3 / float(volumes_mm3.sum()),
    )
