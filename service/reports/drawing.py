"""Drawings of charts as elements of SVG: y goes down, lengths are points."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from html import escape

from service.base.language import Language

Point = tuple[float, float]
DRAWING_WIDTH = 720.0


class Style(StrEnum):
    """Style of a shape; the class of the SVG element."""

    GRID = "grid"
    FRAME = "frame"
    PAPER = "paper"
    ENVELOPE = "envelope"
    LIMIT = "limit"
    BAND = "band"
    BAR = "bar"
    CURVE = "curve"
    LABORATORY = "laboratory"
    BESIDE = "beside"
    BESIDE_BAND = "beside-band"
    MARK = "mark"
    LOT = "lot"
    HATCH = "hatch"
    CONFORMS = "conforms"
    DOES_NOT_CONFORM = "does-not-conform"
    UNDECIDED = "undecided"
    INSUFFICIENT = "insufficient"
    NO_LIMITS = "no-limits"


class Anchor(StrEnum):
    """Which part of a text is at its point."""

    START = "start"
    MIDDLE = "middle"
    END = "end"


Shape = str
"""An element of SVG."""
Sign = Callable[[float, float], Iterable[Shape]]
"""The sign of an entry of a legend, drawn at a place."""
Entry = tuple[Sign, str]
"""An entry of a legend: its sign and its text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """Shapes, the later above the earlier, and what they show in words."""

    width: float = DRAWING_WIDTH
    height: float
    title: str
    description: str
    shapes: Sequence[Shape]
    sieves: Sequence[Point] = ()  # size in mm, and x, of each sieve: a page lets people choose one


LABEL_SIZE = 11.0
"""Size of the font of all labels."""
ROW = 1.55 * LABEL_SIZE
"""Distance of the lines of a legend."""
LEAST_FIELD = 44.0
"""Height that the field of a chart has at least, however little room there is."""
LEGEND_GAP = 12.0
NARROW = 500.0
"""Width below which a legend begins at the border rather than at the field."""
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
.sf-curve .bar{{fill:{curve};opacity:.55}}
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


def label_width(text: str) -> float:
    """Return about how wide a label is: enough to leave room for it, the same on every machine."""
    return 0.58 * LABEL_SIZE * len(text)


def area(points: Iterable[Point], style: Style) -> Shape:
    """Return a filled polygon."""
    return f'<polygon class="{style}" points="{_points(points)}"/>'


def box(x0: float, y0: float, x1: float, y1: float, style: Style) -> Shape:
    """Return a filled rectangle."""
    return area(((x0, y0), (x1, y0), (x1, y1), (x0, y1)), style)


def line(points: Iterable[Point], style: Style) -> Shape:
    """Return a line through points."""
    return f'<polyline class="{style}" points="{_points(points)}"/>'


def dot(center: Point, radius: float, style: Style) -> Shape:
    """Return a filled circle."""
    return f'<circle class="{style}" cx="{center[0]:.2f}" cy="{center[1]:.2f}" r="{radius:.2f}"/>'


def label(at: Point, text: str, anchor: Anchor = Anchor.START, *, is_turned: bool = False) -> Shape:
    """Return a text on one line; a turned one is read from below."""
    x, y = at
    turn = f' transform="rotate(-90 {x:.2f} {y:.2f})"' if is_turned else ""
    return f'<text x="{x:.2f}" y="{y:.2f}" text-anchor="{anchor}"{turn}>{escape(text)}</text>'


def _points(points: Iterable[Point]) -> str:
    return " ".join(f"{x:.2f},{y:.2f}" for x, y in points)


@dataclass(frozen=True, slots=True)
class Canvas:
    """How a drawing is asked for: its language, and its room, in which a letter is `LABEL_SIZE` high."""

    language: Language = Language.ENGLISH
    width: float = DRAWING_WIDTH
    height: float | None = None
    """Height of the room; as much as the drawing takes for none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChartField:
    """The field of a chart, within its axes."""

    left: float = 58.0
    right: float = DRAWING_WIDTH - 14.0
    top: float
    bottom: float
    beneath: float
    """Room below the field, at least."""
    legend_drop: float = 0.0
    """Distance of the first line of the legend from the field."""

    @property
    def width(self) -> float:
        """Width of the drawing."""
        return self.right + 14.0

    @property
    def height(self) -> float:
        """Height of the drawing."""
        return self.bottom + self.beneath

    def fitted(self, look: Canvas, entries: Sequence[Entry] = ()) -> "ChartField":
        """Return the field that fits the room of a look, above a legend with these entries."""
        wide = replace(self, right=look.width - 14.0)
        _, y = wide._placed(entries)[-1] if entries else (0.0, self.bottom)
        beneath = max(self.beneath, y - self.bottom + LABEL_SIZE)
        bottom = self.bottom if look.height is None else max(look.height - beneath, self.top + LEAST_FIELD)
        return replace(wide, bottom=bottom, beneath=beneath)

    @property
    def middle(self) -> Point:
        return (self.left + self.right) / 2, (self.top + self.bottom) / 2

    def x(self, share: float) -> float:
        """Return the place of a share of the width."""
        return self.left + share * (self.right - self.left)

    def y(self, share: float) -> float:
        """Return the place of a share of the height; what is beyond the field is at its border."""
        return self.bottom - min(max(share, 0.0), 1.0) * (self.bottom - self.top)

    def row(self, y: float, text: str | None) -> Iterator[Shape]:
        """Yield a line of the grid with its label."""
        yield line(((self.left, y), (self.right, y)), Style.GRID)
        if text is not None:
            yield label((self.left - 7, y + LABEL_SIZE / 3), text, Anchor.END)

    def frame(self) -> Shape:
        """Return the line around the field."""
        (left, top), (right, bottom) = (self.left, self.top), (self.right, self.bottom)
        return line(((left, top), (right, top), (right, bottom), (left, bottom), (left, top)), Style.FRAME)

    def title(self, text: str) -> Iterator[Shape]:
        """Yield the name of the upright axis, if there is room for it."""
        if label_width(text) <= self.height:
            middle = min(max(self.middle[1], label_width(text) / 2), self.height - label_width(text) / 2)
            yield label((LABEL_SIZE + 2, middle), text, Anchor.MIDDLE, is_turned=True)

    def legend(self, entries: Sequence[Entry]) -> Iterator[Shape]:
        """Yield a legend, each entry with its sign, in as many lines as it takes."""
        for (sign, text), (x, y) in zip(entries, self._placed(entries), strict=True):
            yield from sign(x, y)
            yield label((x + 30, y + LABEL_SIZE / 3), text)

    def _placed(self, entries: Sequence[Entry]) -> list[Point]:
        """Return the place of each entry of the legend."""
        left = self.left if self.width >= NARROW else LABEL_SIZE
        x, y = left, self.bottom + self.legend_drop
        places = []
        for _, text in entries:
            width = 30 + label_width(text) + LEGEND_GAP
            if x + width > self.right + 12 and x > left:
                x, y = left, y + ROW
            places.append((x, y))
            x += width
        return places


def svg(drawing: Drawing, language: Language, *, is_printed: bool = False) -> str:
    """Return a drawing as SVG; the same drawing gives the same text. Its colours are literal ones if it is printed.

    `data-sieves` has the size in mm and the x of each sieve, as points, so that a page knows what was clicked.
    """
    shapes = "\n".join(drawing.shapes)
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
