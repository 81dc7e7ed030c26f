"""A control chart as a drawing: lots in their order, limits, weighted mean, and the diary's marks where one is out."""

import sqlite3
from collections.abc import Callable, Iterator, Sequence
from datetime import datetime
from math import floor, log10

from pipeline.gradation.sieves import MeasuredRange
from service.lots.trends.control import TELLING, product_control
from service.lots.trends.control_documents import ControlPoint, FigureControl
from service.reports.drawing import (
    LABEL_SIZE,
    Anchor,
    Canvas,
    ChartField,
    Drawing,
    Entry,
    Point,
    Shape,
    Sign,
    Style,
    area,
    dot,
    label,
    label_width,
    line,
    svg,
)
from service.reports.trend import DOT_RADIUS, MARGIN, entry_name, nice_step
from service.reports.words import Words, words

FIELD = ChartField(top=26.0, bottom=220.0, beneath=58.0, legend_drop=3.2 * LABEL_SIZE)
SHOWN = 60
"""Lots that are drawn, the newest."""
TITLES = {"d50_mm": "trend.d50", "flakiness_percent": "trend.flakiness", "shape_percent": "trend.shape"}


def stored_control_svg(
    connection: sqlite3.Connection, product: str, figure: str, measured: MeasuredRange, look: Canvas
) -> str | None:
    """Return the drawing of one figure of a product, None if the product is not known or has no such figure."""
    found = product_control(connection, product, measured, SHOWN)
    charts = [] if found is None else found.charts
    return next((control_svg(each, product, look) for each in charts if each.figure == figure), None)


def control_svg(chart: FigureControl, product: str, look: Canvas) -> str:
    """Return the drawing of a control chart."""
    say = words(look.language)
    points = chart.points
    entries = list(_legend(points, say))
    axes = _Axes(points, chart.centre, FIELD.fitted(look, entries))
    title = f"{_title(chart.figure, say)}: {product}"
    out = [point.lot for point in points if _is_out(point)]
    drawing = Drawing(
        width=axes.field.width,
        height=axes.field.height,
        title=title,
        description=say("control.described", title=title, n=len(points), out=", ".join(out) or "–"),
        shapes=(
            *([] if points else [label(axes.field.middle, say("control.nothing"), Anchor.MIDDLE)]),
            *_grid(axes, points, chart.centre, title, say),
            *_limits(axes, points),
            *_values(axes, points),
            *_marks(axes, points, say),
            *axes.field.legend(entries),
        ),
    )
    return svg(drawing, look.language)


class _Axes:
    """Places of lots and values on the paper."""

    def __init__(self, points: Sequence[ControlPoint], centre: float | None, field: ChartField) -> None:
        self.field = field
        self.n = len(points)
        named = [each for point in points for each in (point.figure.value, point.lower, point.upper, centre)]
        ends = [each for each in named if each is not None] or [0.0, 1.0]
        span = (max(ends) - min(ends)) or 1.0
        self.least, self.greatest = max(min(ends) - MARGIN * span, 0.0), max(ends) + MARGIN * span
        self.step = nice_step((self.greatest - self.least) / 4)
        self.decimals = max(0, -floor(log10(self.step)))

    def x(self, place: float) -> float:
        return self.field.x((place + 0.5) / self.n)

    def y(self, value: float) -> float:
        return self.field.y((value - self.least) / (self.greatest - self.least))


def _title(figure: str, say: Words) -> str:
    if figure in TITLES:
        return say(TITLES[figure])
    sieve_mm = float(figure.removeprefix("passing_").removesuffix("_mm_percent"))
    return say("control.passing", sieve=say.size(sieve_mm))


def _is_out(point: ControlPoint) -> bool:
    return not TELLING.isdisjoint(point.rules)


def _style(point: ControlPoint) -> Style:
    if not point.is_counted:
        return Style.INSUFFICIENT
    if _is_out(point):
        return Style.DOES_NOT_CONFORM
    return Style.UNDECIDED if point.rules else Style.NO_LIMITS


