"""The distribution of a measure of shape over a lot as a drawing: its classes by mass, and the median with interval."""

import sqlite3
from collections.abc import Iterator

from pipeline.gradation.distributions import Distribution, ShapeMeasure
from service.lots.distributions import lot_distributions
from service.lots.stones import Choice
from service.reports.drawing import (
    LABEL_SIZE,
    Anchor,
    Canvas,
    ChartField,
    Drawing,
    Shape,
    Style,
    box,
    label,
    label_width,
    line,
    svg,
)
from service.reports.words import Words, words

FIELD = ChartField(top=26.0, bottom=190.0, beneath=3 * LABEL_SIZE)
STEPS_PERCENT = (5, 10, 20, 50)
"""Distances of the labels of the shares."""
MOST_ROWS = 5
GAP = 0.06
"""Part of a class that is left free on either side of its bar."""


def stored_distribution_svg(
    connection: sqlite3.Connection, lot: str, choice: Choice, measure: ShapeMeasure, look: Canvas
) -> str | None:
    """Return the drawing of a measure over a lot, or over a choice of its stones; None if there is no such lot."""
    found = lot_distributions(connection, lot, choice)
    if found is None:
        return None
    return distribution_svg(next(each for each in found.items if each.measure == measure), look)


def distribution_svg(distribution: Distribution, look: Canvas) -> str:
    """Return the drawing of a distribution as SVG."""
    say = words(look.language)
    field = FIELD.fitted(look)
    title = say(f"measure.{distribution.measure}")
    shapes = list(_bars(distribution, field, say)) if distribution.classes else list(_nothing(field, say))
    heading = label((field.left, field.top - LABEL_SIZE), say("distribution.title", measure=title))
    return svg(
        Drawing(
            width=field.width,
            height=field.height,
            title=title,
            description=_description(distribution, say),
            shapes=[heading, *shapes],
        ),
        look.language,
    )


def _nothing(field: ChartField, say: Words) -> Iterator[Shape]:
    yield field.frame()
    yield label(field.middle, say("state.not_measured"), Anchor.MIDDLE)


def _bars(distribution: Distribution, field: ChartField, say: Words) -> Iterator[Shape]:
    classes = distribution.classes
    least, greatest = classes[0].lower, classes[-1].upper
    highest = max(each.mass_percent for each in classes)
    step = next((each for each in STEPS_PERCENT if highest <= MOST_ROWS * each), STEPS_PERCENT[-1])
    top = -(-highest // step) * step

    def x(value: float) -> float:
        return field.x((min(max(value, least), greatest) - least) / (greatest - least))

    for percent in range(0, int(top) + 1, step):
        yield from field.row(field.y(percent / top), f"{percent} %")
    median = distribution.quantiles[1].value
    if median.low is not None and median.high is not None:
        yield box(x(median.low), field.top, x(median.high), field.bottom, Style.BESIDE_BAND)
    for each in classes:
        free = GAP * (each.upper - each.lower)
        y = field.y(each.mass_percent / top)
        yield box(x(each.lower + free), y, x(each.upper - free), field.bottom, Style.BAR)
    if median.value is not None:
        yield line(((x(median.value), field.top), (x(median.value), field.bottom)), Style.BESIDE)
    yield field.frame()
    end = -1000.0
    for value in (least, *(each.upper for each in classes)):
        text = say.size(value)
        if x(value) - label_width(text) / 2 > end + 8:
            yield label((x(value), field.bottom + LABEL_SIZE + 5), text, Anchor.MIDDLE)
            end = x(value) + label_width(text) / 2


def _description(distribution: Distribution, say: Words) -> str:
    """Return the distribution in words, for those who do not see it."""
    return "; ".join(
        say(
            "distribution.described_class",
            lower=say.size(each.lower),
            upper=say.size(each.upper),
            share=say.number(each.mass_percent, 1),
        )
        for each in distribution.classes
        if each.number_percent
    ) or say("state.not_measured")
