"""The drawing of a trend: what is joined by a line, and what a product adds to it."""

from xml.etree import ElementTree

from pipeline.gradation.estimates import NOT_MEASURED, Estimate, State
from service.lots.trends.control import LotLimits
from service.lots.trends.trend import Trend, TrendBucket
from service.reports.drawing import Canvas
from service.reports.trend import NO_PRODUCT, ProductTrend, TrendFigure, trend_svg

SVG = "{http://www.w3.org/2000/svg}"
JUDGED = [State.MEASURED] * 3


def bucket(minute: int, state: State, value: float = 14.0) -> TrendBucket:
    d50 = Estimate(state=state, value=value, low=value - 1, high=value + 1)
    return TrendBucket(
        since=f"2026-03-01T10:{minute:02}:00.000Z",
        until=f"2026-03-01T10:{minute + 1:02}:00.000Z",
        n_stones=9,
        measured=9,
        stones_per_min=9.0,
        d50_mm=d50,
        flakiness_percent=NOT_MEASURED,
        shape_percent=NOT_MEASURED,
        passing_percent={16.0: d50},
    )


def drawn(
    states: list[State], figure: TrendFigure = TrendFigure.D50, product: ProductTrend = NO_PRODUCT
) -> ElementTree.Element:
    buckets = [bucket(minute, state) for minute, state in enumerate(states)]
    trend = Trend(
        since=buckets[0].since, until=buckets[-1].until, bucket_s=60, buckets=buckets, diary=[], lots=[]
    )
    return ElementTree.fromstring(trend_svg(trend, figure, Canvas(), product=product))  # noqa: S314 - ours


def n_of(root: ElementTree.Element, style: str) -> list[int]:
    """Numbers of points of the lines of a style within the field; signs of the legend have two as well."""
    lines = [each for each in root.iter(f"{SVG}polyline") if each.get("class") == style]
    return sorted(len((each.get("points") or "").split()) for each in lines)


def test_a_figure_of_few_stones_is_drawn_and_not_joined() -> None:
    joined, youngest = drawn(JUDGED), drawn([*JUDGED, State.INSUFFICIENT])
    assert n_of(joined, "curve")[-1] == n_of(youngest, "curve")[-1] == len(JUDGED)
    assert "too few stones" in ElementTree.tostring(youngest, "unicode")


def test_limits_and_alarms_of_the_product_are_drawn_and_named() -> None:
    limits = LotLimits(lower=12.0, centre=14.0, upper=16.0)
    product = ProductTrend(limits=limits, alarms=["2026-03-01T10:02:00.000Z"])
    plain, full = drawn(JUDGED), drawn(JUDGED, product=product)
    assert n_of(plain, "limit") == [] and len(n_of(full, "limit")) == 3  # two, and the sign of the legend
    texts = {each.text for each in full.iter(f"{SVG}text")}
    assert {"control limits of lots", "alarm of the product"} <= texts


def test_passing_is_of_the_sieve_that_is_named() -> None:
    root = drawn(JUDGED, TrendFigure.PASSING_UPPER, ProductTrend(sieve_mm=16.0))
    assert root.findtext(f"{SVG}title") == "Passing 16 mm, % by mass"
    assert drawn(JUDGED, TrendFigure.PASSING_LOWER).findtext(f"{SVG}title") == "Passing at d, % by mass"
