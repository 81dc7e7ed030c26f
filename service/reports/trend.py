"""A figure over the last hours as a drawing: its line and interval, the diary's marks, the lots beneath."""

import sqlite3
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, tzinfo
from enum import StrEnum
from itertools import groupby
from math import floor, log10

from pipeline.gradation.estimates import NOT_MEASURED, Estimate, State
from pipeline.gradation.sieves import MeasuredRange
from service.lots.products import find_product
from service.lots.trends.changes import ChangedFigure
from service.lots.trends.control import LotLimits, lot_limits, product_alarms
from service.lots.trends.diary import DiaryEntry
from service.lots.trends.trend import PassingEnd, Trend, TrendBucket, ends_mm, trend
from service.lots.yardsticks import Request, yardstick_of
from service.reports.drawing import (
    LABEL_SIZE,
    Anchor,
    Canvas,
    ChartField,
    Drawing,
    Entry,
    Point,
    Shape,
    Style,
    area,
    box,
    dot,
    label,
    label_width,
    line,
    svg,
)
from service.reports.words import Words, words

LOTS_TOP, LOTS_BOTTOM = 24.0, 40.0
"""Ends of the bars of lots, below the field."""
FIELD = ChartField(top=26.0, bottom=190.0, beneath=78.0, legend_drop=LOTS_BOTTOM + 1.6 * LABEL_SIZE)
TICK_WIDTH = 80.0
"""Room of a label of time."""
DOT_RADIUS = 2.6
MARGIN = 0.08
"""Part of the range of values that is left free above and below."""
LEAST_SPAN = 0.02
"""What is drawn spans at least so much of the greatest value: a hundredth of it is no trend."""
LEAST_PART = 0.2
"""Part of its time that the last bucket must have seen for its rate to be drawn."""
STEPS = (
    *(timedelta(minutes=each) for each in (5, 10, 15, 30)),
    *(timedelta(hours=each) for each in (1, 2, 3, 6, 12)),
    *(timedelta(days=each) for each in (1, 2, 5, 10)),
)
"""Distances of the labels of time."""


