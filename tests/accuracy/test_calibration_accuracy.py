"""A rig with a workshop's deviations is calibrated from rendered drops to a hundredth of a percent."""

from collections.abc import Iterator

import pytest
from accuracy.calibration import (
    Accuracy,
    Photographed,
    accuracy,
    photographed,
    solved,
    table_of,
    with_outliers,
)
from rich.console import Console

from pipeline.calibration import CalibrationReport
from pipeline.calibration.report import FoundLenses, UnseenLenses
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.exposure import LENS_PRESETS, LensPreset

SEED = 3

pytestmark = pytest.mark.full


@pytest.fixture(scope="module", params=[LensPreset.SHARP, LensPreset.F2])
def seen(request: pytest.FixtureRequest) -> Photographed:
    return photographed(SEED, lens=request.param)


@pytest.fixture(scope="module")
def judged(
    seen: Photographed, request: pytest.FixtureRequest
) -> Iterator[dict[int, tuple[CalibrationReport, Accuracy]]]:
    """From 8 and from 20 drops, with a cut off one, a spotted one and outliers among them."""
    found = {}
    for n in (8, 20):
        drops, shifted = with_outliers([*seen.drops[: n - 2], seen.cut_off, seen.spotted], stream(SEED, n))
        report = solved(drops, "bundle")
        left_out = {(name, camera) for name, views in report.views_left_out.items() for camera in views}
        assert shifted <= left_out, "outliers are found"
        assert {(seen.cut_off.name, camera) for camera in seen.cut_off.refused} <= left_out, "and named"
        # the ball that is cut off in some views is far outside of the others in all of them
        sound = {(name, camera) for name, camera in left_out - shifted if name != seen.cut_off.name}
        assert len(sound) <= 2, "little else is dropped"
        found[n] = (report, accuracy(report, seen.rig, seen.held_out))
    rows = [(SEED, f"bundle, {n} drops, spoilt", *each) for n, each in found.items()]
    reporter = request.config.pluginmanager.getplugin("capturemanager")
    with reporter.global_and_fixture_disabled():
        Console(width=170).print("\n", table_of(rows))
    yield found


@pytest.mark.parametrize(
    ("n_drops", "reprojection_px", "length_percent", "rigid_um"), [(8, 0.1, 0.02, 10), (20, 0.06, 0.02, 5)]
)
def test_calibration_from_drops(
    judged: dict[int, tuple[CalibrationReport, Accuracy]],
    n_drops: int,
    reprojection_px: float,
    length_percent: float,
    rigid_um: float,
) -> None:
    report, found = judged[n_drops]
    assert report.is_acceptable, report.problems
    assert found.reprojection_px <= reprojection_px
    assert found.length_percent <= length_percent
    assert found.rigid_um <= rigid_um


@pytest.mark.parametrize("n_drops", [8, 20])
def test_aperture_and_focus_are_found(
    judged: dict[int, tuple[CalibrationReport, Accuracy]], seen: Photographed, n_drops: int
) -> None:
    lenses, lens = judged[n_drops][0].lenses, LENS_PRESETS[seen.lens].lens
    if lens is None:
        assert lenses is UnseenLenses.STOPPED_DOWN
    else:
        assert isinstance(lenses, FoundLenses)
        assert lenses.f_number.value == pytest.approx(lens.f_number, rel=0.03)
        assert [found.value for found in lenses.focus_mm.values()] == pytest.approx(
            [lens.focus_mm] * 16, abs=2.5
        )


def test_cut_off_ball_and_spot_are_dropped(seen: Photographed) -> None:
    assert seen.cut_off.refused
    assert all("cut off" in reason for reason in seen.cut_off.refused.values())
    # the spot goes, the ball's own outline stays
    assert not seen.spotted.refused
    for view in seen.spotted.views.values():
        assert view.rms_px < 0.05
