"""Chances, for shape indices, that a stone lies between two sieves and that its lengths exceed a ratio."""

from collections.abc import Sequence
from math import hypot

import numpy as np

from pipeline.arrays import Values
from pipeline.gradation.estimators import Chances, Property, chance_up_to
from pipeline.gradation.sieves import MeasuredRange
from pipeline.gradation.stones import Lot


def chance_between(lot: Lot, low_mm: float, high_mm: float) -> Values:
    """Return the probability that each stone passes the larger and not the smaller of two sieves."""
    sizes_mm, sds_mm = lot.column("sieve_size_mm"), lot.column("sieve_size_sd_mm")
    return chance_up_to(sizes_mm, sds_mm, high_mm) - chance_up_to(sizes_mm, sds_mm, low_mm)


def exceeds(long: str, short: str, limit: float, spans: Sequence[MeasuredRange]) -> Property:
    """Return the property that one length is more than so many times the other, of stones of these sizes."""

    def chances(lot: Lot) -> Chances:
        counts = np.zeros(lot.n_measured)
        for span in spans:
            counts += chance_between(lot, span.min_mm, span.max_mm)
        excess_mm = lot.column(long) - limit * lot.column(short)
        sds_mm = lot.column("feret_sd_mm") * hypot(1.0, limit)
        return Chances(counts, counts * (1 - chance_up_to(excess_mm, sds_mm, 0.0)))

    return chances
