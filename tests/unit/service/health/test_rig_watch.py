"""What the watch makes of the records, one stone after the other."""

import re
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from support.outcomes import result
from support.outlines import seen_by, stone_outlines, stone_points, watch_record

from pipeline.frames import CameraId
from pipeline.rig.design import as_built, nominal_rig
from pipeline.view_optics import ViewOptics
from service.health.findings import CameraFinding, Severity
from service.health.rig_watch import MIN_STONES, WINDOW, RigWatch
from service.results.fields import Result

RIG = as_built(nominal_rig(), seed=3)
C05 = CameraId("c05")


def record(
    px: Mapping[str, float] | None = None,
    shift: tuple[float, float] = (0.0, 0.0),
    *,
    dropped: tuple[str, ...] = (),
    residual_px: Mapping[str, float] | None = None,
    calibration_id: str = RIG.calibration_id,
) -> Result:
    """Of a stone; cameras in `px` have this score, those and those dropped see the stone shifted."""
    scores = dict.fromkeys(RIG.camera_ids, 0.07) | dict(px or {})
    return result(
        outcome="measured",
        calibration_id=calibration_id,
        tangency_px=scores,
        image_shifts_px={c: list(shift if c in (px or {}) else (0.02, -0.01)) for c in RIG.camera_ids},
        dropped_views=dict.fromkeys(dropped, "contradicts the other views"),
        view_residuals_px={c: 0.15 for c in RIG.camera_ids if c not in dropped} | dict(residual_px or {}),
    )


def fed(*records: Result) -> RigWatch:
    watch = RigWatch(RIG)
    for each in records:
        watch.feed(each)
    return watch


def the_finding(watch: RigWatch) -> CameraFinding:
    (finding,) = watch.findings()
    return finding


def test_a_healthy_rig_is_not_suspected():
    watch = fed(*[record()] * 100)
    assert not watch.findings()
    score = watch.scores()[C05]
    assert (score.tangency_px, score.residual_px) == (0.07, 0.15)
    assert (score.tangency_drift_px, score.residual_drift_px) == (0.0, 0.0)


def test_few_stones_are_no_opinion():
    watch = fed(*[record({"c05": 1.0})] * (MIN_STONES - 1))
    assert not watch.findings()
    assert watch.scores()[C05].tangency_px is None
    watch.feed(record({"c05": 1.0}))
    assert the_finding(watch).cameras == (C05,)


def test_a_view_that_was_left_out_twice_is_named_and_cleared_by_a_clean_stone():
    displaced = record({"c05": 31.0}, (40.0, 20.0), dropped=("c05",))
    watch = fed(*[record()] * 30, displaced)
    assert not watch.findings(), "a piece of it may have been taken for background"
    watch.feed(displaced)
    found = the_finding(watch)
    assert (found.cameras, found.score_px, found.severity) == ((C05,), 31.0, Severity.OUT_OF_SPECIFICATION)
    assert found.detail.startswith(
        "moved: it sees the stones 44.7 px from where the others do, as if turned by 0.4"
    )
    assert found.detail.endswith("or drop the ball)")
    watch.feed(record())
    assert not watch.findings()


def test_a_camera_that_hardly_moved_is_named_within_the_window():
    watch, n_stones = fed(*[record()] * 100), 0
    while not watch.findings():
        watch.feed(record({"c05": 0.8}, (1.2, 0.3)))
        n_stones += 1
    assert n_stones <= WINDOW
    found = the_finding(watch)
    assert (found.cameras, found.severity) == ((C05,), Severity.MAINTENANCE)
    assert watch.scores()[C05].tangency_drift_px == pytest.approx(0.365)


@pytest.mark.parametrize("off_us", [40.0, -250.0])
@pytest.mark.parametrize("camera", ["c02", "c07", "c16"])
def test_a_shift_along_the_fall_is_a_time(camera: str, off_us: float):
    """The stone falls 2.426 mm a ms: late, it is seen lower."""
    (view,) = RIG.subset([CameraId(camera)]).cameras
    (at_uv, then_uv), _ = view.project([[0, 0, 0], [0, 0, -2.426e-3 * off_us]])
    shift = tuple(then_uv - at_uv)
    score_px = float(0.64 * np.hypot(*shift))
    detail = the_finding(fed(*[record({camera: score_px}, shift)] * MIN_STONES)).detail
    found = re.match(r"exposes (\d+) us (late|early), or has turned by .* px (lower|higher) than", detail)
    assert found is not None
    assert float(found[1]) == pytest.approx(abs(off_us), rel=0.02)
    assert found[2] == ("late" if off_us > 0 else "early")
    assert found[3] == ("lower" if off_us > 0 else "higher")
    assert "look at its trigger" in detail
    aside = (shift[1], -shift[0])
    detail = the_finding(fed(*[record({camera: score_px}, aside)] * MIN_STONES)).detail
    assert detail.startswith("moved: ")


