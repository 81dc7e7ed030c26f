"""The predicted uncertainty is the scatter that is found."""

import numpy as np
import pytest
from support.ball_drops import drops_across

from pipeline.calibration.calibration import by_bundle_adjustment
from pipeline.calibration.report import CalibrationReport
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig

NOMINAL = nominal_rig()


def solved(true: RigCalibration, n_drops: int, seed: int, noise_px: float = 0.1) -> CalibrationReport:
    drops = drops_across(true, n_drops, seed=seed, noise_px=noise_px)
    return by_bundle_adjustment(drops, NOMINAL, created_at="2026-01-01T00:00:00Z", name="solved")


@pytest.fixture(scope="module")
def reports() -> list[tuple[RigCalibration, CalibrationReport]]:
    rigs = [as_built(NOMINAL, 500 + seed) for seed in range(4)]
    return [(rig, solved(rig, 8, seed)) for seed, rig in enumerate(rigs)]


@pytest.mark.full
def test_standard_deviations_of_cameras(reports: list[tuple[RigCalibration, CalibrationReport]]) -> None:
    focal, principal = [], []
    for true, report in reports:
        assert report.uncertainty is not None
        for camera, found in zip(true.cameras, report.rig.cameras, strict=True):
            sd = report.uncertainty.cameras[camera.id]
            focal.append(100 * np.log(found.focal_px / camera.focal_px) / sd.focal_percent)
            principal.extend((found.K[:2, 2] - camera.K[:2, 2]) / sd.principal_point_px)
    assert 0.6 < np.std(focal) < 1.5
    assert 0.6 < np.std(principal) < 1.5


def test_noise_is_found(reports: list[tuple[RigCalibration, CalibrationReport]]) -> None:
    # the centre of 120 points of 0.1 px
    for _, report in reports:
        assert report.uncertainty is not None
        assert report.uncertainty.observation_px == pytest.approx(0.1 * np.sqrt(2 / 120), rel=0.25)


def test_edge_that_cannot_be_seen_is_part_of_a_length(
    reports: list[tuple[RigCalibration, CalibrationReport]],
) -> None:
    # 0.05 px of a radius of 104 px
    for _, report in reports:
        assert report.uncertainty is not None
        assert report.uncertainty.length_sd_percent == pytest.approx(0.05, abs=0.01)


def test_second_diameter_makes_lengths_certain() -> None:
    true = as_built(NOMINAL, 41)
    drops = [
        *drops_across(true, 8, seed=1),
        *drops_across(true, 4, first=9, seed=2, diameter_mm=16.0, spread_mm=(6, 6, 6)),
    ]
    report = by_bundle_adjustment(drops, NOMINAL, created_at="2026-01-01T00:00:00Z", name="solved")
    assert report.uncertainty is not None
    assert report.uncertainty.length_sd_percent < 0.02
