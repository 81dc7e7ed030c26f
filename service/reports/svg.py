"""The gradation curve as SVG: one text without references, for a page of either theme and for paper."""

from collections.abc import Mapping, Sequence
from html import escape

from service.base.language import Language
from service.lots.figures import CurveStep
from service.reports.curve import Beside, gradation_curve
from service.reports.drawing import LABEL_SIZE, Area, Dot, Drawing, DrawnLine, Label, Point, Shape
from service.reports.words import words

COLOURS = {  # light and dark; a page may set the variables itself, which then hold in both
    "ink": ("#1d2430", "#e8ebf0"),
    "paper": ("#ffffff", "#14181f"),
    "grid": ("#d5dae1", "#343b47"),
    "envelope": ("#cfe3d2", "#234031"),
    "limit": ("#2f7d46", "#74c88d"),
    "curve": ("#1c5fa8", "#7db8f5"),
    "laboratory": ("#8a4b08", "#f0b26a"),
    "beside": ("#7a2f86", "#dba2ea"),
    "mark": ("#0b6b75", "#63d3dd"),
    "hatch": ("#a9b1bd", "#5a6473"),
    "good": ("#1e7a3c", "#5fd085"),
    "bad": ("#c0271d", "#ff7b6e"),
    "open": ("#b26a00", "#ffc24d"),
    "weak": ("#6b7480", "#a3adba"),
}
RULES = """\
.sf-curve{{max-width:100%;height:auto;font:{size}px system-ui,"DejaVu Sans",Arial,sans-serif}}
.sf-curve text{{fill:{ink};stroke:none}}
.sf-curve .grid,.sf-curve .frame,.sf-curve .hatch{{fill:none;stroke:{grid};stroke-width:.8}}
.sf-curve .frame{{stroke:{ink}}}
.sf-curve .hatch{{stroke:{hatch}}}
.sf-curve .paper{{fill:{paper}}}
.sf-curve .envelope{{fill:{envelope};opacity:.75}}
.sf-curve .limit{{fill:none;stroke:{limit};stroke-width:1.6}}
.sf-curve .band{{fill:{curve};opacity:.28}}
.sf-curve polyline.curve{{fill:none;stroke:{curve};stroke-width:2;stroke-linejoin:round}}
.sf-curve polyline.laboratory{{fill:none;stroke:{laboratory};stroke-width:1.6;stroke-dasharray:6 4}}
.sf-curve polygon.laboratory{{fill:{laboratory}}}
.sf-curve polyline.beside{{fill:none;stroke:{beside};stroke-width:1.8;stroke-dasharray:9 3 2 3}}
.sf-curve polygon.beside{{fill:{paper};stroke:{beside};stroke-width:1.6}}
.sf-curve .beside-band{{fill:{beside};opacity:.2}}
.sf-curve polyline.mark{{fill:none;stroke:{mark};stroke-width:1.2;stroke-dasharray:4 3}}
.sf-curve polygon.mark{{fill:{mark}}}
.sf-curve .lot{{fill:{grid};stroke:{hatch};stroke-width:.8}}
.sf-curve .conforms,.sf-curve .does-not-conform,.sf-curve .undecided{{stroke:{paper};stroke-width:1}}
.sf-curve .conforms{{fill:{good}}}
.sf-curve .does-not-conform{{fill:{bad}}}
.sf-curve .undecided{{fill:{open}}}
.sf-curve .insufficient{{fill:{paper};stroke:{weak};stroke-width:1.6}}
.sf-curve .no-limits{{fill:{curve};stroke:{paper};stroke-width:1}}
"""
LIGHT, DARK = 0, 1


def curve_svg(
    steps: Sequence[CurveStep],
    *,
    language: Language = Language.ENGLISH,
    laboratory: Mapping[float, float] | None = None,
    beside: Beside | None = None,
) -> str:
    """Return the gradation curve, as an element of a page and as a file of its own alike.

    `laboratory` is a second curve: passing by sieve, percent; `beside` that of other stones. A page sets its own
    colours by the CSS variables `--sf-ink`, `--sf-paper` ... of `COLOURS`.
    """
    return svg(gradation_curve(steps, words(language), laboratory, beside), language)


def svg(drawing: Drawing, language: Language, *, is_printed: bool = False) -> str:
    """Return a drawing as SVG; the same drawing gives the same text. Its colours are literal ones if it is printed.

    `data-sieves` has the size in mm and the x of each sieve, as points, so that a page knows what was clicked.
    """
    shapes = "\n".join(map(_element, drawing.shapes))
    sieves = " ".join(f"{size_mm:g},{x:.2f}" for size_mm, x in drawing.sieves)
    data = f' data-sieves="{sieves}"' if sieves else ""
    rules = _rules(LIGHT, "{1}")
    if not is_printed:
        rules = f"{_rules(LIGHT)}@media screen and (prefers-color-scheme:dark){{\n{_rules(DARK)}}}\n"
    return (
        f'<svg class="sf-curve" xmlns="http://www.w3.org/2000/svg" role="img" lang="{language}"'
        f' viewBox="0 0 {drawing.width:g} {drawing.height:g}" width="{drawing.width:g}" height="{drawing.height:g}"'
        f"{data}>\n"
        f"<title>{escape(drawing.title)}</title>\n<desc>{escape(drawing.description)}</desc>\n"
        f"<style>\n{rules}</style>\n"
        f"{shapes}\n</svg>\n"
    )


def _rules(theme: int, colour: str = "var(--sf-{0},{1})") -> str:
    colours = {name: colour.format(name, pair[theme]) for name, pair in COLOURS.items()}
    return RULES.format(size=f"{LABEL_SIZE:g}", **colours)


def _element(shape: Shape) -> str:
    match shape:
        case Area(points, style):
            return f'<polygon class="{style}" points="{_points(points)}"/>'
        case DrawnLine(points, style):
            return f'<polyline class="{style}" points="{_points(points)}"/>'
        case Dot((x, y), radius, style):
            return f'<circle class="{style}" cx="{x:.2f}" cy="{y:.2f}" r="{radius:.2f}"/>'
        case Label((x, y), text, anchor, is_turned):
            turn = f' transform="rotate(-90 {x:.2f} {y:.2f})"' if is_turned else ""
            return f'<text x="{x:.2f}" y="{y:.2f}" text-anchor="{anchor}"{turn}>{escape(text)}</text>'


def _points(points: Sequence[Point]) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
