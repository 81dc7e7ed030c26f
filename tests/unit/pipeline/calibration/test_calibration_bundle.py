"""Bundle adjustment on outlines without images: the truth comes back, whatever is done to the drops."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.ball_drops import drop, drops_across, without_views
from support.extents import first_quick

from pipeline.calibration.bundle_adjustment import N_CAMERA, Solution, linearized
from pipeline.calibration.calibration import by_bundle_adjustment
from pipeline.calibration.drops import BallDrop
from pipeline.calibration.report import CalibrationReport, report_document
from pipeline.calibration.sphere_image import sightings_of
from pipeline.errors import CalibrationError
from pipeline.evaluation.scene import rig_error
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.rig.document import rig_from_document

NOMINAL = nominal_rig()
NOISE_PX = 0.1  # of each of 120 points: 0.013 px of a centre


def solved(drops: Sequence[BallDrop], initial: RigCalibration = NOMINAL) -> CalibrationReport:
    return by_bundle_adjustment(drops, initial, created_at="2026-01-01T00:00:00Z", name="solved")


def errors(rig: RigCalibration, true: RigCalibration) -> tuple[float, float]:
    """Rms of points over +-12 mm after the best rigid motion, in um; error of their scale in percent."""
    error = rig_error(rig, true)
    return 1e3 * error.rms_mm, error.scale_percent


@pytest.mark.parametrize("seed", first_quick(range(5)))
def test_converges_from_the_design(seed: int) -> None:
    true = as_built(NOMINAL, 100 + seed)
    report = solved(drops_across(true, 8, seed=seed, noise_px=NOISE_PX))
    assert np.mean(list(report.residuals_before_px.values())) > 30
    assert max(report.residuals_after_px.values()) < 0.05
    assert not report.views_left_out
    assert report.held_out_px is not None
    assert report.held_out_px < 0.05
    rigid_um, scale_percent = errors(report.rig, true)
    assert rigid_um < 3
    assert abs(scale_percent) < 0.02


@pytest.fixture(scope="module")
def true() -> RigCalibration:
    return as_built(NOMINAL, 31)


@pytest.fixture(scope="module")
def drops(true: RigCalibration) -> list[BallDrop]:
    return drops_across(true, 20, seed=3, noise_px=NOISE_PX)


@pytest.fixture(scope="module")
def report(drops: list[BallDrop]) -> CalibrationReport:
    return solved(drops)


def test_twenty_drops(report: CalibrationReport, true: RigCalibration) -> None:
    rigid_um, scale_percent = errors(report.rig, true)
    assert rigid_um < 1
    assert abs(scale_percent) < 0.01
    assert report.scale == "ball_diameter"
    assert report.edge_offset_px is None
    assert report.rig.ball_diameter_mm == 10.0
    assert rig_from_document(report_document(report)["rig"]).calibration_id == report.rig.calibration_id


def test_frame_is_the_initial_rigs(report: CalibrationReport) -> None:
    turns = [
        Rotation.from_matrix(camera.R.T @ initial.R).as_rotvec()
        for camera, initial in zip(report.rig.cameras, NOMINAL.cameras, strict=True)
    ]
    shifts_mm = [
        camera.center_mm - initial.center_mm
        for camera, initial in zip(report.rig.cameras, NOMINAL.cameras, strict=True)
    ]
    # the means of sixteen deviations of 1 degree and 2 mm are a quarter of that
    assert np.rad2deg(np.linalg.norm(np.mean(turns, axis=0))) < 0.5
    assert np.linalg.norm(np.mean(shifts_mm, axis=0)) < 1.0


def test_lens_of_another_focal_length_does_not_change_the_scale(true: RigCalibration) -> None:
    def longer(camera: CameraCalibration) -> CameraCalibration:
        K = camera.K.copy()
        K[[0, 1], [0, 1]] *= 1.09
        return replace(camera, K=K)

    longer_rig = replace(true, cameras=tuple(longer(camera) for camera in true.cameras))
    report = solved(drops_across(longer_rig, 12, seed=4, noise_px=NOISE_PX))
    assert abs(errors(report.rig, longer_rig)[1]) < 0.02
    assert report.focal_factor.value == pytest.approx(1.09, abs=0.01)
    assert report.distance_factor.value == pytest.approx(1.0, abs=0.005)


def test_wrong_diameter_shows_in_the_distances(true: RigCalibration) -> None:
    report = solved(drops_across(true, 12, seed=5, diameter_mm=9.5, entered_mm=10.0, noise_px=NOISE_PX))
    assert errors(report.rig, true)[1] == pytest.approx(5.26, abs=0.05)
    assert report.distance_factor.value > 1.03
    assert report.distance_factor.sd < 0.002


def test_scale_is_not_invented(drops: list[BallDrop]) -> None:
    report = solved([replace(each, diameter_mm=None) for each in drops[:10]])
    assert report.scale == "not_observable"
    assert report.rig.ball_diameter_mm is None
    assert report.distance_factor.value == pytest.approx(1.0, abs=1e-3), "the initial rig's is kept"
    assert report.uncertainty is not None
    assert report.uncertainty.length_sd_percent > 0.1
    assert max(report.residuals_after_px.values()) < 0.05, "which nothing shows"


def test_edge_offset_needs_two_diameters(true: RigCalibration) -> None:
    small = drops_across(true, 12, seed=6, noise_px=NOISE_PX, edge_offset_px=0.3)
    large = drops_across(
        true,
        4,
        first=13,
        seed=7,
        diameter_mm=16.0,
        spread_mm=(6, 6, 6),
        noise_px=NOISE_PX,
        edge_offset_px=0.3,
    )
    blind, seeing = solved(small), solved([*small, *large])
    assert errors(blind.rig, true)[1] == pytest.approx(-0.29, abs=0.02)
    assert blind.held_out_px is not None
    assert blind.held_out_px < 0.05, "blind to it"
    assert seeing.edge_offset_px == pytest.approx(0.3, abs=0.02)
    assert abs(errors(seeing.rig, true)[1]) < 0.02


def test_outliers_are_found_and_named(drops: list[BallDrop], true: RigCalibration) -> None:
    rng = np.random.default_rng(8)
    shifted = {(3, "c02"), (3, "c11"), (7, "c02"), (11, "c16"), (19, "c05")}
    spoilt = list(drops)
    for index, camera in shifted:
        view = spoilt[index].views[CameraId(camera)]
        angle = rng.uniform(0, 2 * np.pi)
        moved = replace(view, outline_uv=view.outline_uv + 8 * np.array([np.cos(angle), np.sin(angle)]))
        spoilt[index] = replace(spoilt[index], views={**spoilt[index].views, CameraId(camera): moved})
    report = solved(spoilt)
    found = {(name, camera) for name, views in report.views_left_out.items() for camera in views}
    assert found == {(drops[index].name, camera) for index, camera in shifted}
    assert errors(report.rig, true)[0] < 1


def test_drop_of_another_ball_is_left_out(drops: list[BallDrop], true: RigCalibration) -> None:
    other = drop("other", true, (1, 2, 3), diameter_mm=9.8, entered_mm=10.0, noise_px=NOISE_PX)
    report = solved([*drops, other])
    assert set(report.drops_left_out) == {"other"}
    assert "another size" in report.drops_left_out["other"]
    assert errors(report.rig, true)[0] < 1


def test_too_few_drops_are_no_calibration(drops: list[BallDrop]) -> None:
    hardly_seen = [without_views(each, NOMINAL.camera_ids[2:]) for each in drops[2:]]
    with pytest.raises(CalibrationError, match="only 2 of 20 drops"):
        solved([*drops[:2], *hardly_seen])


def test_hidden_arcs_and_missing_views_do_no_harm(drops: list[BallDrop], true: RigCalibration) -> None:
    def half_hidden(each: BallDrop, index: int) -> BallDrop:
        views = dict(each.views)
        for number, camera in enumerate(list(views)):
            if (number + index) % 5 == 0:
                del views[camera]
            elif (number + index) % 3 == 0:
                view = views[camera]
                is_seen = (view.outline_uv - view.center_uv) @ [0.6, 0.8] < 0.5 * view.radius_px
                views[camera] = replace(view, outline_uv=view.outline_uv[is_seen])
        return replace(each, views=views)

    report = solved([half_hidden(each, index) for index, each in enumerate(drops)])
    rigid_um, scale_percent = errors(report.rig, true)
    assert rigid_um < 1.5
    assert abs(scale_percent) < 0.01


def test_derivatives(true: RigCalibration, drops: list[BallDrop]) -> None:
    sightings = sightings_of([drops[0], replace(drops[1], diameter_mm=None)], NOMINAL.camera_ids)
    rng = np.random.default_rng(9)
    spread = np.array([0.01] * 3 + [1.0] * 3 + [0.01] + [5.0] * 2 + [0.1])
    solution = Solution(
        initial=NOMINAL.cameras,
        parameters=spread * rng.normal(size=(16, N_CAMERA)),
        centers_mm=rng.uniform(-5, 5, size=(2, 3)),
        edge_px=0.2,
    )
    blocks = linearized(solution, sightings)
    n_unknowns = 16 * N_CAMERA + 6 + 1
    steps = np.concatenate([np.tile(1e-4 * spread, 16), np.full(6, 1e-4), [1e-3]])
    for unknown in [*range(20), *range(160, 167)]:
        step = np.zeros(n_unknowns)
        step[unknown] = steps[unknown]
        ahead, behind = (linearized(solution.moved(sign * step), sightings).residuals_px for sign in (1, -1))
        expected = (ahead - behind) / (2 * steps[unknown])
        views, columns = np.nonzero(blocks.unknowns == unknown)
        analytic = np.zeros_like(expected)
        analytic[views] = blocks.jacobian[views, :, columns]
        # the derivative of the lens's distortion is left out: 0.1 percent
        assert np.abs(analytic - expected).max() <= 5e-3 * np.abs(expected).max() + 1e-9
