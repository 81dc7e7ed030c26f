"""Whether dents are still seen, told from what the record of each stone says of its pixels."""

from collections.abc import Iterable

from support.outcomes import result

from service.health.refinement_watch import (
    HYSTERESIS,
    MIN_LOOKED_AT,
    REFERENCE,
    RUSHED_SHARE,
    WINDOW,
    RefinementTrend,
    RefinementWatch,
)
from service.results.fields import RUSH, Result

RUSHED = result(kind="particle", body="estimate", refinement_fallback=RUSH)


def seen(share: float) -> Result:
    """Return the record of a stone whose pixels were looked at; of too small a share they showed nothing."""
    fallback = "no texture that the views share" if share == 0 else None
    return result(kind="particle", supported_share=share, refinement_fallback=fallback)


def after(*records: Result) -> RefinementWatch:
    watch = RefinementWatch()
    feed(watch, records)
    return watch


def feed(watch: RefinementWatch, records: Iterable[Result]) -> None:
    for record in records:
        watch.feed(record)


def test_the_median_of_the_latest_stones_is_told_once_there_are_enough() -> None:
    watch = after(*[seen(0.9)] * (WINDOW - 1))
    assert watch.trend == RefinementTrend()
    watch.feed(seen(0.1))
    assert (watch.trend.supported_share, watch.trend.rushed_share) == (0.9, 0.0)
    feed(watch, [seen(0.7)] * WINDOW)
    assert (watch.trend.supported_share, watch.trend.warning) == (0.7, None)


def test_what_is_not_to_be_refined_says_nothing() -> None:
    estimated = result(kind="particle", body="estimate")
    ball = seen(0.0).model_copy(update={"kind": "ball"})
    lost = result(kind="particle", outcome="lost")
    assert after(*[estimated, ball, lost] * WINDOW).trend == RefinementTrend()


def test_a_rush_is_told_until_most_stones_are_refined_again() -> None:
    watch = after(*[seen(0.9)] * WINDOW, *[RUSHED] * round(RUSHED_SHARE * WINDOW))
    assert watch.trend.warning is None
    watch.feed(RUSHED)
    assert "51% of the latest stones were not refined because others waited" in str(watch.trend.warning)
    assert "stonefall remeasure" in str(watch.trend.warning)
    least = round(HYSTERESIS * RUSHED_SHARE * WINDOW)
    feed(watch, [seen(0.9)] * (WINDOW - least - 1))
    assert watch.trend.is_rushed
    feed(watch, [seen(0.9)])
    assert (watch.trend.rushed_share, watch.trend.warning) == (least / WINDOW, None)


def test_stones_whose_pixels_say_less_than_at_first_are_told_until_they_say_more() -> None:
    watch = after(*[seen(0.8)] * REFERENCE)
    feed(watch, [seen(0.41)] * WINDOW)
    assert watch.trend.warning is None
    feed(watch, [seen(0.39)] * WINDOW)
    assert "pixels support 39% of the surface, 80% at the beginning of the run" in str(watch.trend.warning)
    assert "wet, dusty or dark stones" in str(watch.trend.warning)
    feed(watch, [seen(0.49)] * WINDOW)
    assert watch.trend.has_fallen
    feed(watch, [seen(0.51)] * WINDOW)
    assert watch.trend.warning is None
    feed(watch, [seen(0.0)] * WINDOW)  # measured as estimated
    assert watch.trend.has_fallen


def test_stones_without_texture_from_the_beginning_have_not_fallen() -> None:
    assert after(*[seen(0.0)] * (REFERENCE + WINDOW)).trend.warning is None


def test_nothing_is_compared_before_the_reference_is_whole() -> None:
    fallen = [seen(0.8)] * (REFERENCE - WINDOW - 1) + [seen(0.1)] * WINDOW
    watch = after(*fallen)
    assert (watch.trend.supported_share, watch.trend.reference_share) == (0.1, None)
    assert not watch.trend.has_fallen
    watch.feed(seen(0.1))
    assert watch.trend.has_fallen


def test_the_few_that_are_looked_at_in_a_rush_say_nothing_of_the_pixels() -> None:
    watch = after(*[seen(0.8)] * REFERENCE, *[RUSHED] * WINDOW, *[seen(0.1)] * (MIN_LOOKED_AT - 1))
    assert (watch.trend.supported_share, watch.trend.has_fallen) == (0.8, False)
    watch.feed(seen(0.1))
    assert (watch.trend.supported_share, watch.trend.has_fallen) == (0.1, True)
