"""The report as one HTML file and as PDF on A4: each a template that is given the document."""

import json
from base64 import b64encode
from dataclasses import fields
from datetime import datetime
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import typst
from markupsafe import Markup
from PIL import Image

from service.base.language import Language
from service.base.templates import templates_in
from service.reports.content import document_of
from service.reports.document import Document, NamesAndValues
from service.reports.drawing import Drawing, svg
from service.reports.report import ReportData

TEMPLATES = Path(__file__).with_name("templates")
DEJAVU = Path("/usr/share/fonts/truetype/dejavu")
"""Folder of Debian's package fonts-dejavu-core."""
PICTURE = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 83 56"><image width="83" height="56" href="{}"/></svg>'
"""A PNG within the shape of a card's picture."""
CACHED = 10
"""Compilations whose results typst keeps in memory, about 9 MB for each report."""
MAX_PIXELS = 4_000_000
"""A larger picture is no preview: it would cost the memory of the reader's process."""


def render_html(data: ReportData) -> bytes:
    """Return the report as HTML."""
    return html_of(document_of(data))


def html_of(document: Document) -> bytes:
    """Return a document as one HTML file."""

    def drawn(drawing: Drawing) -> Markup:
        return Markup(svg(drawing, Language(document.language)))  # noqa: S704 - all texts in it are escaped by svg()

    template = templates_in(TEMPLATES).get_template("page.html")
    text = template.render(document=document, drawn=drawn, data_uri=data_uri, svg_uri=svg_uri)
    return text.encode("utf-8", "replace")


def data_uri(png: bytes | None) -> str | None:
    """Return a picture as an address that holds it; None if it is none."""
    found = readable_png(png)
    return None if found is None else "data:image/png;base64," + b64encode(found).decode("ascii")


def svg_uri(svg: str) -> str:
    """Return a drawing as an address that holds it."""
    return "data:image/svg+xml;base64," + b64encode(svg.encode()).decode("ascii")


def render_pdf(data: ReportData, font_folder: Path = DEJAVU) -> bytes:
    """Return the report as PDF, in DejaVu Sans if the folder has it, else in the serifs that typst brings."""
    return pdf_of(document_of(data), font_folder)


def pdf_of(document: Document, font_folder: Path = DEJAVU) -> bytes:
    """Return a document as PDF; `font_folder`: see `render_pdf`."""
    return _compiled(document, "pdf", font_folder)


def svg_of(sheet: Document, font_folder: Path = DEJAVU) -> bytes:
    """Return a document of one page as SVG, with letters as outlines; `font_folder`: see `render_pdf`."""
    return _compiled(sheet, "svg", font_folder)


def _compiled(document: Document, kind: Literal["pdf", "svg"], font_folder: Path) -> bytes:
    default = partial(_jsonable, language=Language(document.language))
    report = json.dumps(document, default=default, ensure_ascii=False)
    file = typst.compile(
        TEMPLATES / "page.typ",
        format=kind,
        sys_inputs={"report": report.encode("utf-8", "replace").decode()},
        font_paths=[font_folder],
        ignore_system_fonts=True,
        timestamp=int(datetime.fromisoformat(document.created_at).timestamp()),
    )
    empty = typst.Compiler(ignore_system_fonts=True)  # empties the cache
    for _ in range(CACHED):
        empty.compile(b"")
    return file


def _jsonable(part: Any, language: Language) -> object:
    """Return a part of a document as JSON has it, drawings and pictures as SVG; None for a damaged picture."""
    match part:
        case bytes():
            address = data_uri(sound_png(part))
            return None if address is None else PICTURE.format(address)
        case Drawing():
            return {"svg": svg(part, language, is_printed=True), "description": part.description}
        case NamesAndValues():
            return {"kind": part.kind, "by_length": part.by_length()}
    return {field.name: getattr(part, field.name) for field in fields(part)} | {
        "kind": getattr(part, "kind", None)
    }


def readable_png(png: bytes | None) -> bytes | None:
    """Return the picture if it is a sound PNG of moderate size, else None."""
    if png is None:
        return None
    try:
        with Image.open(BytesIO(png), formats=("PNG",)) as image:
            if image.width * image.height > MAX_PIXELS:
                return None
            image.load()
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError):
        return None
    return png


def sound_png(png: bytes) -> bytes | None:
    """Return a readable picture encoded anew: typst refuses a PNG that Pillow reads in spite of a damaged end."""
    if readable_png(png) is None:
        return None
    sound = BytesIO()
    with Image.open(BytesIO(png), formats=("PNG",)) as image:
        image.save(sound, "PNG", compress_level=1)
    return sound.getvalue()