def test_a_camera_that_exposes_late_is_told_from_one_that_moved_aside():
    """Twenty healthy stones, then c07 sees them 40 us further down, a tenth of a millimetre."""
    rng, watch, n_late = np.random.default_rng(2), RigWatch(RIG), 0
    (late,) = RIG.subset([CameraId("c07")]).cameras
    for _ in range(WINDOW):
        watch.feed(watch_record(stone_outlines(RIG, rng, 0.08), RIG))
    while not watch.findings():
        points_mm = stone_points(rng)
        outlines = {camera.id: seen_by(camera, points_mm, rng, 0.08) for camera in RIG.cameras}
        outlines[late.id] = seen_by(late, points_mm - [0, 0, 2.426e-3 * 40], rng, 0.08)
        watch.feed(watch_record(outlines, RIG))
        n_late += 1
    assert n_late <= WINDOW
    found = the_finding(watch)
    assert found.cameras == ("c07",)
    off_us = re.match(r"exposes (\d+) us late", found.detail)
    assert off_us is not None
    assert float(off_us[1]) == pytest.approx(40, abs=5)


def test_outlines_that_differ_without_a_shift_are_not_called_a_move():
    detail = the_finding(fed(*[record({"c05": 0.6}, (0.1, 0.0))] * MIN_STONES)).detail
    assert "turned about its line of sight, out of focus, or dirty" in detail


def optics_of(edge_width_px: float) -> ViewOptics:
    clean = dict.fromkeys(("dust", "spots_share", "saturated_share"), 0.0)
    return ViewOptics(
        brightness=1.0, gradient_uv=(0.0, 0.0), noise_grey=1.3, edge_width_px=edge_width_px, edge_widths_uv_px=None,
        contrast=None, **clean,
    )  # fmt: skip


def test_outlines_that_are_blurred_disagree_more_without_having_moved():
    blurred = {camera: optics_of(edge_width_px=4 * 2.6) for camera in RIG.camera_ids}
    stone = record(dict.fromkeys(RIG.camera_ids, 0.5)).model_copy(update={"optics": blurred})
    assert not fed(*[stone] * WINDOW).findings()
    moved = record({"c05": 1.3}, (2.0, 0.5)).model_copy(update={"optics": blurred})
    assert the_finding(fed(*[moved] * MIN_STONES)).cameras == (C05,)


def test_a_sharp_camera_is_compared_with_the_blurred_ones():
    blurred = {camera: optics_of(edge_width_px=4 * 2.6) for camera in RIG.camera_ids} | {
        "c05": optics_of(edge_width_px=2.6)
    }
    stone = record({"c05": 0.5}, (0.7, 0.2)).model_copy(update={"optics": blurred})
    assert not fed(*[stone] * WINDOW).findings()


def test_a_view_that_is_left_out_three_times_in_a_row_is_no_accident():
    odd = record({"c05": 0.1}, dropped=("c05",))
    watch = fed(*[record()] * 5, odd, odd, record(), odd, odd)
    assert not watch.findings()
    watch.feed(odd)
    found = the_finding(watch)
    assert (found.cameras, found.severity) == ((C05,), Severity.OUT_OF_SPECIFICATION)
    assert found.detail.startswith("contradicts the hull of the others, 3 stones in a row: clean its window")


def test_the_worst_is_named_first():
    watch = fed(*[record({"c05": 0.5, "c11": 0.9}, (1.0, 0.0))] * MIN_STONES)
    assert [finding.cameras for finding in watch.findings()] == [("c11",), ("c05",)]


def test_most_cameras_at_once_are_one_alarm():
    watch = fed(*[record(dict.fromkeys(RIG.camera_ids[:9], 0.5))] * MIN_STONES)
    found = the_finding(watch)
    assert found.cameras == ()
    assert found.detail.startswith(
        "9 of 16 cameras contradict one another, by 0.5 px: look at light and focus"
    )


def test_a_view_that_slowly_leaves_the_hull_is_dirty():
    watch = fed(*[record()] * WINDOW)
    for step in range(WINDOW):
        watch.feed(record(residual_px={"c05": 0.15 + 0.04 * step}))
    found = the_finding(watch)
    assert found.cameras == (C05,)
    assert "clean its window" in found.detail
    assert watch.scores()[C05].residual_drift_px == pytest.approx(0.38)


def test_scores_belong_to_a_calibration():
    watch = fed(*[record({"c05": 6.0}, (9.0, 0.0))] * 10)
    other = replace(RIG, name="new")
    watch.restart(other)
    assert not watch.findings()
    watch.feed(record({"c05": 6.0}, dropped=("c05",)))  # a stone from before the activation
    assert not watch.findings()
    for _ in range(2):
        watch.feed(record({"c05": 6.0}, (9.0, 0.0), dropped=("c05",), calibration_id=other.calibration_id))
    assert the_finding(watch).cameras == (C05,)


def test_records_that_compare_no_views_teach_nothing():
    watch = fed(*[record({"c05": 31.0}, (50.0, 0.0), dropped=("c05",))] * 2)
    before = watch.findings()
    assert before
    watch.feed(result(outcome="lost", calibration_id=RIG.calibration_id))
    assert watch.findings() == before
