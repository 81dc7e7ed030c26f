"""Problems of a solution; drops are analytic, no image is rendered."""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.ball_drops import drops_across
from support.extents import first_quick

from pipeline.calibration import BallDrop, CalibrationReport, calibrate
from pipeline.calibration.acceptance_limits import AcceptanceLimits
from pipeline.calibration.diagnosis import diagnose_after
from pipeline.calibration.solution_checks import scale_problems
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.design import as_built, nominal_rig

C03, C09 = CameraId("c03"), CameraId("c09")


def report_of(drops: Sequence[BallDrop], initial: RigCalibration | None = None) -> CalibrationReport:
    return calibrate(
        drops, initial or nominal_rig(), method="bundle", created_at="2026-01-01T00:00:00Z", name="test"
    )


@cache
def sound() -> tuple[list[BallDrop], CalibrationReport]:
    """Drops without any fault, and what they lead to."""
    drops = drops_across(as_built(nominal_rig(), 22), 8, seed=22)
    return drops, report_of(drops)


def turned(rig: RigCalibration, name: CameraId, degrees: float) -> RigCalibration:
    """The rig with one camera turned about its own v axis, where it stands."""

    def after(camera: CameraCalibration) -> CameraCalibration:
        R = Rotation.from_rotvec([0, np.deg2rad(degrees), 0]).as_matrix() @ camera.R
        return replace(camera, R=R, t_mm=-R @ camera.center_mm)

    return replace(rig, cameras=tuple(after(c) if c.id == name else c for c in rig.cameras))


def with_focal_lengths(rig: RigCalibration, factor: float, *names: CameraId) -> RigCalibration:
    """The rig with other lenses, in all cameras if none is named."""

    def after(camera: CameraCalibration) -> CameraCalibration:
        return replace(camera, K=camera.K @ np.diag([factor, factor, 1]))

    return replace(
        rig, cameras=tuple(after(c) if c.id in (names or rig.camera_ids) else c for c in rig.cameras)
    )


@pytest.mark.full
def test_a_sound_calibration_has_no_problem() -> None:
    _, report = sound()
    assert report.problems == ()
    assert report.is_acceptable
    few_large = drops_across(as_built(nominal_rig(), 2), 8, seed=2, diameter_mm=15, noise_px=0.3)
    assert report_of(few_large).problems == ()


@pytest.mark.parametrize(("seed", "focal_factor"), [(11, 1.0), (12, 1.09)])
def test_one_ball_of_a_wrong_diameter_is_named(seed: int, focal_factor: float) -> None:
    rig = with_focal_lengths(as_built(nominal_rig(), seed), focal_factor)
    report = report_of(drops_across(rig, 8, seed=seed, diameter_mm=9.5, entered_mm=10))
    (problem,) = [each for each in report.problems if each.is_fatal]
    assert problem.code == "wrong_diameter"
    assert "likely it is 9.5" in problem.detail or "likely it is 9.49" in problem.detail
    assert not report.is_acceptable


def test_another_lens_in_all_cameras_is_named_and_corrected() -> None:
    rig = with_focal_lengths(as_built(nominal_rig(), 13), 1.09)
    report = report_of(drops_across(rig, 8, seed=13))
    (problem,) = report.problems
    assert (problem.code, problem.is_fatal) == ("focal_length", False)
    assert "a 25 mm lens focused at 300 mm" in problem.detail
    found = np.mean([camera.focal_px for camera in report.rig.cameras])
    assert found == pytest.approx(np.mean([camera.focal_px for camera in rig.cameras]), rel=3e-3)


@pytest.mark.full
def test_another_lens_in_one_camera_is_named() -> None:
    rig = with_focal_lengths(as_built(nominal_rig(), 14), 1.06, C09)
    report = report_of(drops_across(rig, 8, seed=14))
    (problem,) = report.problems
    assert (problem.code, problem.camera, problem.is_fatal) == ("focal_length", C09, False)


def test_drops_close_together_cannot_tell_a_lens_from_a_diameter() -> None:
    rig = with_focal_lengths(as_built(nominal_rig(), 15), 1.05)
    # refused as a thin column before they are solved: judged here beside another solution
    blind = drops_across(rig, 6, seed=15, spread_mm=(0.4, 0.4, 0.4), noise_px=0.2)
    _, report = sound()
    (problem,) = scale_problems(report, blind, AcceptanceLimits())
    assert problem.code == "focal_length_or_diameter"
    assert problem.is_fatal


