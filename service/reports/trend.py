"""A figure over the last hours as a drawing: its line and interval, the diary's marks, the lots beneath."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, tzinfo
from enum import StrEnum
from itertools import groupby
from math import floor, log10

from pipeline.gradation.estimates import Estimate, State
from service.base.language import Language
from service.lots.trends.diary import DiaryEntry
from service.lots.trends.trend import Trend, TrendBucket
from service.reports.drawing import (
    LABEL_SIZE,
    Anchor,
    Area,
    Dot,
    Drawing,
    DrawnLine,
    Label,
    Point,
    Shape,
    Style,
    label_width,
)
from service.reports.svg import svg
from service.reports.words import Words, words

WIDTH, HEIGHT = 720.0, 268.0
LEFT, RIGHT, TOP, BOTTOM = 58.0, 706.0, 26.0, 190.0
LOTS_TOP, LOTS_BOTTOM = BOTTOM + 24, BOTTOM + 40
MAX_TICKS = 8
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Value:
    """The value of a bucket at its middle; None where nothing was measured."""

    at: datetime
    value: float | None
    low: float | None = None
    high: float | None = None
    is_few: bool = False


def trend_svg(trend: Trend, figure: TrendFigure, language: Language, zone: tzinfo | None = None) -> str:
    """Return the drawing of one figure; clock times are of `zone`, by default the host's."""
    return svg(trend_drawing(trend, figure, words(language), zone), language)


def trend_drawing(trend: Trend, figure: TrendFigure, say: Words, zone: tzinfo | None = None) -> Drawing:
    """Return one figure over time as plain shapes."""
    values = [_value(bucket, figure, trend.bucket_s) for bucket in trend.buckets]
    axes = _Axes(trend, values, starts_at_zero=figure is TrendFigure.RATE)
    title = say(f"trend.{figure}")
    return Drawing(
        width=WIDTH,
        height=HEIGHT,
        title=title,
        description=_description(title, trend, values, say, zone, axes.decimals),
        shapes=(
            *_grid(axes, title, say, zone),
            *_lots(trend, axes),
            *_line(values, axes, say),
            *_marks(trend, axes, say),
            *_legend(trend, values, say),
        ),
    )


class _Axes:
    """Places of times and values on the paper."""

    def __init__(self, trend: Trend, values: Sequence[_Value], *, starts_at_zero: bool) -> None:
        self.since, self.until = (datetime.fromisoformat(each) for each in (trend.since, trend.until))
        judged = [each for each in values if not each.is_few] or values
        ends = [
            end
            for each in values
            for end in ((each.value, each.low, each.high) if each in judged else (each.value,))
            if end is not None
        ]
        low, high = (min(ends), max(ends)) if ends else (0.0, 1.0)
        if starts_at_zero:
            low = 0.0
        span = max(high - low, LEAST_SPAN * abs(high)) or 1.0
        low, high = min(low, (low + high - span) / 2), max(high, (low + high + span) / 2)
        self.least = max(low - MARGIN * span, 0.0)
        self.greatest = high + MARGIN * span
        self.step = _nice_step((self.greatest - self.least) / 4)
        self.decimals = max(0, -floor(log10(self.step)))

    def x(self, at: datetime) -> float:
        share = (at - self.since) / ((self.until - self.since) or timedelta(seconds=1))
        return LEFT + min(max(share, 0.0), 1.0) * (RIGHT - LEFT)

    def y(self, value: float) -> float:
        share = (value - self.least) / (self.greatest - self.least)
        return BOTTOM - min(max(share, 0.0), 1.0) * (BOTTOM - TOP)

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
        step = next((each for each in STEPS if span / each <= MAX_TICKS), STEPS[-1])
        local = self.since.astimezone(zone)
        at = local.replace(hour=0, minute=0, second=0, microsecond=0)
        while at <= self.until:
            if at >= self.since:
                yield at
            at += step


def _nice_step(least: float) -> float:
    """Return the next of 1, 2, 5, 10 ... that is not less."""
    power = 10.0 ** floor(log10(least))
    return next(factor * power for factor in (1, 2, 5, 10) if factor * power >= least * 0.999)


def _value(bucket: TrendBucket, figure: TrendFigure, bucket_s: float) -> _Value:
    since, until = datetime.fromisoformat(bucket.since), datetime.fromisoformat(bucket.until)
    middle = since + (until - since) / 2
    if figure is TrendFigure.RATE:
        is_short = (until - since).total_seconds() < LEAST_PART * bucket_s
        return _Value(at=middle, value=None if is_short else bucket.stones_per_min)
    found = _figure(bucket, figure)
    return _Value(
        at=middle,
        value=found.value,
        low=found.low,
        high=found.high,
        is_few=found.state is State.INSUFFICIENT,
    )


def _figure(bucket: TrendBucket, figure: TrendFigure) -> Estimate:
    if figure is TrendFigure.D50:
        return bucket.d50_mm
    return bucket.flakiness_percent if figure is TrendFigure.FLAKINESS else bucket.shape_percent


