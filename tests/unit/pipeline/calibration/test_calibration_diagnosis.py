"""Problems of drops, found before anything is solved; drops are analytic, no image is rendered."""

import re
from collections.abc import Sequence

import pytest
from support.ball_drops import drops_across, with_views_of, without_views
from support.extents import first_quick

from pipeline.calibration.diagnosis import diagnose_before
from pipeline.calibration.drops import BallDrop
from pipeline.errors import CalibrationProblem
from pipeline.frames import CameraId
from pipeline.rig.design import as_built, nominal_rig

C03, C07, C11 = CameraId("c03"), CameraId("c07"), CameraId("c11")


def problems_of(drops: Sequence[BallDrop]) -> dict[str, CalibrationProblem]:
    return {problem.code: problem for problem in diagnose_before(drops, nominal_rig())}


@pytest.mark.parametrize("seed", first_quick(range(12)))
def test_sound_drops_of_any_rig_have_no_problem(seed: int) -> None:
    drops = drops_across(as_built(nominal_rig(), seed), [8, 12, 20][seed % 3], seed=seed)
    assert {code for code, problem in problems_of(drops).items() if problem.is_fatal} == set()


def test_too_few_drops_are_refused_and_few_are_named() -> None:
    drops = drops_across(as_built(nominal_rig(), 1), 20)
    blind = [without_views(drop, list(drop.views)[:-2], "shows no ball") for drop in drops[:10]]
    refused = problems_of([*blind, *drops[10:13]])["too_few_drops"]
    assert refused.is_fatal
    assert "only 3 of 13 drops" in refused.detail
    assert "shows no ball (140)" in refused.detail
    few = problems_of(drops[:7])["few_drops"]
    assert not few.is_fatal
    assert "7 drops" in few.detail
    assert "too_few_drops" in problems_of([])


@pytest.mark.parametrize("spread_mm", [(1.5, 1.5, 9), (9, 1, 1), (1, 1, 1)])
def test_a_thin_column_is_refused(spread_mm: tuple[float, float, float]) -> None:
    drops = drops_across(as_built(nominal_rig(), 2), 20, spread_mm=spread_mm)
    problem = problems_of(drops)["thin_column"]
    assert problem.is_fatal
    assert "towards" in problem.detail


@pytest.mark.parametrize(("n_seen", "is_fatal"), [(0, True), (2, True), (4, False)])
def test_a_camera_that_saw_too_few_drops_is_named(n_seen: int, is_fatal: bool) -> None:
    drops = drops_across(as_built(nominal_rig(), 3), 10)
    drops = [*drops[:n_seen], *(without_views(drop, [C07], "clipped") for drop in drops[n_seen:])]
    problem = problems_of(drops)["camera_saw_too_few"]
    assert (problem.camera, problem.is_fatal) == (C07, is_fatal)
    assert f"saw {n_seen} of 10" in problem.detail
    assert "clipped" in problem.detail


@pytest.mark.parametrize("seed", first_quick(range(6)))
def test_two_swapped_cameras_are_named(seed: int) -> None:
    ids = nominal_rig().camera_ids
    a, b = ids[seed], ids[(seed * 5 + 3) % 16]
    drops = drops_across(as_built(nominal_rig(), seed), 8, seed=seed)
    (problem,) = diagnose_before([with_views_of(drop, {a: b, b: a}) for drop in drops], nominal_rig())
    assert problem.is_fatal
    assert problem.code == "cameras_swapped"
    assert f"cameras {min(a, b)} and {max(a, b)} are swapped" in problem.detail


def test_three_cameras_in_a_circle_are_all_named() -> None:
    drops = drops_across(as_built(nominal_rig(), 4), 8)
    circle = {C03: C07, C07: C11, C11: C03}
    found = diagnose_before([with_views_of(drop, circle) for drop in drops], nominal_rig())
    assert {problem.camera for problem in found} == {C03, C07, C11}
    seen_by = {problem.camera: problem.detail for problem in found}
    assert "images of c07 show the view of c03" in seen_by[C07]


def test_a_camera_that_is_a_drop_late_is_named() -> None:
    drops = drops_across(as_built(nominal_rig(), 5), 10)
    late = [
        without_views(drop, [C03]) if number == 0 else with_another_view(drop, drops[number - 1], C03)
        for number, drop in enumerate(drops)
    ]
    problem = problems_of(late)["camera_out_of_place"]
    assert (problem.camera, problem.is_fatal) == (C03, True)
    assert "trigger late" in problem.detail


def test_single_views_that_are_far_off_say_nothing_about_a_camera() -> None:
    drops = drops_across(as_built(nominal_rig(), 8), 8)
    off = [with_another_view(drops[i], drops[i + 1], C03) if i in (2, 5) else drops[i] for i in range(8)]
    assert problems_of(off) == {}


def with_another_view(drop: BallDrop, other: BallDrop, camera: CameraId) -> BallDrop:
    return BallDrop(
        name=drop.name, diameter_mm=drop.diameter_mm, views={**drop.views, camera: other.views[camera]}
    )


def test_balls_of_two_sizes_entered_as_one_are_named() -> None:
    rig = as_built(nominal_rig(), 6)
    drops = [*drops_across(rig, 9), *drops_across(rig, 1, first=10, diameter_mm=15, entered_mm=10)]
    problem = problems_of(drops)["mixed_sizes"]
    assert "000010-ball (15." in problem.detail
    assert not problem.is_fatal, "one drop of another ball is left out by the solution"
    half = [*drops[:5], *drops_across(rig, 5, first=20, seed=1, diameter_mm=15, entered_mm=10)]
    assert problems_of(half)["mixed_sizes"].is_fatal


def test_a_diameter_that_is_wrong_by_far_is_refused_at_once() -> None:
    drops = drops_across(as_built(nominal_rig(), 7), 10, diameter_mm=15, entered_mm=10)
    problem = problems_of(drops)["wrong_diameter"]
    assert problem.is_fatal
    assert "looks 15." in problem.detail or "looks 14." in problem.detail


@pytest.mark.parametrize("seed", first_quick(range(4)))
def test_two_sizes_reveal_a_wrong_diameter(seed: int) -> None:
    rig = as_built(nominal_rig(), seed)
    large = drops_across(rig, 6, first=100, seed=seed, diameter_mm=15)
    wrong = drops_across(rig, 6, seed=seed + 50, diameter_mm=9.5, entered_mm=10)
    problem = problems_of([*wrong, *large])["wrong_diameter"]
    assert problem.is_fatal
    assert re.search(r"the 10 mm ball is 9\.(49|5\d) mm, or the 15 mm ball is 15\.7", problem.detail)
    right = drops_across(rig, 6, seed=seed + 50, diameter_mm=10, edge_offset_px=0.5)
    assert "wrong_diameter" not in problems_of([*right, *large])