class TrendFigure(StrEnum):
    """The figure that a trend draws."""

    RATE = "rate"
    D50 = "d50"
    FLAKINESS = "flakiness"
    SHAPE = "shape"
    PASSING_LOWER = "passing_lower"
    PASSING_UPPER = "passing_upper"

    @property
    def end(self) -> PassingEnd | None:
        """End of the product's range whose sieve it is of; None for other figures."""
        ends = {TrendFigure.PASSING_LOWER: PassingEnd.LOWER, TrendFigure.PASSING_UPPER: PassingEnd.UPPER}
        return ends.get(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class ProductTrend:
    """What a product adds to a trend: the sieve of a passing, control limits of its lots, its alarms."""

    sieve_mm: float | None = None
    limits: LotLimits | None = None
    alarms: Sequence[str] = ()


NO_PRODUCT = ProductTrend()

Values = Sequence[tuple[datetime, Estimate]]
"""The figure of each bucket, at its middle."""


def trend_svg(
    trend: Trend,
    figure: TrendFigure,
    look: Canvas,
    zone: tzinfo | None = None,
    product: ProductTrend = NO_PRODUCT,
) -> str:
    """Return the drawing of one figure; clock times are of `zone`, by default the host's."""
    say = words(look.language)
    values = [_value(bucket, figure, trend.bucket_s, product.sieve_mm) for bucket in trend.buckets]
    entries = list(_legend_entries(trend, values, product, say))
    ends = _ends(values, product.limits)
    axes = _Axes(trend, ends, FIELD.fitted(look, entries), starts_at_zero=figure is TrendFigure.RATE)
    title = _title(figure, product.sieve_mm, say)
    drawing = Drawing(
        width=axes.field.width,
        height=axes.field.height,
        title=title,
        description=_description(title, trend, values, say, zone, axes.decimals),
        shapes=(
            *_grid(axes, title, say, zone),
            *_limits(product.limits, axes),
            *_lots(trend, axes),
            *_line(values, axes, say),
            *_marks(trend, axes, say),
            *(_alarm(axes.x(datetime.fromisoformat(at)), axes.field.bottom) for at in product.alarms),
            *axes.field.legend(entries),
        ),
    )
    return svg(drawing, look.language)


def stored_trend_svg(
    connection: sqlite3.Connection,
    now: str,
    hours: float,
    measured: MeasuredRange,
    figure: TrendFigure,
    look: Canvas,
    product: str | None = None,
) -> str:
    """Return the drawing of one figure over the last hours, made on a connection to the store.

    With a product it has the control limits of its lots, and the alarms of the product. Without one, or one that has no
    such end, passing at d or D is a trend without values.
    """
    found = None if product is None else find_product(connection, product)
    sieve_mm, name = None, str(figure)
    if figure.end is None:
        name = ChangedFigure[figure.name]
    elif found is not None:
        apertures_mm = yardstick_of(found, Request(measured=measured)).apertures_mm
        sieve_mm = ends_mm(found.definition, apertures_mm).get(figure.end)
        name = f"passing_{sieve_mm or 0.0:g}_mm_percent"
    drawn = trend(connection, now, hours, measured, () if sieve_mm is None else (sieve_mm,))
    of_product = ProductTrend(
        sieve_mm=sieve_mm,
        limits=None if found is None else lot_limits(connection, found.product, name),
        alarms=product_alarms(connection, drawn.since, drawn.until),
    )
    return trend_svg(drawn, figure, look, product=of_product)


class _Axes:
    """Places of times and values on the paper."""

    def __init__(
        self, trend: Trend, ends: Sequence[float], field: ChartField, *, starts_at_zero: bool
    ) -> None:
        self.field = field
        self.since, self.until = (datetime.fromisoformat(each) for each in (trend.since, trend.until))
        low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
        if starts_at_zero:
            low = 0.0
        span = max(high - low, LEAST_SPAN * abs(high)) or 1.0
        low, high = min(low, (low + high - span) / 2), max(high, (low + high + span) / 2)
        self.least = max(low - MARGIN * span, 0.0)
        self.greatest = high + MARGIN * span
        self.step = nice_step((self.greatest - self.least) / 4)
        self.decimals = max(0, -floor(log10(self.step)))

    def x(self, at: datetime) -> float:
        share = (at - self.since) / ((self.until - self.since) or timedelta(seconds=1))
        return self.field.x(min(max(share, 0.0), 1.0))

    def y(self, value: float) -> float:
        return self.field.y((value - self.least) / (self.greatest - self.least))

    def point(self, at: datetime, value: float) -> Point:
        return self.x(at), self.y(value)

    def levels(self) -> Iterator[float]:
        """Yield the values that have a line."""
        for number in range(floor(self.least / self.step), floor(self.greatest / self.step) + 1):
            if number * self.step >= self.least:
                yield number * self.step

    def ticks(self, zone: tzinfo | None) -> Iterator[datetime]:
        """Yield the times that have a label, whole ones of the day where the clock stands."""
        span = self.until - self.since
        most = (self.field.right - self.field.left) / TICK_WIDTH
        step = next((each for each in STEPS if span / each <= most), STEPS[-1])
        local = self.since.astimezone(zone)
        at = local.replace(hour=0, minute=0, second=0, microsecond=0)
        while at <= self.until:
            if at >= self.since:
                yield at
            at += step


def _ends(values: Values, limits: LotLimits | None) -> list[float]:
    """Return the values that are to be seen."""
    is_judged = any(each.state is not State.INSUFFICIENT for _, each in values)
    ends = [
        end
        for _, each in values
        for end in (each.value, *(() if is_judged and _is_few(each) else (each.low, each.high)))
        if end is not None
    ]
    return ends if limits is None else [*ends, max(limits.lower, 0.0), limits.upper]


def nice_step(least: float) -> float:
    """Return the next of 1, 2, 5, 10 ... that is not less."""
    power = 10.0 ** floor(log10(least))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least * 0.999)