def _grid(axes: _Axes, title: str, say: Words, zone: tzinfo | None) -> Iterator[Shape]:
    for level in axes.levels():
        y = axes.y(level)
        yield DrawnLine(((LEFT, y), (RIGHT, y)), Style.GRID)
        yield Label((LEFT - 7, y + LABEL_SIZE / 3), say.number(level, axes.decimals), Anchor.END)
    for at in axes.ticks(zone):
        x = axes.x(at)
        yield DrawnLine(((x, TOP), (x, BOTTOM)), Style.GRID)
        text = at.strftime(say("trend.day" if (at.hour, at.minute) == (0, 0) else "trend.clock"))
        middle = min(x, WIDTH - 2 - label_width(text) / 2)
        yield Label((middle, BOTTOM + LABEL_SIZE + 4), text, Anchor.MIDDLE)
    yield DrawnLine(((LEFT, TOP), (RIGHT, TOP), (RIGHT, BOTTOM), (LEFT, BOTTOM), (LEFT, TOP)), Style.FRAME)
    yield Label((LABEL_SIZE + 2, (TOP + BOTTOM) / 2), title, Anchor.MIDDLE, is_turned=True)


def _line(values: Sequence[_Value], axes: _Axes, say: Words) -> Iterator[Shape]:
    if all(each.value is None for each in values):
        yield Label(((LEFT + RIGHT) / 2, (TOP + BOTTOM) / 2), say("trend.nothing"), Anchor.MIDDLE)
    for has_value, group in groupby(values, lambda each: each.value is not None):
        if not has_value:
            continue
        members = list(group)
        for is_judged, judged in groupby(members, lambda each: not each.is_few and each.low is not None):
            if is_judged:
                yield from _band(list(judged), axes)
        yield DrawnLine([axes.point(each.at, each.value or 0.0) for each in members], Style.CURVE)
        for each in members:
            style = Style.INSUFFICIENT if each.is_few else Style.NO_LIMITS
            yield Dot(axes.point(each.at, each.value or 0.0), 2.6, style)


def _band(judged: Sequence[_Value], axes: _Axes) -> Iterator[Shape]:
    low = [axes.point(each.at, each.low or 0.0) for each in judged]
    high = [axes.point(each.at, each.high or 0.0) for each in judged]
    if len(judged) > 1:
        yield Area((*high, *reversed(low)), Style.BAND)
    else:
        yield DrawnLine((*low, *high), Style.CURVE)


def _marks(trend: Trend, axes: _Axes, say: Words) -> Iterator[Shape]:
    """Yield a line for each entry of the diary, with its word where there is room."""
    right = LEFT - 4.0
    for entry in trend.diary:
        x = axes.x(datetime.fromisoformat(entry.at))
        yield DrawnLine(((x, TOP - 6), (x, BOTTOM)), Style.MARK)
        yield _mark(x, TOP - 6)
        text = entry_name(entry, say)
        width = label_width(text)
        place = min(max(x - width / 2, right + 4), RIGHT - width)
        if place >= right + 4 and abs(place + width / 2 - x) <= width / 2 + 8:
            yield Label((place, TOP - 14), text)
            right = place + width


def _mark(x: float, y: float) -> Area:
    return Area(((x - 4, y - 6), (x + 4, y - 6), (x, y + 1)), Style.MARK)


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
        corners = ((left, LOTS_TOP), (right, LOTS_TOP), (right, LOTS_BOTTOM), (left, LOTS_BOTTOM))
        yield Area(corners, Style.LOT)
        if label_width(lot.lot) + 6 < right - left:
            yield Label(((left + right) / 2, LOTS_BOTTOM - 4), lot.lot, Anchor.MIDDLE)


def _legend(trend: Trend, values: Sequence[_Value], say: Words) -> Iterator[Shape]:
    x, y = LEFT, LOTS_BOTTOM + 1.6 * LABEL_SIZE

    def entry(*signs: Shape, text: str) -> Iterator[Shape]:
        nonlocal x
        yield from signs
        yield Label((x + 30, y + LABEL_SIZE / 3), text)
        x += 30 + label_width(text) + 14

    corners = ((x, y - 5), (x + 24, y - 5), (x + 24, y + 5), (x, y + 5))
    line = DrawnLine(((x, y), (x + 24, y)), Style.CURVE)
    dot = Dot((x + 12, y), 2.6, Style.NO_LIMITS)
    if any(each.low is not None for each in values):
        yield from entry(
            Area(corners, Style.BAND), line, dot, text=f"{say('trend.value')} {say('trend.band')}"
        )
    elif any(each.value is not None for each in values):
        yield from entry(line, dot, text=say("trend.value"))
    if any(each.is_few for each in values):
        yield from entry(Dot((x + 12, y), 2.6, Style.INSUFFICIENT), text=say("trend.few"))
    if trend.diary:
        yield from entry(_mark(x + 12, y + 2), text=say("trend.diary"))
    if trend.lots:
        box = ((x, y - 5), (x + 24, y - 5), (x + 24, y + 5), (x, y + 5))
        yield from entry(Area(box, Style.LOT), text=say("trend.lots"))


def _description(
    title: str, trend: Trend, values: Sequence[_Value], say: Words, zone: tzinfo | None, decimals: int
) -> str:
    """Return the trend in words, for those who do not see it."""

    def clock(at: str) -> str:
        return datetime.fromisoformat(at).astimezone(zone).strftime(say("trend.moment"))

    found = [each.value for each in values if each.value is not None]
    first, last, least, greatest = (
        [say.number(each, decimals + 1) for each in (found[0], found[-1], min(found), max(found))]
        if found
        else [say("trend.nothing")] * 4
    )
    whole = say(
        "trend.described",
        title=title,
        since=clock(trend.since),
        until=clock(trend.until),
        first=first,
        last=last,
        least=least,
        greatest=greatest,
    )
    return whole + "".join(
        say("trend.described_entry", at=clock(entry.at), entry=entry_name(entry, say))
        for entry in trend.diary
    )
