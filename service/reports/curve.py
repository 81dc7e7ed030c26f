"""The gradation curve as a drawing: passing over the logarithm of the size, with interval, limits and verdicts."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from math import isfinite, log

from pipeline.gradation.estimates import Estimate
from pipeline.gradation.specification import Verdict
from service.lots.figures import CurveStep
from service.reports.drawing import (
    LABEL_SIZE,
    Anchor,
    Canvas,
    ChartField,
    Drawing,
    Point,
    Shape,
    Sign,
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

FIELD = ChartField(top=14.0, bottom=314.0, beneath=88.0, legend_drop=5.2 * LABEL_SIZE)
MARGIN = 1.12
"""The axis ends beyond the first and the last sieve by this factor."""
LOOK = Canvas()
HATCH_DISTANCE = 7.0
MARKER_RADIUS = 4.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Beside:
    """The curve of other stones, drawn beside the first one: of another lot, or as another algorithm measured them."""

    first_name: str  # what the first curve is called now that there are two
    name: str
    passing_percent: Mapping[float, Estimate]  # by sieve, mm


def curve_svg(
    steps: Sequence[CurveStep],
    look: Canvas = LOOK,
    *,
    laboratory: Mapping[float, float] | None = None,
    beside: Beside | None = None,
) -> str:
    """Return the gradation curve as SVG, as an element of a page and as a file of its own alike."""
    return svg(gradation_curve(steps, words(look.language), laboratory, beside, look), look.language)


def gradation_curve(
    steps: Sequence[CurveStep],
    say: Words,
    laboratory: Mapping[float, float] | None = None,
    beside: Beside | None = None,
    look: Canvas = LOOK,
) -> Drawing:
    """Return the curve; `laboratory` is the passing by sieve of a second one, percent, `beside` one of other stones."""
    shown = shown_steps(steps)
    sizes = Axes([step.sieve_mm for step in shown])
    second = sizes.shown(laboratory or {})
    passing = {} if beside is None else beside.passing_percent
    others = sizes.shown({size_mm: figure.value for size_mm, figure in passing.items()})
    entries = list(_legend_entries(shown, say, beside, has_second=bool(second)))
    axes = Axes([step.sieve_mm for step in shown], FIELD.fitted(look, entries))
    figures = [(size_mm, passing[size_mm]) for size_mm in others]
    return Drawing(
        width=axes.field.width,
        height=axes.field.height,
        title=say("curve.title"),
        description=_description(shown, say) + _description_beside(figures, beside, say),
        shapes=(
            *grid(shown, axes, say),
            *_limits(shown, axes),
            *_unmeasured(shown, axes, say),
            *_band(figures, axes, Style.BESIDE_BAND),
            *_curve(shown, axes),
            *_second_curve(second, axes, Style.LABORATORY),
            *_second_curve(others, axes, Style.BESIDE),
            *(
                marker(axes.point(step.sieve_mm, _percent(step)), style_of(_verdict(step)))
                for step in shown
                if _has_value(step)
            ),
            *axes.field.legend(entries),
        ),
        sieves=[(step.sieve_mm, axes.x(step.sieve_mm)) for step in shown],
    )


def shown_steps(steps: Sequence[CurveStep]) -> list[CurveStep]:
    """Return the steps by rising sieve, without those far from all that was measured or has limits."""
    ordered = sorted(steps, key=lambda step: step.sieve_mm)
    telling = [i for i, step in enumerate(ordered) if _has_value(step) or step.decision is not None]
    if not telling:
        return ordered
    first = telling[0] - _has_value(ordered[telling[0]])
    last = telling[-1] + _has_value(ordered[telling[-1]])
    return ordered[max(first, 0) : last + 1]


class Axes:
    """Places of sizes and percents on the paper."""

    def __init__(self, sizes_mm: Sequence[float], field: ChartField = FIELD) -> None:
        self.field = field
        self.least_mm = min(sizes_mm, default=1.0) / MARGIN
        self.greatest_mm = max(sizes_mm, default=1.0) * MARGIN

    def x(self, size_mm: float) -> float:
        return self.field.x(log(size_mm / self.least_mm) / log(self.greatest_mm / self.least_mm))

    def y(self, percent: float) -> float:
        return self.field.y(percent / 100)

    def point(self, size_mm: float, percent: float) -> Point:
        return self.x(size_mm), self.y(percent)

    def shown(self, passing: Mapping[float, float | None]) -> dict[float, float]:
        """Return another curve's passing at its sieves that are on the axis, by rising sieve."""
        return {
            size_mm: percent
            for size_mm, percent in sorted(passing.items())
            if self.least_mm < size_mm < self.greatest_mm and percent is not None and isfinite(percent)
        }


def _has_value(step: CurveStep) -> bool:
    return step.passing_percent.value is not None


def _percent(step: CurveStep) -> float:
    return step.passing_percent.value or 0.0


