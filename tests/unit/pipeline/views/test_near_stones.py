"""Another stone above or below the one that is due is told from it, or the view is not used."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.extents import examples
from support.parts import MIN_PX, ball_points, views_of

from pipeline.fall import Fall, pulse_width_ns
from pipeline.frames import NearStone, Trigger
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.view_parts import parts_of
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.stones import STONE_FORMS, stone
from pipeline.views.near_stones import PredictedStone, predicted_places, tell_apart

RIG = as_built(nominal_rig(), 3)
OFFSETS_MM = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)
SIZES_MM = st.floats(5, 20)


def at(above_mm: float) -> np.ndarray:
    return np.array([0.0, 0.0, above_mm])


def test_places_follow_from_the_times_at_the_gate() -> None:
    fall = Fall(speed_at_gate_mm_s=1400)
    first = Trigger(sequence=1, received_ns=0, device_ns=0, utc="", pulse_width_ns=pulse_width_ns(10, 1400))
    near = (NearStone(-20_000_000, pulse_width_ns(30, 1400)), NearStone(15_000_000))
    due, below, above = predicted_places(replace(first, near_stones=near), fall)
    assert due.extent_mm == pytest.approx(10, abs=0.01)
    assert not due.center_mm.any()
    # the lowest points are as far apart as free fall says, the centres by half of the difference in size less
    assert below.center_mm[2] == pytest.approx(fall.height_above_mm(-20_000_000) + 10, abs=0.01)
    assert below.extent_mm == pytest.approx(30, abs=0.01)
    assert above.center_mm[2] == pytest.approx(fall.height_above_mm(15_000_000) + 5, abs=0.01)


def test_a_stone_far_above_is_told_apart_in_every_view_that_shows_it() -> None:
    balls = [ball_points((1, -1, 2), 12), ball_points((-1, 1, 36), 14)]
    told = tell_apart(
        views_of(RIG, balls),
        [PredictedStone(center_mm=at(0), extent_mm=12), PredictedStone(center_mm=at(32), extent_mm=14)],
    )
    assert not told.covered
    assert len(told.others) >= 8
    assert told.places[0].center_mm == pytest.approx((1, -1, 2), abs=0.3)


def test_a_stone_that_covers_the_other_in_some_views_is_not_used_in_these() -> None:
    """Seen from 54 degrees above, stones one above the other cover each other although 5 mm are between them."""
    views = views_of(RIG, [ball_points(at(0), 15), ball_points(at(20), 15)])
    told = tell_apart(
        views, [PredictedStone(center_mm=at(0), extent_mm=15), PredictedStone(center_mm=at(20), extent_mm=15)]
    )
    assert told.covered == {camera.id for camera in RIG.cameras if abs(camera.center_mm[2]) > 200}


def test_what_lies_on_both_sides_of_a_dark_aperture_may_touch_behind_it() -> None:
    views = views_of(RIG, [ball_points(at(0), 12), ball_points(at(32), 14)])
    stones = [PredictedStone(center_mm=at(z), extent_mm=size) for z, size in ((0, 12), (32, 14))]
    shown = set(tell_apart(views, stones).others)
    dark = [
        replace(
            view, parts=parts_of(view.parts.numbers > 0, np.ones(view.parts.numbers.shape, np.bool_), MIN_PX)
        )
        for view in views
    ]
    told = tell_apart(dark, stones)
    assert shown and told.covered >= shown
    assert not told.others


def test_a_stone_that_is_not_where_it_should_be_spoils_only_views_that_it_could_cover() -> None:
    views = views_of(RIG, [ball_points(at(0), 10)])
    far = tell_apart(
        views, [PredictedStone(center_mm=at(0), extent_mm=10), PredictedStone(center_mm=at(60), extent_mm=10)]
    )
    near = tell_apart(
        views, [PredictedStone(center_mm=at(0), extent_mm=10), PredictedStone(center_mm=at(12), extent_mm=10)]
    )
    assert not far.covered and not far.others
    assert len(near.covered) == 16


@examples(0.6)
@given(OFFSETS_MM, OFFSETS_MM, SIZES_MM, SIZES_MM, st.floats(-50, 50), st.floats(-3, 3))
@pytest.mark.full
def test_the_due_stone_is_never_painted_over_and_never_seen_with_another(
    due_mm: np.ndarray,
    other_mm: np.ndarray,
    due_size_mm: float,
    other_size_mm: float,
    above_mm: float,
    off_mm: float,
) -> None:
    """Whatever was predicted within the stated error: views in use show exactly the due stone, once others are gone."""
    other_mm = other_mm + at(above_mm)
    balls = [ball_points(due_mm, due_size_mm), ball_points(other_mm, other_size_mm)]
    places = [
        PredictedStone(center_mm=at(0), extent_mm=due_size_mm),
        PredictedStone(center_mm=at(above_mm + off_mm), extent_mm=other_size_mm),
    ]
    both, alone = views_of(RIG, balls), views_of(RIG, balls[:1])
    told = tell_apart(both, places)
    for view, single in zip(both, alone, strict=True):
        camera = view.camera.id
        if camera in told.covered:
            continue
        left = (view.parts.numbers > 0) & ~told.others.get(
            camera, np.zeros_like(view.parts.numbers, np.bool_)
        )
        assert np.array_equal(left, single.parts.numbers > 0)


@pytest.mark.parametrize("form", STONE_FORMS)
@pytest.mark.full
def test_the_centre_of_a_stone_lies_in_the_middle_of_its_extent_as_stated(form: str) -> None:
    rng = stream(5, 1)
    for _ in range(60):
        turned_mm = stone(form, 15.0, rng).mesh.vertices @ Rotation.random(rng=rng).as_matrix().T
        share = -turned_mm[:, 2].min() / np.ptp(turned_mm[:, 2])
        assert abs(share - 0.5) < 0.08
