"""Tables as CSV (RFC 4180) that spreadsheets read: no text becomes a formula."""

import csv
from collections.abc import Iterable
from io import StringIO

FORMULA_STARTS = ("=", "+", "-", "@", "＝", "＋", "－", "＠")  # spreadsheets read the wide ones alike


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    """Return rows as CSV; a text that a spreadsheet would compute has an apostrophe before it."""
    file = StringIO(newline="")
    csv.writer(file, lineterminator="\r\n").writerows(map(_cell, row) for row in rows)
    return file.getvalue()


def _cell(value: object) -> object:
    is_formula = isinstance(value, str) and value.lstrip().startswith(FORMULA_STARTS)
    return f"'{value}" if is_formula else value
