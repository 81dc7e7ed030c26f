"""A report in one of its formats: a pure function of finished data, for a process of its own."""

from collections.abc import Callable, Mapping

from service.reports.csv_file import render_csv
from service.reports.printed import render_html, render_pdf
from service.reports.report import ReportData, ReportFormat
from service.reports.workbook import render_xlsx

RENDERERS: Mapping[ReportFormat, Callable[[ReportData], bytes]] = {
    ReportFormat.HTML: render_html,
    ReportFormat.PDF: render_pdf,
    ReportFormat.CSV: render_csv,
    ReportFormat.XLSX: render_xlsx,
}


def render(data: ReportData, report_format: ReportFormat) -> bytes:
    """Return the file of a report; the same data gives the same bytes."""
    return RENDERERS[report_format](data)
