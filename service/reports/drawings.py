"""Drawings of lots and of times as SVG, made on a connection to the store, in any process."""

import sqlite3
from dataclasses import dataclass

from service.base.language import Language
from service.lots.evaluation import lot_figures, passing_of, window_figures
from service.lots.figures import LotFigures
from service.lots.stones import Choice, stones_of_lot
from service.lots.yardsticks import Request
from service.reports.curve import Beside, curve_svg
from service.reports.words import words


@dataclass(frozen=True, slots=True, kw_only=True)
class CurveRequest:
    """How a curve is to be drawn, and what beside it."""

    figures: Request
    language: Language
    beside_lot: str | None = None
    beside_algorithm_version: str | None = None


def lot_curve_svg(
    connection: sqlite3.Connection, lot: str, choice: Choice, wanted: CurveRequest
) -> str | None:
    """Return the curve of a lot, or of a choice of its stones, as the report draws it; None if there is none."""
    figures = lot_figures(connection, lot, wanted.figures, choice)
    if figures is None:
        return None
    return _curve_svg(connection, figures, _name(lot, choice.algorithm_version, wanted.language), lot, wanted)


def window_curve_svg(
    connection: sqlite3.Connection,
    since: str,
    until: str,
    product: str | None,
    name: str,
    wanted: CurveRequest,
) -> str | None:
    """Return the curve of what fell within a time, None if the product is unknown; `name` is that of the time."""
    figures = window_figures(connection, since, until, wanted.figures, product)
    return None if figures is None else _curve_svg(connection, figures, name, None, wanted)


def _curve_svg(
    connection: sqlite3.Connection, figures: LotFigures, name: str, lot: str | None, wanted: CurveRequest
) -> str:
    """Return the curve with the one beside it; without `beside_lot` that is of the same lot."""
    version, beside = wanted.beside_algorithm_version, None
    other = wanted.beside_lot or (lot if version else None)
    if other is not None:
        beside = Beside(
            first_name=name,
            name=_name(other, version, wanted.language),
            passing_percent=passing_of(
                stones_of_lot(connection, other, Choice(algorithm_version=version)).lot,
                [step.sieve_mm for step in figures.curve],
                wanted.figures.measured,
            ),
        )
    return curve_svg(figures.curve, language=wanted.language, beside=beside)


def _name(lot: str, algorithm_version: str | None, language: Language) -> str:
    if algorithm_version is None:
        return lot
    return words(language)("curve.by_version", name=lot, version=algorithm_version)
