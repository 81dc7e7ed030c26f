"""Distributions of shape over the stones of a lot, by mass and by number."""

import sqlite3

from pipeline.gradation.distributions import Distribution, ShapeMeasure, distribution_of
from pipeline.gradation.estimators import sample_of
from service.base.status import Report
from service.lots.lots import find_lot
from service.lots.stones import Choice, stones_of_lot


class LotDistributions(Report):
    """Distributions of the measures of shape over the measured stones of a lot."""

    lot: str
    """Id of the lot"""
    measured: int
    """Stones with a body and its measures"""
    items: list[Distribution]
    """One a measure"""


def lot_distributions(connection: sqlite3.Connection, lot: str, choice: Choice) -> LotDistributions | None:
    """Return the distributions of a lot, or of a choice of its stones; None if there is no such lot.

    Raises `UnknownChoiceError` as `stones_of_lot` does.
    """
    if find_lot(connection, lot) is None:
        return None
    sample = sample_of(stones_of_lot(connection, lot, choice).lot)
    items = [distribution_of(sample, measure) for measure in ShapeMeasure]
    return LotDistributions(lot=lot, measured=sample.lot.n_measured, items=items)
