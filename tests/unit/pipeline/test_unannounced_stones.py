"""A second stone in the picture that the gate did not announce: rejected, or nothing in use shows it, or never good."""

from dataclasses import dataclass

import numpy as np
import pytest
from support import rendered
from support.extents import first_quick

from pipeline.errors import RejectReason
from pipeline.particle import BodyParameters, ParticleResult, PipelineParameters, measure_bundle
from pipeline.segmentation.silhouette import INSIDE
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import Body, sphere
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.stones import stone
from pipeline.views.quality import Quality

ESTIMATE = PipelineParameters(body=BodyParameters("estimate", texture=False))
SHOWN = 0.01
"""Share of a silhouette's area by which it may differ from that of the due stone alone: noise of its edge."""


@dataclass(frozen=True)
class Fallen:
    """Two stones in one picture, the due one at its centre."""

    due_mm: float
    other_mm: float
    other_at_mm: tuple[float, float, float]
    fate: str  # a reason; or a quality at most


NEAR = (
    Fallen(20, 8, (10.6, 8.8, 2.3), "reduced"),  # touches it: merged in 14 views, apart in none
    Fallen(
        25, 3, (6.7, -18.9, 9.0), "good"
    ),  # merged in two views, which contradict the others; dust in these
    Fallen(10, 8, (0, 0, 24), "multiple"),
    Fallen(15, 12, (0, 0, -30), "multiple"),  # cut by the border in the lower views
    Fallen(25, 3, (16.3, 10.9, -17.1), "reduced"),  # merged in two views
    Fallen(25, 3, (10, 8.1, -7.7), "inconsistent"),
    Fallen(10, 5, (-3.2, -5, 5), "reduced"),  # 0.3 mm away, apart in one view
    Fallen(10, 8, (1.4, 8.1, 3.6), "reduced"),
    Fallen(10, 12, (6.2, -0.7, 9.4), "degraded"),  # touches it, and is the larger one
    Fallen(25, 5, (-1.3, -0.1, -15.2), "reduced"),
    Fallen(25, 8, (-44.7, 24, 8.8), "reduced"),  # far beside it, in three views
    Fallen(25, 20, (30, 20, 20), "multiple"),
    Fallen(15, 15, (0, 0, 15.5), "clipped"),  # covers it in the steep views, cut in others
    Fallen(15, 5, (3, 2, 13), "multiple"),
)


def measured(*placed: tuple[Body, tuple[float, float, float]]) -> ParticleResult:
    bundle = rendered.bundle_of(*(rendered.placed(body, at_mm) for body, at_mm in placed), number=3)
    return measure_bundle(bundle, rendered.rig(), rendered.background(), BackgroundSegmenter(), ESTIMATE)


def areas(result: ParticleResult) -> dict[str, int]:
    """Pixels of the body in each view that was used."""
    return {
        camera: int(np.count_nonzero(result.silhouettes[camera].labels == INSIDE)) for camera in result.views
    }


@pytest.mark.parametrize("form", first_quick(["sphere", "stone"]))
@pytest.mark.parametrize("fallen", first_quick(NEAR))
def test_it_never_gives_a_good_result_that_may_be_wrong(fallen: Fallen, form: str) -> None:
    def body(size_mm: float, name: str) -> Body:
        return sphere(size_mm) if form == "sphere" else stone(name, size_mm, stream(8, round(size_mm)))

    due, other = body(fallen.due_mm, "round"), body(fallen.other_mm, "angular")
    result = measured((due, (0, 0, 0)), (other, fallen.other_at_mm))
    if form == "sphere":
        assert fallen.fate == (result.rejection.reason if result.rejection else result.quality)
    if result.rejection is not None:
        assert result.rejection.reason in (
            RejectReason.MULTIPLE,
            RejectReason.INCONSISTENT,
            RejectReason.CLIPPED,
        )
        return
    if result.quality is not Quality.GOOD:
        assert result.quality_causes
        return
    alone = areas(measured((due, (0, 0, 0))))
    assert all(abs(area / alone[camera] - 1) < SHOWN for camera, area in areas(result).items())
    assert result.measurement is not None
    off_percent = 100 * (result.measurement.volume_mm3 / due.mesh.volume - 1)
    assert abs(off_percent) < 2 * result.measurement.volume_sd_percent
