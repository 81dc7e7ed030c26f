"""The gradation curve: one drawing for page, paper and screen."""

from collections.abc import Mapping
from itertools import pairwise
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.extents import examples
from support.lot_figures import NOT_MEASURED, curve, decision, measured, step

from pipeline.gradation.specification import Verdict
from service.base.language import Language
from service.lots.figures import CurveStep
from service.reports.curve import FIELD, curve_svg, gradation_curve, shown_steps, unmeasured_ranges
from service.reports.drawing import Style, svg
from service.reports.words import words

SVG = "{http://www.w3.org/2000/svg}"
ENGLISH = words(Language.ENGLISH)


def parsed(text: str | bytes) -> ElementTree.Element:
    return ElementTree.fromstring(text)  # noqa: S314 - of our own making


def lines_of(
    steps: list[CurveStep], style: Style = Style.CURVE, laboratory: Mapping[float, float] | None = None
) -> list[list[tuple[float, float]]]:
    """Return the points of each line of a style, those of the legend last."""
    root = parsed(curve_svg(steps, laboratory=laboratory))
    found = [
        element.attrib["points"] for element in root.iter(f"{SVG}polyline") if element.get("class") == style
    ]
    pairs = [[each.split(",") for each in points.split()] for points in found]
    return [[(float(x), float(y)) for x, y in each] for each in pairs]


def points_of(steps: list[CurveStep]) -> list[tuple[float, float]]:
    """Return the points of the curve."""
    return [
        point for line in lines_of(steps) for point in line if point[1] <= FIELD.bottom
    ]  # below is the legend


def test_it_is_well_formed_says_what_it_shows_and_is_the_same_every_time() -> None:
    text = curve_svg(curve(), laboratory={4.0: 3.0, 8.0: 12.0})
    root = parsed(text)
    assert root.findtext(f"{SVG}title") == "Gradation"
    described = root.findtext(f"{SVG}desc") or ""
    assert "16 mm: 94.2 % (92.2 – 96.2 %), conforms" in described
    assert "2 mm: not measured" in described
    labels = [element.text for element in root.iter(f"{SVG}text")]
    assert {"4", "31.5", "not measured", "specification", "laboratory", "Passing, % by mass"} <= set(labels)
    assert text == curve_svg(curve(), laboratory={8.0: 12.0, 4.0: 3.0})


def test_it_refers_to_nothing_and_has_colours_for_both_themes() -> None:
    text = curve_svg(curve())
    assert text.count("http") == 1  # the name of the format itself
    assert "url(" not in text
    assert "href" not in text
    assert "@media screen and (prefers-color-scheme:dark)" in text
    assert "var(--sf-curve,#" in text


def test_a_printed_one_has_literal_colours() -> None:
    text = svg(gradation_curve(curve(), ENGLISH), Language.ENGLISH, is_printed=True)
    assert ".band{fill:#1c5fa8;" in text
    assert "var(" not in text
    assert "@media" not in text


def test_sizes_are_on_a_logarithmic_axis_and_percents_on_a_linear_one() -> None:
    (x4, y0), (x8, y50), (x16, y100) = points_of(
        [step(4, measured(0)), step(8, measured(50)), step(16, measured(100))]
    )
    assert x8 - x4 == pytest.approx(x16 - x8, abs=0.02)
    assert (y0, y50, y100) == pytest.approx((FIELD.bottom, FIELD.middle[1], FIELD.top))


def test_a_page_knows_where_on_the_drawing_each_sieve_is() -> None:
    steps = [step(4, measured(10)), step(31.5, measured(50)), step(63, measured(100))]
    places = [place.split(",") for place in parsed(curve_svg(steps)).attrib["data-sieves"].split()]
    assert [float(size_mm) for size_mm, _ in places] == [4, 31.5, 63]
    assert [float(x) for _, x in places] == pytest.approx([x for x, _ in points_of(steps)], abs=0.01)


@examples(0.5)
@given(
    st.lists(st.floats(0.063, 125), min_size=1, max_size=25, unique=True),
    st.lists(st.floats(0, 100), min_size=25, max_size=25),
)
def test_a_rising_curve_rises_and_stays_on_the_paper(sizes_mm: list[float], percents: list[float]) -> None:
    steps = [
        step(size_mm, measured(percent, 3.0), decision(Verdict.CONFORMS, 0, 100))
        for size_mm, percent in zip(sorted(sizes_mm), sorted(percents), strict=False)
    ]
    points = points_of(steps)
    assert len(points) == len(steps)
    assert all(a[0] <= b[0] and a[1] >= b[1] for a, b in pairwise(points))
    assert all(FIELD.left <= x <= FIELD.right and FIELD.top <= y <= FIELD.bottom for x, y in points)
    parsed(curve_svg(steps))


def test_what_was_not_measured_is_hatched_and_no_curve_runs_through_it() -> None:
    steps = [
        step(1, NOT_MEASURED),
        step(2, NOT_MEASURED),
        step(4, measured(5)),
        step(8, measured(10)),
        step(10, NOT_MEASURED),
        step(16, measured(60)),
        step(63, NOT_MEASURED),
    ]
    assert list(unmeasured_ranges(steps, 0.9, 70)) == [(0.9, 4), (8, 16), (16, 70)]
    assert [len(line) for line in lines_of(steps)] == [2, 1, 2]  # the two of the legend, too
    assert lines_of(steps, Style.HATCH)


def test_far_from_what_was_measured_nothing_is_shown() -> None:
    steps = [step(size_mm, NOT_MEASURED) for size_mm in (0.075, 0.15, 0.3, 0.6, 1.18, 2.36)]
    steps += [step(4.75, measured(10)), step(9.5, measured(60)), step(75, NOT_MEASURED)]
    assert [found.sieve_mm for found in shown_steps(steps)] == [2.36, 4.75, 9.5, 75]


@pytest.mark.parametrize("steps", [[], [step(8, NOT_MEASURED)], [step(8, measured(50))]])
def test_a_lot_of_hardly_any_stones_has_a_picture_too(steps: list[CurveStep]) -> None:
    parsed(curve_svg(steps))


@pytest.mark.parametrize(
    ("verdict", "element"),
    [
        (Verdict.CONFORMS, "circle"),
        (Verdict.DOES_NOT_CONFORM, "polygon"),
        (Verdict.UNDECIDED, "polygon"),
        (Verdict.INSUFFICIENT, "circle"),
    ],
)
def test_each_verdict_has_its_mark_on_the_curve_and_in_the_legend(verdict: Verdict, element: str) -> None:
    root = parsed(curve_svg([step(8, measured(50), decision(verdict, 40, 60))]))
    style = str(verdict).replace("_", "-")
    assert len([found for found in root.iter(f"{SVG}{element}") if found.get("class") == style]) == 2


def test_a_second_curve_is_drawn_at_its_own_sieves() -> None:
    lines = lines_of(curve(), Style.LABORATORY, {4.0: 10.0, 8.0: 20.0, 1000.0: 100.0})
    assert len(lines[0]) == 2
