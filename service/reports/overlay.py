"""Curves of many lots in one drawing, with the band that they are seen against."""

import sqlite3
from collections.abc import Iterator, Sequence
from functools import partial

from service.lots.figures import CurveStep
from service.lots.overlay import OverlaidStep, Overlay, Reference, ReferenceKind, overlay
from service.lots.yardsticks import Request
from service.reports.curve import FIELD, Axes, grid, shown_steps
from service.reports.drawing import Canvas, Drawing, Entry, Point, Shape, Style, area, box, line, svg
from service.reports.words import Words, words

COLOURS = ("#1c7fd6", "#d9480f", "#7048e8", "#b08900", "#0c8599", "#d6336c")
"""Colours of the lots in their order, on light and dark pages alike; after the last they begin again, with dashes."""


def stored_overlay_svg(
    connection: sqlite3.Connection,
    names: Sequence[str],
    kind: ReferenceKind | None,
    request: Request,
    look: Canvas,
) -> str | None:
    """Return the drawing of the curves of lots; None if one of them does not exist."""
    found = overlay(connection, names, kind, request)
    return None if found is None else overlay_svg(found, look)


def overlay_svg(found: Overlay, look: Canvas) -> str:
    """Return the drawing of an overlay as SVG."""
    say = words(look.language)
    shown = shown_steps(
        [
            CurveStep(
                sieve_mm=steps[0].sieve_mm,
                passing_percent=next(
                    (each.passing_percent for each in steps if each.passing_percent.value is not None),
                    steps[0].passing_percent,
                ),
                passing_by_number_percent=steps[0].passing_percent,
                decision=None,
            )
            for steps in zip(*(each.curve for each in found.lots), strict=True)
        ]
    )
    entries = list(_entries(found, say))
    axes = Axes([step.sieve_mm for step in shown], FIELD.fitted(look, entries))
    shapes = [*grid(shown, axes, say)]
    if found.reference is not None:
        shapes += _band(found.reference, axes)
    for place, each in enumerate(found.lots):
        passing = {step.sieve_mm: step.passing_percent.value for step in each.curve}
        points = [axes.point(*point) for point in axes.shown(passing).items()]
        shapes.append(_curve(points, place))
    drawing = Drawing(
        width=axes.field.width,
        height=axes.field.height,
        title=say("curve.title"),
        description="; ".join(f"{each.lot}: {_described(each.curve, say)}" for each in found.lots),
        shapes=[*shapes, *axes.field.legend(entries)],
    )
    return svg(drawing, look.language)


def _band(reference: Reference, axes: Axes) -> Iterator[Shape]:
    """Yield the band, and the median within it."""
    steps = [each for each in reference.steps if axes.least_mm < each.sieve_mm < axes.greatest_mm]
    low = [axes.point(each.sieve_mm, each.low_percent) for each in steps]
    high = [axes.point(each.sieve_mm, each.high_percent) for each in steps]
    if len(steps) > 1:
        yield area((*high, *reversed(low)), Style.ENVELOPE)
    for lower, upper in zip(low, high, strict=True):
        yield line((lower, upper), Style.LIMIT)
    medians = [(each.sieve_mm, each.median_percent) for each in steps if each.median_percent is not None]
    if medians:
        yield line([axes.point(sieve_mm, percent) for sieve_mm, percent in medians], Style.LIMIT)


def _curve(points: Sequence[Point], place: int) -> Shape:
    """Return a line in the colour of a place in the order of the lots."""
    drawn = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
    dashes = ' stroke-dasharray="7 4"' if place >= len(COLOURS) else ""
    return f'<polyline fill="none" stroke="{COLOURS[place % len(COLOURS)]}" stroke-width="2"{dashes} points="{drawn}"/>'


def _entries(found: Overlay, say: Words) -> Iterator[Entry]:
    def sign(place: int, x: float, y: float) -> Iterator[Shape]:
        yield _curve(((x, y), (x + 24, y)), place)

    def band(x: float, y: float) -> Iterator[Shape]:
        yield box(x, y - 5, x + 24, y + 5, Style.ENVELOPE)

    for place, each in enumerate(found.lots):
        yield partial(sign, place), each.lot
    if found.reference is not None:
        text = say("curve.envelope")
        if found.reference.kind is ReferenceKind.HISTORY:
            text = say("curve.history", product=found.reference.name, n=found.reference.n_lots)
        yield band, text


def _described(curve: Sequence[OverlaidStep], say: Words) -> str:
    known = [each for each in curve if each.passing_percent.value is not None]
    passing = (
        f"{say.size(each.sieve_mm)} mm {say.number(each.passing_percent.value, 1)} %" for each in known
    )
    return ", ".join(passing) or say("state.not_measured")
