"""The word for an uncertainty, at its limits, and the causes that keep it from a better one."""

import pytest

from pipeline.uncertainty import Cause, QualityParameters, Uncertainty, verdict
from pipeline.views.quality import Quality

P = QualityParameters()


def having(volume_percent: float = 0.1, **surface_mm: float) -> Uncertainty:
    """An uncertainty with these causes of the surface's, the first of which is all of the volume's."""
    return Uncertainty(
        surface_mm={Cause(name): sd_mm for name, sd_mm in surface_mm.items()},
        volume_percent={
            Cause(name): 0.0 if number else volume_percent for number, name in enumerate(surface_mm)
        },
    )


@pytest.mark.parametrize(
    ("found", "quality"),
    [
        (having(focus=P.good_mm), Quality.GOOD),
        (having(focus=1.001 * P.good_mm), Quality.REDUCED),
        (having(focus=P.reduced_mm), Quality.REDUCED),
        (having(focus=1.001 * P.reduced_mm), Quality.DEGRADED),
        (having(P.good_volume_percent, focus=0.01), Quality.GOOD),
        (having(1.001 * P.good_volume_percent, focus=0.01), Quality.REDUCED),
        (having(1.001 * P.reduced_volume_percent, focus=0.01), Quality.DEGRADED),
        (having(20.0, hidden=1.0), Quality.GOOD),
    ],
)
def test_the_word_at_each_limit(found: Uncertainty, quality: Quality) -> None:
    word = verdict(found, Quality.GOOD, P)
    assert word.quality is quality
    assert (word.causes == ()) == (quality is Quality.GOOD)


@pytest.mark.parametrize("by_number", Quality)
def test_too_few_views_are_a_cause_of_their_own(by_number: Quality) -> None:
    word = verdict(having(focus=0.01), by_number, P)
    assert word.quality is by_number
    assert word.causes == (() if by_number is Quality.GOOD else (Cause.VIEWS,))
    worse = verdict(having(focus=1.0, views=0.1), by_number, P)
    assert worse.quality is Quality.DEGRADED
    assert set(worse.causes) == {Cause.FOCUS, Cause.VIEWS}


def test_causes_are_named_until_the_rest_would_be_good() -> None:
    word = verdict(having(pixels=0.007, focus=0.06, noise=0.035, unseen=0.055, hidden=0.5), Quality.GOOD, P)
    assert word.causes == (Cause.FOCUS, Cause.UNSEEN)


@pytest.mark.parametrize("cause", [Cause.HIDDEN, Cause.RUSH])
def test_dents_that_pixels_were_to_show_keep_a_result_from_being_good(cause: Cause) -> None:
    found = having(20.0, hidden=1.0, focus=0.01)
    word = verdict(found, Quality.GOOD, P, cause)
    assert (word.quality, word.causes) == (Quality.REDUCED, (cause,))
    shallow = verdict(having(hidden=P.good_mm), Quality.GOOD, P, cause)
    assert (shallow.quality, shallow.causes) == (Quality.GOOD, ())


@pytest.mark.parametrize("wrong", [{"good_mm": 0.2}, {"good_volume_percent": 0.0}])
def test_limits_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="quality needs"):
        QualityParameters(**wrong)
