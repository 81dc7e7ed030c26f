"""Tables as CSV (RFC 4180) that spreadsheets read: no text becomes a formula."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from io import StringIO

from service.base.language import Language

FORMULA_STARTS = ("=", "+", "-", "@", "＝", "＋", "－", "＠")  # spreadsheets read the wide ones alike


@dataclass(frozen=True, slots=True, kw_only=True)
class CsvStyle:
    """How a spreadsheet expects its tables."""

    delimiter: str = ","
    decimal_mark: str = "."
    byte_order_mark: str = ""


RFC_4180 = CsvStyle()
STYLES = {
    Language.ENGLISH: RFC_4180,
    Language.GERMAN: CsvStyle(delimiter=";", decimal_mark=",", byte_order_mark="\ufeff"),
}
"""By the language of the spreadsheet: a German one takes commas for decimal marks, so a line would be one cell."""


def csv_text(rows: Iterable[Iterable[object]], style: CsvStyle = RFC_4180, *, is_first: bool = True) -> str:
    """Return rows as CSV; a text that a spreadsheet would compute has an apostrophe before it.

    `is_first` is False for the further rows of a table, before which stands no byte order mark.
    """
    file = StringIO(newline="")
    writer = csv.writer(file, delimiter=style.delimiter, lineterminator="\r\n")
    writer.writerows([_cell(value, style) for value in row] for row in rows)
    return (style.byte_order_mark if is_first else "") + file.getvalue()


def _cell(value: object, style: CsvStyle) -> object:
    if isinstance(value, float):
        return str(value).replace(".", style.decimal_mark)
    is_formula = isinstance(value, str) and value.lstrip().startswith(FORMULA_STARTS)
    return f"'{value}" if is_formula else value
