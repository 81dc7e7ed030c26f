"""Photographed stones, judged with the rig file that was right before a camera was hit."""

from collections.abc import Sequence

import numpy as np
import pytest
from support import rendered
from support.outlines import bumped

from pipeline.frames import CameraId, FrameBundle
from pipeline.particle import ParticleResult, PipelineParameters, measure_bundle
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import SilhouetteSet, segment_all
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.stones import stone
from pipeline.views.epipolar_tangency import ALARM_PX, epipolar_tangents, outlines_of, tangency_scores_px
from pipeline.views.quality import Quality

RIG = rendered.rig()
C05 = CameraId("c05")
FORMS = ("round", "flaky")
SEED = 91


@pytest.fixture(scope="module")
def bundles() -> Sequence[FrameBundle]:
    return [
        rendered.bundle_of(
            tumble(stone(form, 10.0 + 12 * number, stream(SEED, number)), RIG, stream(SEED, 9, number)),
            number=SEED + number,
        )
        for number, form in enumerate(FORMS)
    ]


@pytest.fixture(scope="module")
def silhouettes(bundles: Sequence[FrameBundle]) -> Sequence[SilhouetteSet]:
    return [segment_all(bundle.frames, rendered.background(), BackgroundSegmenter()) for bundle in bundles]


def measured(bundle: FrameBundle, rig: RigCalibration) -> ParticleResult:
    return measure_bundle(bundle, rig, rendered.background(), BackgroundSegmenter(), PipelineParameters())


def scores_px(seen: SilhouetteSet, rig: RigCalibration) -> dict[CameraId, float]:
    return tangency_scores_px(epipolar_tangents(outlines_of(seen), rig))


def test_healthy_cameras_stay_far_below_the_alarm(silhouettes: Sequence[SilhouetteSet]) -> None:
    scores = [score_px for seen in silhouettes for score_px in scores_px(seen, RIG).values()]
    assert len(scores) == 16 * len(FORMS)
    assert float(np.median(scores)) < 0.12
    assert max(scores) < ALARM_PX


def test_a_tenth_of_a_degree_stands_out_on_every_stone(silhouettes: Sequence[SilhouetteSet]) -> None:
    hit = bumped(RIG, "c05", np.array([0.08, 0.06, 0.0]))
    for seen in silhouettes:
        scores = scores_px(seen, hit)
        assert scores.pop(C05) > 3
        assert max(scores.values()) < ALARM_PX


def test_half_a_degree_is_named_and_dropped_and_nothing_else_changes(bundles: Sequence[FrameBundle]) -> None:
    right, wrong = (
        measured(bundles[0], RIG),
        measured(bundles[0], bumped(RIG, "c05", np.array([0.3, -0.4, 0.0]))),
    )
    assert not right.dropped
    assert list(wrong.dropped) == ["c05"]
    assert str(wrong.dropped[C05]).startswith("contradicts the other views: its tangents miss theirs by")
    assert (wrong.quality, len(wrong.views)) == (Quality.GOOD, 15)
    assert right.measurement is not None
    assert wrong.measurement is not None
    assert wrong.measurement.volume_mm3 == pytest.approx(right.measurement.volume_mm3, rel=0.01)
    assert wrong.consistency is not None
    assert wrong.consistency.tangency_px[C05] > 10
    assert np.hypot(*wrong.consistency.image_shifts_px[C05]) == pytest.approx(55, abs=3)