def _title(figure: TrendFigure, sieve_mm: float | None, say: Words) -> str:
    if figure.end is not None and sieve_mm is not None:
        return say("control.passing", sieve=say.size(sieve_mm))
    return say(f"trend.{figure}")


def _value(
    bucket: TrendBucket, figure: TrendFigure, bucket_s: float, sieve_mm: float | None
) -> tuple[datetime, Estimate]:
    since, until = datetime.fromisoformat(bucket.since), datetime.fromisoformat(bucket.until)
    found: Estimate | float
    if figure.end is None:
        found = getattr(bucket, ChangedFigure[figure.name])
    else:
        found = NOT_MEASURED if sieve_mm is None else bucket.passing_percent[sieve_mm]
    if not isinstance(found, Estimate):
        is_short = (until - since).total_seconds() < LEAST_PART * bucket_s
        found = NOT_MEASURED if is_short else Estimate(state=State.MEASURED, value=found)
    return since + (until - since) / 2, found


def _is_few(figure: Estimate) -> bool:
    return figure.state is State.INSUFFICIENT


def _grid(axes: _Axes, title: str, say: Words, zone: tzinfo | None) -> Iterator[Shape]:
    field = axes.field
    for level in axes.levels():
        yield from field.row(axes.y(level), say.number(level, axes.decimals))
    for at in axes.ticks(zone):
        x = axes.x(at)
        yield line(((x, field.top), (x, field.bottom)), Style.GRID)
        text = at.strftime(say("trend.day" if (at.hour, at.minute) == (0, 0) else "trend.clock"))
        middle = min(x, field.width - 2 - label_width(text) / 2)
        yield label((middle, field.bottom + LABEL_SIZE + 4), text, Anchor.MIDDLE)
    yield field.frame()
    yield from field.title(title)


def _line(values: Values, axes: _Axes, say: Words) -> Iterator[Shape]:
    if all(each.value is None for _, each in values):
        yield label(axes.field.middle, say("trend.nothing"), Anchor.MIDDLE)
    for has_value, group in groupby(values, lambda each: each[1].value is not None):
        if not has_value:
            continue
        members = list(group)
        for is_judged, judged in groupby(
            members, lambda each: not _is_few(each[1]) and each[1].low is not None
        ):
            if is_judged:
                yield _band(list(judged), axes)
        points = [axes.point(at, each.value or 0.0) for at, each in members]
        for is_joined, run in groupby(
            zip(points, members, strict=True), lambda each: not _is_few(each[1][1])
        ):
            if is_joined:  # a figure of few stones, such as the youngest one, is no trend
                yield line([point for point, _ in run], Style.CURVE)
        for point, (_, each) in zip(points, members, strict=True):
            yield dot(point, DOT_RADIUS, Style.INSUFFICIENT if _is_few(each) else Style.NO_LIMITS)


def _band(judged: Values, axes: _Axes) -> Shape:
    low = [axes.point(at, each.low or 0.0) for at, each in judged]
    high = [axes.point(at, each.high or 0.0) for at, each in judged]
    if len(judged) > 1:
        return area((*high, *reversed(low)), Style.BAND)
    return line((*low, *high), Style.CURVE)


def _limits(limits: LotLimits | None, axes: _Axes) -> Iterator[Shape]:
    if limits is not None:
        for value, style in (
            (limits.lower, Style.LIMIT),
            (limits.centre, Style.FRAME),
            (limits.upper, Style.LIMIT),
        ):
            if value >= axes.least:
                yield line(((axes.field.left, axes.y(value)), (axes.field.right, axes.y(value))), style)


def _alarm(x: float, y: float) -> Shape:
    """Return the mark of an alarm: a triangle that stands on the time, of another shape than the diary's."""
    return area(((x - 5, y), (x + 5, y), (x, y - 9)), Style.DOES_NOT_CONFORM)


