"""The report as one HTML file: nothing of it is fetched, and nothing in it runs."""

from base64 import b64encode
from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template
from markupsafe import Markup

from service.base.language import Language
from service.reports.content import document_of
from service.reports.drawing import Drawing, svg
from service.reports.pictures import readable_png
from service.reports.report import ReportData

TEMPLATES = Path(__file__).with_name("templates")


def render_html(data: ReportData) -> bytes:
    """Return the report as HTML."""
    document = document_of(data)

    def drawn(drawing: Drawing) -> Markup:
        return Markup(svg(drawing, Language(document.language)))  # noqa: S704 - all texts in it are escaped by svg()

    text = _template().render(document=document, drawn=drawn, data_uri=data_uri)
    return text.encode("utf-8", "replace")


def data_uri(png: bytes | None) -> str | None:
    """Return a picture as an address that holds it; None if it is none."""
    found = readable_png(png)
    return None if found is None else "data:image/png;base64," + b64encode(found).decode("ascii")


@cache
def _template() -> Template:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html")
