"""The paper's Algorithm 1, and what it cannot do."""

import numpy as np
import pytest
from support.ball_drops import drops_across, without_views

from pipeline.calibration.calibration import by_paper
from pipeline.calibration.paper import ball_points_mm, refined
from pipeline.calibration.report import CalibrationReport, report_document
from pipeline.errors import CalibrationError
from pipeline.rig.camera_arrays import nearest_point
from pipeline.rig.cameras import RigCalibration, rig_to_document
from pipeline.rig.design import as_built, nominal_rig
from pipeline.rig.document import rig_from_document

NOMINAL = nominal_rig().subset(nominal_rig().camera_ids[5:8])


@pytest.fixture(scope="module")
def true() -> RigCalibration:
    return as_built(NOMINAL, 5)


@pytest.fixture(scope="module")
def report(true: RigCalibration) -> CalibrationReport:
    drops = drops_across(true, 8, seed=2, noise_px=0.1)
    return by_paper(drops, NOMINAL, created_at="2026-01-01T00:00:00Z", name="paper")


def test_eq_9() -> None:
    point_mm = np.array([1.0, -2.0, 3.0])
    origins_mm = np.random.default_rng(1).normal(0, 300, size=(5, 3))
    directions = point_mm - origins_mm
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert nearest_point(origins_mm, directions) == pytest.approx(point_mm, abs=1e-9)


def test_parallel_rays_meet_nowhere_and_raise_nothing() -> None:
    along = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    assert nearest_point(np.array([[1.0, 0, -9], [3.0, 0, 7]]), along) == pytest.approx([2, 0, 0])


def test_points_are_those_of_the_initial_rig(true: RigCalibration) -> None:
    drops = drops_across(NOMINAL, 4, seed=3, noise_px=0.0, spread_mm=(2, 2, 2))
    rng = np.random.default_rng(3)
    placed_mm = np.array([2 * rng.uniform(-1, 1, size=3) for _ in range(1)])
    # the centroid of an outline is not the image of the centre: some micrometres
    assert ball_points_mm(drops, NOMINAL)[0] == pytest.approx(placed_mm[0], abs=0.01)


def test_residuals_fall(report: CalibrationReport) -> None:
    assert np.mean(list(report.residuals_before_px.values())) > 10
    assert np.mean(list(report.residuals_after_px.values())) < 0.1


@pytest.mark.parametrize("seed", range(4))
def test_eight_drops_leave_cameras_that_can_be(seed: int) -> None:
    drops = drops_across(as_built(NOMINAL, seed), 8, seed=seed, noise_px=0.1)
    found = by_paper(drops, NOMINAL, created_at="2026-01-01T00:00:00Z", name="paper")
    again = rig_from_document(rig_to_document(found.rig))
    assert [camera.focal_px for camera in again.cameras] == pytest.approx(
        [6250] * len(again.cameras), rel=0.1
    )


def test_scale_is_not_its_business(report: CalibrationReport) -> None:
    assert report.scale == "not_observable"
    assert report.uncertainty is None
    assert report.rig.method == "paper"
    assert report_document(report)["uncertainty"] is None


def test_bare_matrix_becomes_a_camera(report: CalibrationReport) -> None:
    for camera in report.rig.cameras:
        assert np.linalg.det(camera.R) == pytest.approx(1)
        assert camera.K[2].tolist() == [0, 0, 1]
        assert not camera.distortion.any()
    assert rig_from_document(rig_to_document(NOMINAL)).camera_ids == report.rig.camera_ids


def test_true_camera_stays(true: RigCalibration) -> None:
    camera = NOMINAL.cameras[0]
    points_mm = np.random.default_rng(4).uniform(-9, 9, size=(8, 3))
    found = refined(camera, points_mm, camera.project(points_mm)[0])
    assert found.project(points_mm)[0] == pytest.approx(camera.project(points_mm)[0], abs=1e-3)


def test_too_few_drops_for_a_camera(true: RigCalibration) -> None:
    drops = drops_across(true, 7, seed=2)
    drops[:2] = (without_views(each, ["c07"], "cut off") for each in drops[:2])
    with pytest.raises(CalibrationError, match="camera c07 saw 5 drops whole"):
        by_paper(drops, NOMINAL, created_at="2026-01-01T00:00:00Z", name="paper")