def _marks(trend: Trend, axes: _Axes, say: Words) -> Iterator[Shape]:
    """Yield a line for each entry of the diary, with its word where there is room."""
    field = axes.field
    right = field.left - 4.0
    for entry in trend.diary:
        x = axes.x(datetime.fromisoformat(entry.at))
        yield line(((x, field.top - 6), (x, field.bottom)), Style.MARK)
        yield _mark(x, field.top - 6)
        text = entry_name(entry, say)
        width = label_width(text)
        place = min(max(x - width / 2, right + 4), field.right - width)
        if place >= right + 4 and abs(place + width / 2 - x) <= width / 2 + 8:
            yield label((place, field.top - 14), text)
            right = place + width


def _mark(x: float, y: float) -> Shape:
    return area(((x - 4, y - 6), (x + 4, y - 6), (x, y + 1)), Style.MARK)


def entry_name(entry: DiaryEntry, say: Words) -> str:
    """Return the label at the mark of an entry: "gap 25 mm"."""
    kind = say.known("diary_kind", entry.kind)
    if entry.value is None:
        return kind
    return say(f"diary_value.{entry.kind}", kind=kind, value=say.size(entry.value))


def _lots(trend: Trend, axes: _Axes) -> Iterator[Shape]:
    """Yield a bar beneath for each lot, with its name where there is room."""
    for lot in trend.lots:
        left = axes.x(datetime.fromisoformat(lot.opened_at))
        right = axes.x(datetime.fromisoformat(lot.closed_at or trend.until))
        top, bottom = axes.field.bottom + LOTS_TOP, axes.field.bottom + LOTS_BOTTOM
        yield box(left, top, right, bottom, Style.LOT)
        if label_width(lot.lot) + 6 < right - left:
            yield label(((left + right) / 2, bottom - 4), lot.lot, Anchor.MIDDLE)


def _legend_entries(trend: Trend, values: Values, product: ProductTrend, say: Words) -> Iterator[Entry]:
    def value(x: float, y: float) -> Iterator[Shape]:
        if has_band:
            yield box(x, y - 5, x + 24, y + 5, Style.BAND)
        yield line(((x, y), (x + 24, y)), Style.CURVE)
        yield dot((x + 12, y), DOT_RADIUS, Style.NO_LIMITS)

    has_band = any(each.low is not None for _, each in values)
    if has_band:
        yield value, f"{say('trend.value')} {say('trend.band')}"
    elif any(each.value is not None for _, each in values):
        yield value, say("trend.value")
    if any(_is_few(each) for _, each in values):
        yield lambda x, y: [dot((x + 12, y), DOT_RADIUS, Style.INSUFFICIENT)], say("trend.few")
    if product.limits is not None:
        yield lambda x, y: [line(((x, y), (x + 24, y)), Style.LIMIT)], say("trend.limits")
    if product.alarms:
        yield lambda x, y: [_alarm(x + 12, y + 4)], say("trend.alarm")
    if trend.diary:
        yield lambda x, y: [_mark(x + 12, y + 2)], say("trend.diary")
    if trend.lots:
        yield lambda x, y: [box(x, y - 5, x + 24, y + 5, Style.LOT)], say("trend.lots")


def _description(
    title: str, trend: Trend, values: Values, say: Words, zone: tzinfo | None, decimals: int
) -> str:
    """Return the trend in words, for those who do not see it."""

    def clock(at: str) -> str:
        return datetime.fromisoformat(at).astimezone(zone).strftime(say("trend.moment"))

    found = [each.value for _, each in values if each.value is not None]
    first, last, least, greatest = (
        [say.number(each, decimals + 1) for each in (found[0], found[-1], min(found), max(found))]
        if found
        else [say("trend.nothing")] * 4
    )
    since, until = clock(trend.since), clock(trend.until)
    ends = {"first": first, "last": last, "least": least, "greatest": greatest}
    whole = say("trend.described", title=title, since=since, until=until, **ends)
    return whole + "".join(
        say("trend.described_entry", at=clock(entry.at), entry=entry_name(entry, say))
        for entry in trend.diary
    )