def _grid(
    axes: _Axes, points: Sequence[ControlPoint], centre: float | None, title: str, say: Words
) -> Iterator[Shape]:
    field = axes.field
    for number in range(floor(axes.least / axes.step) + 1, floor(axes.greatest / axes.step) + 1):
        yield from field.row(axes.y(number * axes.step), say.number(number * axes.step, axes.decimals))
    right = field.left
    for place, point in enumerate(points):
        left = axes.x(place) - label_width(point.lot) / 2
        if left >= right and left + label_width(point.lot) <= field.right + 12:
            yield label((axes.x(place), field.bottom + LABEL_SIZE + 4), point.lot, Anchor.MIDDLE)
            right = left + label_width(point.lot) + 10
    if centre is not None:
        yield line(((field.left, axes.y(centre)), (field.right, axes.y(centre))), Style.FRAME)
    yield field.frame()
    yield from field.title(title)


def _line(
    axes: _Axes, points: Sequence[ControlPoint], value: Callable[[ControlPoint], float | None]
) -> list[Point]:
    """Return the points of the lots that count and have the value."""
    found = [(axes.x(place), value(point)) for place, point in enumerate(points) if point.is_counted]
    return [(x, axes.y(each)) for x, each in found if each is not None]


def _limits(axes: _Axes, points: Sequence[ControlPoint]) -> Iterator[Shape]:
    lower, upper = (
        _line(axes, points, value) for value in (lambda each: each.lower, lambda each: each.upper)
    )
    if lower:
        yield area((*upper, *reversed(lower)), Style.ENVELOPE)
        yield line(lower, Style.LIMIT)
        yield line(upper, Style.LIMIT)
        yield line(_line(axes, points, lambda each: each.ewma), Style.BESIDE)


def _values(axes: _Axes, points: Sequence[ControlPoint]) -> Iterator[Shape]:
    yield line(_line(axes, points, lambda each: each.figure.value), Style.CURVE)
    for place, point in enumerate(points):
        if point.figure.value is not None:
            radius = DOT_RADIUS + (1.4 if point.rules else 0)
            yield dot((axes.x(place), axes.y(point.figure.value)), radius, _style(point))


def _marks(axes: _Axes, points: Sequence[ControlPoint], say: Words) -> Iterator[Shape]:
    """Yield a line for each entry of the diary that may be a cause, before the first lot that was closed after it."""
    known = {each.entry: each for point in points if point.causes is not None for each in point.causes.diary}
    field = axes.field
    right = field.left
    for entry in sorted(known.values(), key=lambda each: each.at):
        place = sum(_time(point.closed_at) < _time(entry.at) for point in points)
        x = axes.x(place - 0.5)
        yield line(((x, field.top - 6), (x, field.bottom)), Style.MARK)
        if (text := entry_name(entry, say)) and x >= right:
            left = min(x, field.right - label_width(text))
            yield label((left, field.top - 10), text)
            right = left + label_width(text) + 8


def _time(at: str) -> datetime:
    return datetime.fromisoformat(at)


def _legend(points: Sequence[ControlPoint], say: Words) -> Iterator[Entry]:
    def point_sign(style: Style) -> Sign:
        return lambda x, y: [dot((x + 12, y), DOT_RADIUS + 1, style)]

    def line_sign(style: Style) -> Sign:
        return lambda x, y: [line(((x, y), (x + 24, y)), style)]

    yield point_sign(Style.NO_LIMITS), say("control.lot")
    if any(point.upper is not None for point in points):
        yield line_sign(Style.LIMIT), say("control.limits")
        yield line_sign(Style.BESIDE), say("control.ewma")
    else:
        yield lambda x, y: [], say("control.no_limits")
    styles = {_style(point) for point in points}
    for style, key in (
        (Style.DOES_NOT_CONFORM, "control.out"),
        (Style.UNDECIDED, "control.pattern"),
        (Style.INSUFFICIENT, "trend.few"),
    ):
        if style in styles:
            yield point_sign(style), say(key)
