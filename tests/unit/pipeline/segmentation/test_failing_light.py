"""Light that fades and windows that get dirty: what is measured stays, what cannot be trusted is left out."""

from collections.abc import Mapping
from functools import cache

import numpy as np
import pytest
from support import rendered
from support.extents import first_quick

from pipeline.frames import CameraId
from pipeline.particle import ParticleResult, PipelineParameters, measure_bundle
from pipeline.rig.cameras import RigCalibration
from pipeline.segmentation import BackgroundModel, segment_all
from pipeline.segmentation.background import learn_background
from pipeline.segmentation.optics import observe_all
from pipeline.segmentation.silhouette import UNKNOWN
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import sphere
from pipeline.synthesis.bundles import render_bundle, render_empty, stream
from pipeline.synthesis.disturbance import Disturbance, dust
from pipeline.synthesis.renderer import RenderedRig, simulate_rig
from service.health.findings import Severity
from service.health.optical_watch import MIN_EXPOSURES, OpticalParameters, OpticalWatch
from service.results.record import optics_record

CAMERAS = [CameraId(f"c{number:02d}") for number in (1, 3, 6, 7, 8, 9, 11, 14, 16)]
DIRTY = CameraId("c06")
SIZE_PX = (1280, 1024)
U = np.linspace(-1, 1, SIZE_PX[0], dtype=np.float32)


CENTER_MM = (0.5, -0.3, 0.2)
BODY = rendered.placed(sphere(), CENTER_MM)


@cache
def rig() -> RigCalibration:
    """Nine cameras, two in each layer at least: enough for a degraded result."""
    return rendered.rig().subset(CAMERAS)


@cache
def simulated() -> RenderedRig:
    return simulate_rig(rig(), stream(7, 0))


@cache
def one_camera() -> RenderedRig:
    """Return the rig with the dirty camera alone, in the same housing."""
    whole = simulated()
    return RenderedRig(
        rig=whole.rig.subset([DIRTY]), backgrounds=whole.backgrounds, parameters=whole.parameters
    )


@cache
def background() -> BackgroundModel:
    model: BackgroundModel = {}
    for number in range(3):
        model = learn_background(model, render_empty(simulated(), stream(7, 1, number), sequence=1).frames)
    return model


def measured(disturbances: Mapping[CameraId, Disturbance]) -> ParticleResult:
    """Measure a 15 mm sphere; the noise of the images is always the same."""
    bundle = render_bundle([BODY], simulated(), stream(7, 2), sequence=2, disturbances=disturbances)
    return measure_bundle(bundle, rig(), background(), BackgroundSegmenter(), PipelineParameters())


def light(loss: float, *, one_sided: bool) -> Disturbance:
    """Dim all that a camera sees, or ramp its light from nothing at the left border to twice as much at the right."""
    share = np.broadcast_to(1 - loss * (1 + U if one_sided else np.ones_like(U)), SIZE_PX[::-1])
    return Disturbance(wall_light=share, body_light=share)


@cache
def true_figures() -> tuple[float, float]:
    """Return the diameters of volume and of the hull, mm, in the light that the background was learnt in."""
    return diameters_mm(measured({}))


def diameters_mm(result: ParticleResult) -> tuple[float, float]:
    assert result.measurement is not None, result.rejection
    assert result.views == rig().camera_ids
    return result.measurement.equivalent_diameter_mm, result.measurement.hull.equivalent_diameter_mm


@pytest.mark.parametrize(("loss", "one_sided"), first_quick([(0.3, True), (0.15, True), (0.3, False)]))
@pytest.mark.full
def test_light_that_dims_by_a_third_over_an_hour_measures_no_other_sphere(
    loss: float, one_sided: bool
) -> None:
    """Stones fall all the time: no empty exposure, the background is an hour old."""
    dimmed = light(loss, one_sided=one_sided)
    found_mm = diameters_mm(measured(dict.fromkeys(CAMERAS, dimmed)))
    assert found_mm == pytest.approx(true_figures(), abs=0.02)


@pytest.mark.full
def test_a_window_that_gets_dusty_is_told_and_measures_on() -> None:
    """E1: maintenance at half of a limit, out of specification at the limit; the outline is still right."""
    told = []
    for strength in (0.1, 0.45, 0.9):
        dirty = dust(strength, np.random.default_rng(3), SIZE_PX)
        frames = render_bundle(
            [BODY], one_camera(), stream(7, 2), sequence=2, disturbances={DIRTY: dirty}
        ).frames
        silhouettes = segment_all(frames, background(), BackgroundSegmenter())
        watch = OpticalWatch(rig(), OpticalParameters())
        for _ in range(MIN_EXPOSURES):
            watch.feed_optics(optics_record(observe_all(frames, background(), silhouettes)))
        findings = watch.findings()
        assert all(finding.cameras == (DIRTY,) for finding in findings)
        told.append(max((finding.severity for finding in findings), default=Severity.NOTHING))
    assert told == [Severity.NOTHING, Severity.MAINTENANCE, Severity.OUT_OF_SPECIFICATION]
    assert diameters_mm(measured({DIRTY: dirty})) == pytest.approx(true_figures(), abs=0.02)


@pytest.mark.full
def test_a_splash_of_mud_before_the_outline_costs_what_it_hides() -> None:
    """E1, at its worst: hidden pixels do not carve, a view that the others contradict is left out."""
    (camera,) = rig().subset([DIRTY]).cameras
    ((u, v),) = camera.project([CENTER_MM])[0]
    away_px = np.hypot(*np.meshgrid(np.arange(SIZE_PX[0]) - u - 170, np.arange(SIZE_PX[1]) - v))
    mud = Disturbance(transmission=(1 - 0.9 / (1 + np.exp((away_px - 60) / 4))).astype(np.float32))
    result = measured({DIRTY: mud})
    assert result.dropped.keys() == {DIRTY} or np.any(result.silhouettes[DIRTY].labels == UNKNOWN)
    assert result.measurement is not None
    # eight views leave a little more around the sphere than nine
    assert result.measurement.hull.equivalent_diameter_mm == pytest.approx(true_figures()[1], abs=0.1)
