"""The report as PDF on A4, set by typst from one template and the report as JSON."""

import json
from contextlib import suppress
from dataclasses import fields
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import typst

from service.base.language import Language
from service.reports.content import document_of
from service.reports.document import NamesAndValues
from service.reports.drawing import Drawing, svg
from service.reports.html import TEMPLATES, data_uri
from service.reports.pictures import sound_png
from service.reports.report import ReportData

DEJAVU = Path("/usr/share/fonts/truetype/dejavu")
"""Folder of Debian's package fonts-dejavu-core."""
PICTURE = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 83 56"><image width="83" height="56" href="{}"/></svg>'
"""A PNG within the shape of a card's picture."""
CACHED = 10
"""Compilations whose results typst keeps in memory, about 9 MB for each report."""


def render_pdf(data: ReportData, font_folder: Path = DEJAVU) -> bytes:
    """Return the report as PDF, in DejaVu Sans if the folder has it, else in the serifs that typst brings."""
    document = document_of(data)
    report = json.dumps(document, default=partial(_jsonable, language=data.language), ensure_ascii=False)
    created_at_s = None
    with suppress(ValueError):
        created_at_s = int(datetime.fromisoformat(document.created_at).timestamp())
    pdf = typst.compile(
        TEMPLATES / "page.typ",
        sys_inputs={"report": report.encode("utf-8", "replace").decode()},
        font_paths=[font_folder],
        ignore_system_fonts=True,
        timestamp=created_at_s,
    )
    empty = typst.Compiler(ignore_system_fonts=True)  # empties the cache
    for _ in range(CACHED):
        empty.compile(b"")
    return pdf


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
