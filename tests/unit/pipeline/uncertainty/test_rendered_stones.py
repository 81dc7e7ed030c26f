"""What measured stones say of themselves: sharp ones are good, spoiled ones name what spoils them."""

import numpy as np
import pytest
import trimesh
from support import rendered

from pipeline.errors import RejectReason
from pipeline.evaluation.surface_distances import Surface, surface_distances
from pipeline.frames import FrameBundle
from pipeline.particle import ParticleResult, PipelineParameters, measure_bundle
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import Body, cube, sphere
from pipeline.synthesis.exposure import ExposureParameters
from pipeline.uncertainty import Cause
from pipeline.views.quality import Quality


def measured(bundle: FrameBundle, body: Body) -> tuple[ParticleResult, float]:
    """The result of a bundle, and its mean distance from the body in mm, infinite without a result."""
    result = measure_bundle(
        bundle, rendered.rig(), rendered.background(), BackgroundSegmenter(), PipelineParameters()
    )
    if result.mesh is None:
        return result, np.inf
    mesh = trimesh.Trimesh(result.mesh.vertices_mm, result.mesh.faces, process=False)
    truth = Surface(rendered.placed(body).world_mesh)
    return result, surface_distances(mesh, truth, np.random.default_rng(1)).mean_mm


def main_cause(result: ParticleResult) -> Cause:
    """The greatest cause but the dents that no silhouette shows."""
    assert result.measurement is not None
    surface_mm = result.measurement.uncertainty.surface_mm
    return max(surface_mm.keys() - {Cause.HIDDEN}, key=lambda cause: surface_mm[cause])


@pytest.mark.parametrize(
    ("exposure", "cause", "quality"),
    [
        (ExposureParameters(), Cause.PIXELS, Quality.GOOD),
        (
            ExposureParameters(blur_px=3.0),
            Cause.FOCUS,
            Quality.REDUCED,
        ),  # no texture shows whether it has dents
        (ExposureParameters(exposure_us=180.0), Cause.MOTION, Quality.GOOD),
        (ExposureParameters(read_noise=10.0), Cause.NOISE, Quality.REDUCED),
    ],
)
def test_a_sphere_names_what_spoils_it_and_is_as_true_as_it_says(
    exposure: ExposureParameters, cause: Cause, quality: Quality
) -> None:
    result, error_mm = measured(rendered.sphere_exposed_as(exposure), sphere())
    assert result.quality is quality
    assert main_cause(result) is cause
    assert result.measurement is not None
    assert error_mm < 3 * result.measurement.surface_sd_mm


def test_a_body_that_looks_like_the_wall_in_places_is_as_true_as_it_says() -> None:
    """Its detail tells it from the wall; as far as that fails, it is not good."""
    result, error_mm = measured(rendered.bright_cube_bundle(), cube())
    if result.rejection is not None:
        assert result.rejection.reason in (RejectReason.UNSEEN, RejectReason.INCONSISTENT)
    else:
        assert result.measurement is not None
        assert error_mm < 2 * result.measurement.surface_sd_mm
        assert (result.quality is Quality.GOOD) == (result.measurement.surface_sd_mm < 0.04)