@pytest.mark.parametrize("degrees", [0.1, 0.5])
@pytest.mark.full
def test_a_camera_that_was_bumped_since_the_last_calibration_is_named(degrees: float) -> None:
    rig = as_built(nominal_rig(), 16)
    report = report_of(drops_across(turned(rig, C03, degrees), 8, seed=16), initial=rig)
    (problem,) = report.problems
    assert (problem.code, problem.camera, problem.is_fatal) == ("camera_moved", C03, False)
    turn = re.search(r"as if turned by ([0-9.]+) degrees", problem.detail)
    assert turn is not None
    assert float(turn[1]) == pytest.approx(degrees, rel=0.1)


@pytest.mark.parametrize(
    ("degrees", "n_before", "n_after"), first_quick([(0.1, 6, 2), (0.5, 3, 5), (0.05, 4, 4)])
)
def test_a_camera_that_moves_while_the_balls_fall_is_refused(
    degrees: float, n_before: int, n_after: int
) -> None:
    rig = as_built(nominal_rig(), 17)
    before = drops_across(rig, n_before, seed=17)
    after = drops_across(turned(rig, C09, degrees), n_after, first=n_before + 1, seed=18)
    report = report_of([*before, *after])
    (problem,) = report.problems
    assert problem.is_fatal
    assert problem.camera == C09
    assert problem.code in ("camera_moved_during_drops", "camera_contradicts")


def test_two_diameters_that_need_an_impossible_edge_are_refused() -> None:
    rig = as_built(nominal_rig(), 19)
    small = drops_across(rig, 5, seed=19, diameter_mm=9.95, entered_mm=10)
    report = report_of([*small, *drops_across(rig, 5, first=6, seed=20, diameter_mm=15)])
    (problem,) = [each for each in report.problems if each.is_fatal]
    assert problem.code == "large_edge_offset"
    assert "either the 10 mm ball is 9.9" in problem.detail


def test_without_a_diameter_the_scale_is_not_invented() -> None:
    drops = drops_across(as_built(nominal_rig(), 21), 8, seed=21)
    report = report_of([replace(drop, diameter_mm=None) for drop in drops])
    assert report.scale == "not_observable"
    (problem,) = report.problems
    assert (problem.code, problem.is_fatal) == ("scale_not_observable", False)


def test_residuals_and_uncertain_lengths_are_judged_by_the_limits() -> None:
    drops, report = sound()
    assert report.uncertainty is not None
    loose = replace(
        report,
        residuals_after_px={**report.residuals_after_px, C03: 0.5, C09: 2.0},
        held_out_px=1.5,
        uncertainty=replace(report.uncertainty, length_sd_percent=0.2),
    )
    found = {(each.code, each.camera, each.is_fatal) for each in diagnose_after(loose, drops)}
    assert found == {
        ("large_residual", C03, False),
        ("large_residual", C09, True),
        ("large_held_out_residual", None, True),
        ("uncertain_lengths", None, False),
    }
    strict = AcceptanceLimits(good_length_percent=0.001, max_length_percent=0.002)
    assert any(
        each.code == "uncertain_lengths" and each.is_fatal for each in diagnose_after(report, drops, strict)
    )


def test_a_rig_that_cannot_be_is_refused_and_its_camera_named() -> None:
    drops, report = sound()
    absurd = replace(report, rig=turned(report.rig, C09, 8.0))
    problem = diagnose_after(absurd, drops)[0]
    assert (problem.code, problem.camera, problem.is_fatal) == ("implausible_rig", C09, True)


def test_drops_that_were_left_out_are_counted() -> None:
    drops, report = sound()
    names = [drop.name for drop in drops]
    some = replace(report, drops_used=names[:6], drops_left_out=dict.fromkeys(names[6:], "two balls"))
    assert [(each.code, each.is_fatal) for each in diagnose_after(some, drops)] == [
        ("many_drops_left_out", False)
    ]
    most = replace(report, drops_used=names[:3], drops_left_out=dict.fromkeys(names[3:], "two balls"))
    assert [(each.code, each.is_fatal) for each in diagnose_after(most, drops)] == [("too_few_drops", True)]
