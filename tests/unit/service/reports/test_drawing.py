"""A drawing in the room that a page has: as wide and as high, its letters of one height, none beyond its border."""

from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st
from support.lot_figures import curve

from pipeline.gradation.estimates import NOT_MEASURED, Estimate, State
from service.base.language import Language
from service.lots.trends.control import LotLimits
from service.lots.trends.trend import Trend, TrendBucket
from service.reports.curve import curve_svg
from service.reports.drawing import DRAWING_WIDTH, LABEL_SIZE, Canvas, label_width
from service.reports.trend import ProductTrend, TrendFigure, trend_svg

SVG = "{http://www.w3.org/2000/svg}"
WIDTHS = st.integers(300, 2400)
HEIGHTS = st.integers(300, 1600)


def curve_in(look: Canvas) -> ElementTree.Element:
    return ElementTree.fromstring(curve_svg(curve(), look, laboratory={4.0: 3.0, 8.0: 12.0}))  # noqa: S314 - ours


def trend_in(look: Canvas) -> ElementTree.Element:
    figure = Estimate(state=State.MEASURED, value=14.0, low=13.0, high=15.0)
    times = [f"2026-03-01T{hour:02}:00:00.000Z" for hour in (10, 11)]
    bucket = TrendBucket(
        since=times[0],
        until=times[1],
        n_stones=9,
        measured=9,
        stones_per_min=9.0,
        d50_mm=figure,
        flakiness_percent=NOT_MEASURED,
        shape_percent=NOT_MEASURED,
        passing_percent={},
    )
    trend = Trend(since=times[0], until=times[1], bucket_s=3600, buckets=[bucket], diary=[], lots=[])
    product = ProductTrend(limits=LotLimits(lower=12.0, centre=14.0, upper=16.0), alarms=[times[1]])
    return ElementTree.fromstring(trend_svg(trend, TrendFigure.D50, look, product=product))  # noqa: S314 - ours


def assert_within(root: ElementTree.Element, look: Canvas) -> None:
    width, height = float(root.attrib["width"]), float(root.attrib["height"])
    assert width == look.width and (look.height is None or height == look.height)
    for text in root.iter(f"{SVG}text"):
        x, y, length = float(text.attrib["x"]), float(text.attrib["y"]), label_width(text.text or "")
        before = {"start": 0.0, "middle": length / 2, "end": length}[text.attrib["text-anchor"]]
        if "transform" in text.attrib:  # read from below
            assert y - length / 2 >= -1 and y + length / 2 <= height + 1, text.text
        else:
            assert x - before >= -1 and x - before + length <= width + 1, text.text
            assert LABEL_SIZE / 2 <= y <= height


@given(width=WIDTHS, height=st.none() | HEIGHTS, language=st.sampled_from(Language))
def test_all_letters_of_a_drawing_are_within_its_room(
    width: int, height: int | None, language: Language
) -> None:
    look = Canvas(language, width, height)
    assert_within(curve_in(look), look)
    assert_within(trend_in(look), look)


def test_a_drawing_that_has_too_little_height_is_higher_rather_than_without_a_field() -> None:
    assert float(curve_in(Canvas(height=120)).attrib["height"]) > 120


def test_a_narrow_drawing_has_fewer_labels_on_its_axes_and_more_lines_in_its_legend() -> None:
    wide, narrow = curve_in(Canvas()), curve_in(Canvas(width=300))
    assert float(wide.attrib["width"]) == DRAWING_WIDTH
    assert len({each.attrib["y"] for each in narrow.iter(f"{SVG}text")}) > len(
        {each.attrib["y"] for each in wide.iter(f"{SVG}text")}
    )
    assert len(list(narrow.iter(f"{SVG}text"))) <= len(list(wide.iter(f"{SVG}text")))