def _verdict(step: CurveStep) -> Verdict | None:
    return None if step.decision is None else step.decision.verdict


def style_of(verdict: Verdict | None) -> Style:
    """Return the style of a verdict's mark, that of a figure without limits for none."""
    if verdict is None or verdict is Verdict.NOT_MEASURED:
        return Style.NO_LIMITS
    return Style(verdict.replace("_", "-"))


def grid(shown: Sequence[CurveStep], axes: Axes, say: Words) -> Iterator[Shape]:
    """Yield the lines of percents and sieves, and the names of both axes."""
    field = axes.field
    for percent in range(0, 101, 10):
        yield from field.row(axes.y(percent), None if percent % 20 else say.number(percent, 0))
    for x in (axes.x(step.sieve_mm) for step in shown):
        yield line(((x, field.top), (x, field.bottom)), Style.GRID)
    for x, text in _tick_labels(shown, axes, say):
        yield label((x, field.bottom + LABEL_SIZE + 5), text, Anchor.MIDDLE)
    yield field.frame()
    below = field.bottom + 2.6 * LABEL_SIZE + 5
    yield label((field.middle[0], below), say("curve.size_axis"), Anchor.MIDDLE)
    yield from field.title(say("curve.passing_axis"))


def _tick_labels(shown: Sequence[CurveStep], axes: Axes, say: Words) -> list[tuple[float, str]]:
    """Return the labels that have room: of the sieves with limits first."""
    placed: list[tuple[float, str]] = []
    for step in sorted(shown, key=lambda step: (step.decision is None, -step.sieve_mm)):
        x, text = axes.x(step.sieve_mm), say.size(step.sieve_mm)
        if all(
            abs(x - other_x) > (label_width(text) + label_width(other)) / 2 + 4 for other_x, other in placed
        ):
            placed.append((x, text))
    return sorted(placed)


def _limits(shown: Sequence[CurveStep], axes: Axes) -> Iterator[Shape]:
    """Yield the envelope, and at each sieve what the specification itself says: its two limits."""
    limits = [(step.sieve_mm, step.decision.limits) for step in shown if step.decision is not None]
    if len(limits) > 1:
        lower = [axes.point(size_mm, limit.min_percent) for size_mm, limit in limits]
        upper = [axes.point(size_mm, limit.max_percent) for size_mm, limit in limits]
        yield area((*upper, *reversed(lower)), Style.ENVELOPE)
    for size_mm, limit in limits:
        x, low_y, high_y = axes.x(size_mm), axes.y(limit.min_percent), axes.y(limit.max_percent)
        yield line(((x, low_y), (x, high_y)), Style.LIMIT)
        for y in (low_y, high_y):
            yield line(((x - 6, y), (x + 6, y)), Style.LIMIT)


def _unmeasured(shown: Sequence[CurveStep], axes: Axes, say: Words) -> Iterator[Shape]:
    """Yield a hatched field for each range of sieves without a value, up to the next one with a value."""
    for left, right in unmeasured_ranges(shown, axes.least_mm, axes.greatest_mm):
        x0, x1 = axes.x(left), axes.x(right)
        yield from _hatching(x0, x1, axes.field.top, axes.field.bottom)
        text = say("state.not_measured")
        width, x, y = label_width(text) + 8, (x0 + x1) / 2, axes.field.middle[1]
        is_turned = x1 - x0 < width + 8
        if x1 - x0 > 2 * LABEL_SIZE:
            half = (LABEL_SIZE * 0.85, width / 2) if is_turned else (width / 2, LABEL_SIZE * 0.85)
            yield box(x - half[0], y - half[1], x + half[0], y + half[1], Style.PAPER)
            shift = LABEL_SIZE / 3
            at = (x + shift, y) if is_turned else (x, y + shift)
            yield label(at, text, Anchor.MIDDLE, is_turned=is_turned)


def unmeasured_ranges(
    shown: Sequence[CurveStep], least_mm: float, greatest_mm: float
) -> Iterator[tuple[float, float]]:
    """Yield the ranges of sizes without any value, between neighbouring sieves that have one."""
    left_mm, is_open = least_mm, False
    for has_value, group in groupby(shown, _has_value):
        members = list(group)
        if has_value:
            if is_open:
                yield left_mm, members[0].sieve_mm
            left_mm = members[-1].sieve_mm
        is_open = not has_value
    if is_open:
        yield left_mm, greatest_mm


def _hatching(x0: float, x1: float, top: float, bottom: float) -> Iterator[Shape]:
    """Yield diagonals through a rectangle."""
    width, height = x1 - x0, bottom - top
    for i in range(1, int((width + height) / HATCH_DISTANCE) + 1):
        reach = i * HATCH_DISTANCE
        right = (x0 + min(reach, width), bottom - max(0.0, reach - width))
        left = (x0 + max(0.0, reach - height), bottom - min(reach, height))
        yield line((left, right), Style.HATCH)


