"""Aperture and focus from the widths of edges; drops are analytic, no image is rendered."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from support.ball_drops import drop, drops_across

from pipeline.calibration import BallDrop, calibrate
from pipeline.calibration.lens_fit import fit_lenses, lens_of
from pipeline.calibration.report import FoundLenses, UnseenLenses
from pipeline.errors import ProblemCode
from pipeline.frames import CameraId
from pipeline.rig.cameras import Lens, RigCalibration
from pipeline.rig.design import as_built, nominal_rig

TRUE = as_built(nominal_rig(), 7)
C05 = CameraId("c05")
FOCUS_MM = np.random.default_rng(3).normal(300, 3, 16)


def with_lenses(
    f_number: float, focus_mm: Sequence[float] | NDArray[np.float64] = FOCUS_MM
) -> RigCalibration:
    cameras = [
        replace(camera, lens=Lens(focal_length_mm=25.0, f_number=f_number, focus_mm=float(mm), blur_px=0.9))
        for camera, mm in zip(TRUE.cameras, focus_mm, strict=True)
    ]
    return replace(TRUE, cameras=tuple(cameras))


def places_mm(n_drops: int, half_mm: float = 9.0) -> NDArray[np.float64]:
    return np.random.default_rng(5).uniform(-half_mm, half_mm, (n_drops, 3))


def seen_by(rig: RigCalibration, at_mm: NDArray[np.float64], width_noise: float = 0.02) -> list[BallDrop]:
    rng = np.random.default_rng(6)
    return [drop(f"{n}", rig, at, width_noise=width_noise, rng=rng) for n, at in enumerate(at_mm)]


def found_in(f_number: float, n_drops: int = 8, half_mm: float = 9.0) -> FoundLenses | UnseenLenses:
    at_mm = places_mm(n_drops, half_mm)
    return fit_lenses(seen_by(with_lenses(f_number), at_mm), TRUE.cameras, at_mm)


@pytest.mark.parametrize(("f_number", "focus_mm"), [(2.0, 0.5), (4.0, 2.0)])
def test_aperture_and_focus_are_found_from_eight_drops(f_number: float, focus_mm: float) -> None:
    lenses = found_in(f_number)
    assert isinstance(lenses, FoundLenses)
    assert lenses.f_number.value == pytest.approx(f_number, abs=4 * lenses.f_number.sd)
    assert lenses.f_number.sd < 0.03 * f_number
    assert lenses.blur_px.value == pytest.approx(0.9, abs=0.02)
    errors_mm = np.array([found.value for found in lenses.focus_mm.values()]) - FOCUS_MM
    assert np.abs(errors_mm).max() < focus_mm
    in_sd = errors_mm / [found.sd for found in lenses.focus_mm.values()]
    assert 0.5 < np.sqrt((in_sd**2).mean()) < 2


def test_widths_without_noise_give_the_lenses_exactly() -> None:
    at_mm = places_mm(8)
    lenses = fit_lenses(seen_by(with_lenses(2.0), at_mm, width_noise=0.0), TRUE.cameras, at_mm)
    assert isinstance(lenses, FoundLenses)
    assert lenses.f_number.value == pytest.approx(2.0, rel=1e-3)
    assert [found.value for found in lenses.focus_mm.values()] == pytest.approx(FOCUS_MM, abs=0.02)


def test_a_few_wrong_widths_change_little() -> None:
    at_mm = places_mm(8)
    drops = seen_by(with_lenses(2.0), at_mm)
    for number, camera in ((0, "c01"), (1, "c02"), (2, "c03"), (3, "c01"), (4, "c09"), (5, "c12")):
        view = drops[number].views[CameraId(camera)]
        spoilt = replace(view, edge_sigma_px=2.5 * (view.edge_sigma_px or 0))
        drops[number] = replace(drops[number], views={**drops[number].views, CameraId(camera): spoilt})
    lenses = fit_lenses(drops, TRUE.cameras, at_mm)
    assert isinstance(lenses, FoundLenses)
    assert lenses.f_number.value == pytest.approx(2.0, rel=0.03)
    assert [found.value for found in lenses.focus_mm.values()] == pytest.approx(FOCUS_MM, abs=1.5)


@pytest.mark.parametrize(
    ("f_number", "half_mm", "why"),
    [(32.0, 9.0, UnseenLenses.STOPPED_DOWN), (2.0, 0.1, UnseenLenses.LITTLE_DEPTH)],
)
def test_what_the_balls_do_not_show_is_left_out(f_number: float, half_mm: float, why: UnseenLenses) -> None:
    lenses = found_in(f_number, half_mm=half_mm)
    assert lenses is why
    assert lens_of(TRUE.cameras[0], lenses) is None


def test_a_camera_with_few_widths_has_no_lens_and_the_others_have() -> None:
    at_mm = places_mm(8)
    drops = [
        ball
        if number < 3
        else replace(ball, views={**ball.views, C05: replace(ball.views[C05], edge_sigma_px=None)})
        for number, ball in enumerate(seen_by(with_lenses(2.0), at_mm))
    ]
    lenses = fit_lenses(drops, TRUE.cameras, at_mm)
    assert isinstance(lenses, FoundLenses)
    assert set(TRUE.camera_ids) - set(lenses.focus_mm) == {C05}


def test_a_calibration_says_which_camera_is_out_of_focus_and_keeps_the_lenses_in_the_rig() -> None:
    focus_mm = [310.0 if camera == C05 else 300.0 for camera in TRUE.camera_ids]
    drops = drops_across(with_lenses(2.0, focus_mm), 8, seed=9)
    report = calibrate(drops, nominal_rig(), method="bundle", created_at="2026-01-01T00:00:00Z", name="test")
    assert report.is_acceptable
    (problem,) = report.problems
    assert (problem.code, problem.camera) == (ProblemCode.OUT_OF_FOCUS, C05)
    assert "behind the middle" in problem.detail
    assert report.uncertainty is not None
    assert report.rig.length_sd_percent == report.uncertainty.length_sd_percent
    for camera, mm in zip(report.rig.cameras, focus_mm, strict=True):
        assert camera.lens is not None
        assert camera.lens.focus_mm == pytest.approx(mm, abs=1.5)


def test_drops_without_widths_calibrate_as_before() -> None:
    report = calibrate(
        drops_across(TRUE, 8, seed=9),
        nominal_rig(),
        method="bundle",
        created_at="2026-01-01T00:00:00Z",
        name="test",
    )
    assert report.lenses is UnseenLenses.NO_WIDTHS
    assert all(camera.lens is None for camera in report.rig.cameras)
