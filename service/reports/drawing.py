"""A drawing as plain shapes: y goes down, lengths are points."""

from collections.abc import Sequence
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
