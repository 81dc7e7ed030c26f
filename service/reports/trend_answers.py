"""Trends, the diary's changes and comparisons, made on a connection to the store, in any process."""

import sqlite3

from pipeline.gradation.sieves import MeasuredRange
from service.base.language import Language
from service.lots.comparing import Side, compare_lots
from service.lots.trends.changes import changes
from service.lots.trends.trend import trend
from service.lots.yardsticks import Request
from service.reports.changes import with_sentences
from service.reports.trend import TrendFigure, trend_svg


def trend_json(connection: sqlite3.Connection, now: str, hours: float, measured: MeasuredRange) -> str:
    """Return the trend of rate, size and shape over the last hours."""
    return trend(connection, now, hours, measured).model_dump_json()


def trend_drawing(
    connection: sqlite3.Connection,
    now: str,
    hours: float,
    measured: MeasuredRange,
    figure: TrendFigure,
    language: Language,
) -> str:
    """Return the drawing of one of these figures."""
    return trend_svg(trend(connection, now, hours, measured), figure, language)


def changes_json(
    connection: sqlite3.Connection, now: str, hours: float, measured: MeasuredRange, language: Language
) -> str:
    """Return the changes since each entry of the diary, with a sentence for each figure."""
    return with_sentences(changes(connection, now, hours, measured), language, now).model_dump_json()


def comparison_json(connection: sqlite3.Connection, a: Side, b: Side, request: Request) -> str | None:
    """Return the comparison of two lots, or of one as two versions measured it; None if there is no such lot."""
    found = compare_lots(connection, a, b, request)
    return None if found is None else found.model_dump_json()
