"""A drawing of shapes on a page of a PDF."""

from collections.abc import Callable
from dataclasses import dataclass

from fpdf import FPDF

from service.reports.drawing import LABEL_SIZE, Anchor, Area, Dot, Drawing, Label, Line, Point, Style
from service.reports.svg import COLOURS, LIGHT

POINTS_A_MM = 72 / 25.4


@dataclass(frozen=True, slots=True, kw_only=True)
class Ink:
    """Colours of a shape by their names in `COLOURS`; widths in units of the drawing."""

    fill: str | None = None
    stroke: str | None = None
    width: float = 0.8
    opacity: float = 1.0
    is_dashed: bool = False


INKS = {  # the rules of the SVG, for paper
    Style.GRID: Ink(stroke="grid"),
    Style.FRAME: Ink(stroke="ink"),
    Style.PAPER: Ink(fill="paper"),
    Style.ENVELOPE: Ink(fill="envelope", opacity=0.75),
    Style.LIMIT: Ink(stroke="limit", width=1.6),
    Style.BAND: Ink(fill="curve", opacity=0.28),
    Style.CURVE: Ink(stroke="curve", width=2),
    Style.LABORATORY: Ink(fill="laboratory", stroke="laboratory", width=1.6, is_dashed=True),
    Style.BESIDE: Ink(fill="paper", stroke="beside", width=1.6),
    Style.BESIDE_BAND: Ink(fill="beside", opacity=0.2),
    Style.MARK: Ink(fill="mark", stroke="mark", width=1.2, is_dashed=True),
    Style.LOT: Ink(fill="grid", stroke="hatch"),
    Style.HATCH: Ink(stroke="hatch"),
    Style.CONFORMS: Ink(fill="good", stroke="paper", width=1),
    Style.DOES_NOT_CONFORM: Ink(fill="bad", stroke="paper", width=1),
    Style.UNDECIDED: Ink(fill="open", stroke="paper", width=1),
    Style.INSUFFICIENT: Ink(fill="paper", stroke="weak", width=1.6),
    Style.NO_LIMITS: Ink(fill="curve", stroke="paper", width=1),
}


def draw(pdf: FPDF, drawing: Drawing, family: str, drawable: Callable[[str], str]) -> None:
    """Draw over the whole width of the text, and go below."""
    left, top, scale = pdf.l_margin, pdf.y, pdf.epw / drawing.width

    def at(point: Point) -> Point:
        return left + point[0] * scale, top + point[1] * scale

    for shape in drawing.shapes:
        match shape:
            case Area(points, style):
                ink = INKS[style]
                with pdf.local_context(fill_opacity=ink.opacity):
                    pdf.polygon([at(point) for point in points], style=_take(pdf, ink, scale, is_line=False))
            case Line(points, style):
                ink = INKS[style]
                _take(pdf, ink, scale, is_line=True)
                if ink.is_dashed:
                    pdf.set_dash_pattern(6 * scale, 4 * scale)
                pdf.polyline([at(point) for point in points], style="D")
                pdf.set_dash_pattern()
            case Dot(center, radius, style):
                x, y = at(center)
                how = _take(pdf, INKS[style], scale, is_line=False)
                pdf.circle(x, y, radius * scale, style=how)
            case Label():
                _write(pdf, shape, at(shape.at), scale, family, drawable)
    pdf.set_y(top + drawing.height * scale)


def _take(pdf: FPDF, ink: Ink, scale: float, *, is_line: bool) -> str:
    """Set the colours of an ink; return how a closed shape is drawn with it."""
    if ink.stroke is not None:
        pdf.set_draw_color(*_rgb(ink.stroke))
        pdf.set_line_width(ink.width * scale)
    if ink.fill is not None and not is_line:
        pdf.set_fill_color(*_rgb(ink.fill))
    return ("D" if ink.stroke else "") + ("F" if ink.fill else "")


def _rgb(name: str) -> tuple[int, int, int]:
    red, green, blue = bytes.fromhex(COLOURS[name][LIGHT].removeprefix("#"))
    return red, green, blue


def _write(
    pdf: FPDF, label: Label, at: Point, scale: float, family: str, drawable: Callable[[str], str]
) -> None:
    pdf.set_font(family, "", LABEL_SIZE * scale * POINTS_A_MM)
    pdf.set_text_color(*_rgb("ink"))
    text = drawable(label.text)
    back = {Anchor.START: 0.0, Anchor.MIDDLE: 0.5, Anchor.END: 1.0}[label.anchor] * pdf.get_string_width(text)
    x, y = at
    if label.is_turned:
        with pdf.rotation(90, x, y):
            pdf.text(x - back, y, text)
    else:
        pdf.text(x - back, y, text)
