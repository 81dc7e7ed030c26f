"""The report as one CSV table (RFC 4180) in the words of REST: the same columns in every row and every language."""

import csv
from io import StringIO

from service.reports.flat import Row, rows
from service.reports.report import ReportData, Scalar
from service.reports.texts import plain

COLUMNS = (
    "section",
    "name",
    "sieve_mm",
    "value",
    "unit",
    "low_95",
    "high_95",
    "standard_error",
    "sampling_se",
    "measuring_se",
    "systematic_se",
    "n_effective",
    "state",
    "limit_min",
    "limit_max",
    "verdict",
    "more_stones",
    "more_s",
)
FORMULA_STARTS = ("=", "+", "-", "@", "＝", "＋", "－", "＠")  # spreadsheets read the wide ones alike


def render_csv(data: ReportData) -> bytes:
    """Return the report as CSV: UTF-8, commas, decimal points, empty where there is no value."""
    file = StringIO(newline="")
    writer = csv.writer(file, lineterminator="\r\n")
    writer.writerow(COLUMNS)
    writer.writerows([cell(value) for value in _values(row)] for row in rows(data))
    return file.getvalue().encode("utf-8", "replace")


def cell(value: Scalar) -> str:
    """Return a cell; a text that a spreadsheet would compute has an apostrophe before it."""
    match value:
        case None:
            return ""
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value)
    text = plain(value)
    return f"'{text}" if text.lstrip().startswith(FORMULA_STARTS) else text


def _values(row: Row) -> tuple[Scalar, ...]:
    figure, decision = row.figure, row.decision
    uncertain: tuple[Scalar, ...] = (None,) * 7
    if figure is not None:
        uncertain = (
            figure.low,
            figure.high,
            figure.standard_error,
            figure.sampling_se,
            figure.measuring_se,
            figure.systematic_se,
            None if figure.value is None else figure.n_effective,
        )
    decided: tuple[Scalar, ...] = (None,) * 5
    if decision is not None:
        decided = (
            decision.limits.min_percent,
            decision.limits.max_percent,
            str(decision.verdict),
            decision.more_stones,
            decision.more_s,
        )
    state = None if figure is None else str(figure.state)
    return (row.section, row.name, row.sieve_mm, row.value, row.unit, *uncertain, state, *decided)
