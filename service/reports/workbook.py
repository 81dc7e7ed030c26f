"""The report as a workbook: curve with its chart, indices, accounting. No text becomes a formula."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from io import BytesIO
from math import isfinite

from xlsxwriter import Workbook
from xlsxwriter.worksheet import Worksheet

from pipeline.gradation.d4791 import FlatAndElongated
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.specification import Decision
from service.lots.figures import shares_of
from service.reports.content import accounted, calibration, document_of, uncertainty
from service.reports.csv_file import accounting_rows
from service.reports.document import NamesAndValues, Note
from service.reports.report import ReportData, Scalar
from service.reports.results import judged_indices, laboratory
from service.reports.words import Words, plain, words

OPTIONS = {
    "in_memory": True,
    "strings_to_formulas": False,
    "strings_to_urls": False,
    "strings_to_numbers": False,
}


def render_xlsx(data: ReportData) -> bytes:
    """Return the report as a workbook."""
    file, say = BytesIO(), words(data.language, data.plant.zone)
    with Workbook(file, OPTIONS) as workbook:
        sheets = _Sheets(workbook)
        created_at = datetime.fromisoformat(data.created_at).replace(tzinfo=None)
        workbook.set_properties({"title": document_of(data).title[:200], "created": created_at})
        _curve(sheets, data, say)
        _indices(sheets, data, say)
        _laboratory(sheets, data, say)
        _accounting(sheets, data, say)
        _about(sheets, data, say)
    return file.getvalue()


class _Sheets:
    """The sheets of a workbook, each with a head that stays in sight."""

    def __init__(self, workbook: Workbook) -> None:
        self.workbook = workbook
        self.bold = workbook.add_format({"bold": True, "text_wrap": True, "valign": "top", "bottom": 1})
        self.wrapped = workbook.add_format({"text_wrap": True, "valign": "top"})
        self.warning = workbook.add_format(
            {"bold": True, "font_color": "#B3231A", "text_wrap": True, "valign": "top"}
        )

    def add(self, name: str, head: Sequence[str], widths: Sequence[float]) -> Worksheet:
        sheet: Worksheet = self.workbook.add_worksheet(name)
        for column, (title, width) in enumerate(zip(head, widths, strict=True)):
            sheet.set_column(column, column, width)
            sheet.write_string(0, column, title, self.bold)
        sheet.freeze_panes(1, 0)
        return sheet

    def write(self, sheet: Worksheet, first_row: int, rows: Iterable[Sequence[Scalar]]) -> int:
        """Write rows from one on; return the row below."""
        row = first_row
        for row, cells in enumerate(rows, first_row):
            for column, value in enumerate(cells):
                match value:
                    case bool():
                        sheet.write_boolean(row, column, value)
                    case str():
                        sheet.write_string(row, column, plain(value))
                    case int() | float() if isfinite(value):
                        sheet.write_number(row, column, value)
        return row + 1


def _figure(figure: Estimate, decision: Decision | None, say: Words) -> tuple[Scalar, ...]:
    """Return the cells of a figure; that of a value that was not measured is empty: a chart takes a text for 0."""
    decided: tuple[Scalar, ...] = (None, None, say.known("state", figure.state))
    if decision is not None:
        verdict = say.known("verdict", decision.verdict)
        decided = (decision.limits.min_percent, decision.limits.max_percent, verdict)
    n_effective = None if figure.value is None else figure.n_effective
    return (figure.value, figure.low, figure.high, figure.standard_error, n_effective, *decided)


def _figure_head(say: Words) -> tuple[str, ...]:
    keys = ("xlsx.low", "xlsx.high", "xlsx.standard_error", "xlsx.n_effective", "xlsx.min", "xlsx.max")
    return (*map(say, keys), f"{say('curve.verdict')} / {say('xlsx.state')}")


def _curve(sheets: _Sheets, data: ReportData, say: Words) -> None:
    head = (say("curve.sieve"), say("curve.passing"), *_figure_head(say), say("curve.by_number"))
    sheet = sheets.add(say("xlsx.curve"), head, (11, 14, 12, 12, 14, 14, 12, 12, 18, 14))
    rows = [
        (
            step.sieve_mm,
            *_figure(step.passing_percent, step.decision, say),
            step.passing_by_number_percent.value,
        )
        for step in data.figures.curve
    ]
    below = sheets.write(sheet, 1, rows)
    if rows:
        _chart(sheets, sheet, (1, below - 1), say)


def _chart(sheets: _Sheets, sheet: Worksheet, rows: tuple[int, int], say: Words) -> None:
    """Draw the curve, its interval, and the limits at their sieves beside the table."""
    chart = sheets.workbook.add_chart({"type": "scatter", "subtype": "straight_with_markers"})
    curve, limit = "#1C5FA8", "#2F7D46"
    none = {"none": True}
    looks: tuple[tuple[int, str, Mapping[str, object], Mapping[str, object]], ...] = (
        (1, "curve.passing", {"color": curve, "width": 2}, _mark("circle", curve)),
        (2, "xlsx.low", {"color": curve, "width": 1, "dash_type": "dash"}, {"type": "none"}),
        (3, "xlsx.high", {"color": curve, "width": 1, "dash_type": "dash"}, {"type": "none"}),
        (6, "xlsx.min", none, _mark("long_dash", limit)),
        (7, "xlsx.max", none, _mark("long_dash", limit)),
    )
    for column, key, line, mark in looks:
        series = {
            "name": say(key),
            "categories": [sheet.name, rows[0], 0, rows[1], 0],
            "values": [sheet.name, rows[0], column, rows[1], column],
            "line": line,
            "marker": mark,
        }
        chart.add_series(series)
    size_axis = {"name": say("curve.size_axis"), "log_base": 10, "crossing": "min"}
    chart.set_x_axis(size_axis | {"major_gridlines": {"visible": True}})
    chart.set_y_axis({"name": say("curve.passing_axis"), "min": 0, "max": 100})
    chart.set_size({"width": 760, "height": 420})
    sheet.insert_chart(1, 11, chart)


def _mark(kind: str, colour: str) -> Mapping[str, object]:
    return {"type": kind, "size": 7, "fill": {"color": colour}, "border": {"color": colour}}


def _indices(sheets: _Sheets, data: ReportData, say: Words) -> None:
    figures, found = data.figures, data.figures.indices
    head = (say("indices.index"), say("indices.value"), *_figure_head(say))
    sheet = sheets.add(say("xlsx.indices"), head, (52, 14, 12, 12, 14, 14, 12, 12, 18))
    rows = [
        (title, *_figure(each, decision, say)) for _, title, each, decision in judged_indices(figures, say)
    ]
    named = [
        (f"D{say.size(each.percent)}: {say(key)}", figure)
        for each in figures.quantiles
        for key, figure in (
            ("quantiles.interpolated", each.interpolated_mm),
            ("quantiles.exact", each.exact_mm),
        )
    ]
    named += _forms("", found.flat_and_elongated, say)
    for part in found.flat_and_elongated_fractions:
        sizes = say("d4791.between", lower=say.size(part.lower_mm), upper=say.size(part.upper_mm))
        named += _forms(f", {sizes} mm", part.forms, say)
    named += _forms(f", {say('d4791.weighted')}", found.flat_and_elongated_weighted, say)
    sheets.write(sheet, 1, rows + [(name, *_figure(figure, None, say)) for name, figure in named])


def _forms(of: str, forms: Iterable[FlatAndElongated], say: Words) -> Iterator[tuple[str, Estimate]]:
    """Yield the shares of ASTM D4791, `of` all particles or some."""
    for ratio, name, counted, figure in shares_of(forms):
        yield f"ASTM D4791 1:{ratio}: {say(f'd4791.{name}')}, {say.known('counted', counted)}{of}", figure


def _laboratory(sheets: _Sheets, data: ReportData, say: Words) -> None:
    if not data.sievings:
        return
    keys = ("curve.sieve", "laboratory.raw", "laboratory.correlated", "laboratory.sieved")
    head = (say("laboratory.title"), *map(say, keys))
    sheet = sheets.add(say("xlsx.laboratory"), head, (24, 11, 16, 20, 16))
    raw = {step.sieve_mm: step.passing_percent.value for step in data.figures.curve}
    correlated = data.figures.correlated_percent
    rows = [
        (str(sieving.sieving), sieve_mm, raw.get(sieve_mm), correlated.get(sieve_mm), percent)
        for sieving in data.sievings
        for sieve_mm, percent in sieving.document.passing_percent.items()
    ]
    sheets.write(sheet, 1, rows)


def _accounting(sheets: _Sheets, data: ReportData, say: Words) -> None:
    head = (say("xlsx.name"), say("indices.value"))
    sheet = sheets.add(say("xlsx.accounting"), head, (48, 16))
    rows = [(accounted(row.name, say), row.value) for row in accounting_rows(data.figures)]
    sheets.write(sheet, 1, rows)


def _about(sheets: _Sheets, data: ReportData, say: Words) -> None:
    """Write what the lot is and what its figures rest on, as the printed report has it."""
    document = document_of(data)
    sheet = sheets.add(say("xlsx.about"), (document.title, ""), (34, 90))
    row = 1
    for banner in (*document.banners, document.verdict_title):
        sheet.write_string(row, 0, banner, sheets.warning)
        row += 1
    lines = (*document.verdict_lines, *document.letterhead.lines, document.footer)
    row = sheets.write(sheet, row, [("", line) for line in lines])
    sievings = (laboratory(each, data, say) for each in data.sievings)
    sections = (document.sections[0], *sievings, calibration(data, say), uncertainty(data, say))
    for section in sections:
        row += 1
        sheet.write_string(row, 0, section.title, sheets.bold)
        row += 1
        for block in section.blocks:
            pairs = block.pairs if isinstance(block, NamesAndValues) else ()
            for name, text in (("", block.text),) if isinstance(block, Note) else pairs:
                sheet.write_string(row, 0, name, sheets.wrapped)
                sheet.write_string(row, 1, text, sheets.wrapped)
                row += 1
