"""How well drops fill the volume, and which ball was which; drops are analytic, no image is rendered."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.ball_drops import drop, drops_across, without_views
from support.extents import examples

from pipeline.calibration.ball_sizes import apparent_diameter_mm, with_diameters
from pipeline.calibration.coverage import CoverageGoals, ball_center_mm, coverage
from pipeline.errors import CalibrationError
from pipeline.frames import CameraId
from pipeline.rig.design import as_built, nominal_rig

CORNERS_MM = [(x, y, z) for x in (-7.0, 7.0) for y in (-7.0, 7.0) for z in (-7.0, 7.0)]
places_mm = st.tuples(*[st.floats(-8, 8)] * 3)


def test_balls_in_the_corners_of_the_volume_suffice() -> None:
    rig = nominal_rig()
    covered = coverage([drop(str(i), rig, corner) for i, corner in enumerate(CORNERS_MM)], rig)
    assert covered.is_sufficient
    assert covered.n_drops == 8
    np.testing.assert_allclose(covered.extent_mm, 14, atol=0.05)
    np.testing.assert_allclose(covered.spread_mm, 7 * np.sqrt(8 / 7), atol=0.05)
    seen = covered.cameras[CameraId("c05")]
    assert seen.n_drops == 8
    one_ball = np.pi * (6250 * 5 / 300) ** 2 / (1280 * 1024)
    assert 5 * one_ball < seen.field_share < 8 * one_ball


def test_what_is_missing_is_said() -> None:
    rig = nominal_rig()
    flat = [drop(str(i), rig, (x, y, 0)) for i, (x, y, z) in enumerate(CORNERS_MM) if x < 0 or z < 0]
    missing = coverage(flat, rig).missing
    assert missing is not None
    assert "2 more drops" in missing
    assert "+z (so far 0.0 mm), -z (so far 0.0 mm)" in missing
    assert "+x" not in missing
    corners = [drop(str(i), rig, corner) for i, corner in enumerate(CORNERS_MM)]
    half_blind = [without_views(each, [CameraId("c02")]) for each in corners[:5]] + corners[5:]
    assert "c02 (3)" in (coverage(half_blind, rig).missing or "")
    nothing = coverage([], rig)
    assert not nothing.is_sufficient
    assert nothing.extent_mm == (0, 0, 0)


@given(places_mm=st.lists(places_mm, min_size=1, max_size=4), another_mm=places_mm)
@examples(0.15)
def test_another_drop_never_covers_less(
    places_mm: list[tuple[float, float, float]], another_mm: tuple[float, float, float]
) -> None:
    rig = nominal_rig().subset(CameraId(name) for name in ("c01", "c06", "c11"))
    drops = [drop(str(i), rig, place) for i, place in enumerate(places_mm)]
    before, after = coverage(drops, rig), coverage([*drops, drop("more", rig, another_mm)], rig)
    assert after.n_drops == before.n_drops + 1
    assert all(b >= a for a, b in zip(before.extent_mm, after.extent_mm, strict=True))
    assert all(after.cameras[c].field_share >= seen.field_share for c, seen in before.cameras.items())


@given(place_mm=places_mm)
@examples(0.15)
def test_a_ball_is_found_where_it_is(place_mm: tuple[float, float, float]) -> None:
    rig = nominal_rig()
    seen = drop("ball", rig, place_mm, 12.0)
    center_mm = ball_center_mm(seen, rig)
    assert center_mm is not None
    # the middle of an outline is up to 0.2 px beside the image of the centre
    np.testing.assert_allclose(center_mm, place_mm, atol=0.01)
    assert apparent_diameter_mm(seen, rig) == pytest.approx(12, rel=2e-3)
    assert ball_center_mm(without_views(seen, rig.camera_ids[1:]), rig) is None


@pytest.mark.parametrize("seed", range(6))
def test_each_drop_gets_the_diameter_of_its_ball(seed: int) -> None:
    rig = as_built(nominal_rig(), seed)
    n_small, n_large = 1 + seed, 6 - seed
    small = drops_across(rig, n_small, seed=seed, diameter_mm=10)
    large = drops_across(rig, n_large, first=100, seed=seed + 50, diameter_mm=12)
    # as entered: both wrong by the same factor, as are focal lengths of a lens that is focused near
    assigned = with_diameters([*large, *small], nominal_rig(), [13.1, 10.9])
    assert [each.diameter_mm for each in assigned] == [13.1] * n_large + [10.9] * n_small


def test_sizes_that_cannot_be_told_apart_are_refused() -> None:
    drops = drops_across(as_built(nominal_rig(), 1), 8)
    assert {each.diameter_mm for each in with_diameters(drops, nominal_rig(), [10.0])} == {10.0}
    assert {each.diameter_mm for each in with_diameters(drops, nominal_rig(), [])} == {None}
    with pytest.raises(CalibrationError, match=r"10 and 15 mm were entered.*look (9\.9|10\.\d) to"):
        with_diameters(drops, nominal_rig(), [15.0, 10.0])
    with pytest.raises(CalibrationError, match="none was seen"):
        with_diameters([], nominal_rig(), [15.0, 10.0])


def test_goals_are_parameters() -> None:
    rig = nominal_rig()
    corners = [drop(str(i), rig, corner) for i, corner in enumerate(CORNERS_MM)]
    assert coverage(corners, rig, CoverageGoals(n_drops=30)).missing == "22 more drops"
