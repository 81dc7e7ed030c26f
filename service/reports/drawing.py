"""A drawing as plain shapes: y goes down, lengths are points."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

Point = tuple[float, float]


class Style(StrEnum):
    """Style of a shape; the class of the SVG element."""

    GRID = "grid"
    FRAME = "frame"
    PAPER = "paper"
    ENVELOPE = "envelope"
    LIMIT = "limit"
    BAND = "band"
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


@dataclass(frozen=True, slots=True)
class Area:
    """A filled polygon."""

    points: Sequence[Point]
    style: Style


@dataclass(frozen=True, slots=True)
class DrawnLine:
    """A line through points."""

    points: Sequence[Point]
    style: Style


@dataclass(frozen=True, slots=True)
class Dot:
    """A filled circle."""

    center: Point
    radius: float
    style: Style


@dataclass(frozen=True, slots=True)
class Label:
    """A text on one line; a turned one is read from below."""

    at: Point
    text: str
    anchor: Anchor = Anchor.START
    is_turned: bool = False


Shape = Area | DrawnLine | Dot | Label
Sign = Callable[[float, float], Iterable[Shape]]
"""The sign of an entry of a legend, drawn at a place."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """Shapes, the later above the earlier, and what they show in words."""

    width: float
    height: float
    title: str
    description: str
    shapes: Sequence[Shape]
    sieves: Sequence[Point] = ()  # size in mm, and x, of each sieve: a page lets people choose one


LABEL_SIZE = 11.0
"""Size of the font of all labels."""


def label_width(text: str) -> float:
    """Return about how wide a label is: enough to leave room for it, the same on every machine."""
    return 0.58 * LABEL_SIZE * len(text)


def box(x0: float, y0: float, x1: float, y1: float, style: Style) -> Area:
    """Return a filled rectangle."""
    return Area(((x0, y0), (x1, y0), (x1, y1), (x0, y1)), style)


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """The field of a chart, within its axes."""

    left: float = 58.0
    right: float = 706.0
    top: float
    bottom: float

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
        yield DrawnLine(((self.left, y), (self.right, y)), Style.GRID)
        if text is not None:
            yield Label((self.left - 7, y + LABEL_SIZE / 3), text, Anchor.END)

    def frame(self) -> Shape:
        """Return the line around the field."""
        (left, top), (right, bottom) = (self.left, self.top), (self.right, self.bottom)
        return DrawnLine(
            ((left, top), (right, top), (right, bottom), (left, bottom), (left, top)), Style.FRAME
        )

    def legend(self, entries: Iterable[tuple[Sign, str]], y: float, gap: float) -> Iterator[Shape]:
        """Yield a legend, each entry with its sign, in as many lines as it takes."""
        x = self.left
        for sign, text in entries:
            width = 30 + label_width(text) + gap
            if x + width > self.right + 12 and x > self.left:
                x, y = self.left, y + 1.55 * LABEL_SIZE
            yield from sign(x, y)
            yield Label((x + 30, y + LABEL_SIZE / 3), text)
            x += width