def _curve(shown: Sequence[CurveStep], axes: Axes) -> Iterator[Shape]:
    for has_value, group in groupby(shown, _has_value):
        if not has_value:
            continue
        members = list(group)
        figures = [(step.sieve_mm, step.passing_percent) for step in members]
        yield from _band([each for each in figures if each[1].low is not None], axes, Style.BAND)
        yield line([axes.point(step.sieve_mm, _percent(step)) for step in members], Style.CURVE)


def _band(figures: Sequence[tuple[float, Estimate]], axes: Axes, style: Style) -> Iterator[Shape]:
    """Yield the band of the intervals of neighbouring figures, each with its sieve."""
    if len(figures) > 1:
        low = [axes.point(size_mm, figure.low or 0.0) for size_mm, figure in figures]
        high = [axes.point(size_mm, figure.high or 0.0) for size_mm, figure in figures]
        yield area((*high, *reversed(low)), style)


def _second_curve(second: Mapping[float, float], axes: Axes, style: Style) -> Iterator[Shape]:
    points = [axes.point(size_mm, percent) for size_mm, percent in second.items()]
    if points:
        yield line(points, style)
    for x, y in points:
        yield _square(x, y, style)


def _square(x: float, y: float, style: Style) -> Shape:
    return box(x - 3, y - 3, x + 3, y + 3, style)


def marker(at: Point, style: Style) -> Shape:
    """Return the mark of a verdict, distinct by shape as well as by colour."""
    (x, y), r = at, MARKER_RADIUS
    if style is Style.DOES_NOT_CONFORM:
        return area(((x, y - 1.4 * r), (x + 1.4 * r, y), (x, y + 1.4 * r), (x - 1.4 * r, y)), style)
    if style is Style.UNDECIDED:
        return area(((x, y - 1.4 * r), (x + 1.3 * r, y + r), (x - 1.3 * r, y + r)), style)
    return dot(at, 0.75 * r if style is Style.NO_LIMITS else r, style)


def _sign(style: Style) -> Sign:
    """Return the sign of a style in the legend."""

    def sign(x: float, y: float) -> Iterator[Shape]:
        filled, ends = partial(box, x, y - 5, x + 24, y + 5), ((x, y), (x + 24, y))
        match style:
            case Style.BAND:
                yield filled(style)
                yield line(ends, Style.CURVE)
            case Style.ENVELOPE:
                yield filled(style)
            case Style.HATCH:
                yield from _hatching(x, x + 24, y - 5, y + 5)
            case Style.LABORATORY:
                yield line(ends, style)
                yield _square(x + 12, y, style)
            case Style.BESIDE:
                yield filled(Style.BESIDE_BAND)
                yield line(ends, style)
                yield _square(x + 12, y, style)
            case _:
                yield marker((x + 12, y), style)

    return sign


def _legend_entries(
    shown: Sequence[CurveStep], say: Words, beside: Beside | None, *, has_second: bool
) -> Iterator[tuple[Sign, str]]:
    if any(map(_has_value, shown)):
        band = say("curve.band")
        yield _sign(Style.BAND), band if beside is None else f"{beside.first_name}: {band}"
    if beside is not None:
        yield _sign(Style.BESIDE), beside.name
    if any(step.decision is not None for step in shown):
        yield _sign(Style.ENVELOPE), say("curve.envelope")
    if has_second:
        yield _sign(Style.LABORATORY), say("curve.laboratory")
    if not all(map(_has_value, shown)):
        yield _sign(Style.HATCH), say("state.not_measured")
    found = {_verdict(step) for step in shown if _has_value(step)}
    for verdict in Verdict:
        if verdict in found and verdict is not Verdict.NOT_MEASURED:
            yield _sign(style_of(verdict)), say.known("verdict", verdict)
    if found & {None, Verdict.NOT_MEASURED}:
        yield _sign(Style.NO_LIMITS), say("curve.no_limits")


def _description(shown: Sequence[CurveStep], say: Words) -> str:
    """Return the curve in words, for those who do not see it."""
    return "; ".join(
        say(
            "curve.described_step",
            sieve=say.size(step.sieve_mm),
            passing=say.number(step.passing_percent.value, 1),
            interval=say.interval(step.passing_percent, 1),
            verdict=say("curve.no_limits")
            if (verdict := _verdict(step)) is None
            else say.known("verdict", verdict),
        )
        if _has_value(step)
        else say("curve.described_gap", sieve=say.size(step.sieve_mm))
        for step in shown
    )


def _description_beside(others: Sequence[tuple[float, Estimate]], beside: Beside | None, say: Words) -> str:
    if beside is None:
        return ""
    passing = ", ".join(
        f"{say.size(size_mm)} mm: {say.number(figure.value, 1)} %" for size_mm, figure in others
    )
    return say("curve.described_beside", name=beside.name, passing=passing or say("state.not_measured"))
