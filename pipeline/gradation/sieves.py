"""Sets of sieves, the range of sizes that is measured, and the test portions that standards require."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pipeline.schema import SCHEMA


@dataclass(frozen=True, slots=True, kw_only=True)
class SieveSet:
    """A set of sieves."""

    __pydantic_config__ = SCHEMA

    name: str
    """Name to be used as `sieve_set`."""
    source: str
    """Standard that it is from."""
    apertures_mm: tuple[float, ...]
    """Apertures, mm, rising."""

    def __post_init__(self) -> None:
        if not self.apertures_mm or self.apertures_mm[0] <= 0:
            raise ValueError(f"sieve set {self.name!r} needs apertures above 0 mm")
        if any(b <= a for a, b in zip(self.apertures_mm, self.apertures_mm[1:], strict=False)):
            raise ValueError(f"apertures of sieve set {self.name!r} must rise")


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredRange:
    """Sizes between which every stone that falls is seen whole; beyond, a passing is not measured, never 0 or 100."""

    min_mm: float = 4.0
    max_mm: float = 40.0

    def __contains__(self, size_mm: float) -> bool:
        return self.min_mm <= size_mm <= self.max_mm

    def within(self, min_mm: float, max_mm: float) -> "MeasuredRange":
        """Return the part of the range that lies between two sizes."""
        return MeasuredRange(min_mm=max(self.min_mm, min_mm), max_mm=min(self.max_mm, max_mm))


ALL_SIZES = MeasuredRange(min_mm=0.0, max_mm=np.inf)
"""The range of a laboratory's sieves."""
OF_THE_RIG = MeasuredRange()
"""The range of the light gate and the field of view, where nothing else is configured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LeastPortions:
    """Least mass of a test portion by the upper size D of the product."""

    source: str
    kg_by_size_mm: Mapping[float, float] = field(default_factory=dict)

    def least_kg(self, upper_mm: float) -> float:
        """Return the least mass for D; between sizes of the table interpolated on logarithmic scales."""
        sizes_mm = sorted(self.kg_by_size_mm)
        kg = [self.kg_by_size_mm[size_mm] for size_mm in sizes_mm]
        return float(np.exp(np.interp(np.log(upper_mm), np.log(sizes_mm), np.log(kg))))
