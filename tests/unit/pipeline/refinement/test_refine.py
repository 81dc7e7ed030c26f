"""The refined body: dents where pixels show them, the estimate where they show nothing."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
import trimesh
from support.extents import first_quick
from support.render_cache import kept_rendered
from support.rendered import SEED, background, rig, simulated

from pipeline.estimate import BodyEstimate, estimate_body
from pipeline.evaluation.surface_distances import Surface, SurfaceDistances, surface_distances
from pipeline.frames import FrameBundle
from pipeline.measuring.solid import solid_of
from pipeline.meshing import ParticleMesh
from pipeline.particle import BodyParameters, ParticleResult, PipelineParameters, measure_bundle
from pipeline.refinement import Refinement, refine_body
from pipeline.refinement.crossings import crossing_vertices
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis.bodies import Body, cube, sphere
from pipeline.synthesis.bundles import render_bundle, stream
from pipeline.synthesis.irregular_bodies import irregular_body
from pipeline.synthesis.placement import tumble
from pipeline.views.prepared import PreparedViews, prepare_views

PHOTO = PipelineParameters(body=BodyParameters("photo"))
BLACK_NYLON = 15.0
"""Grey level; the light that facets receive is sampled, which on a brighter body is texture."""
BODIES = ("dented", "plain sphere", "plain cube", "mottled cube", "rough")


def body(name: str) -> Body:
    match name:
        case "dented":
            return irregular_body("dented", 14.0, stream(SEED, 31))
        case "rough":
            return irregular_body("rough", 14.0, stream(SEED, 34))
        case "plain sphere":
            return replace(sphere(), contrast=0.0, grey=BLACK_NYLON)
        case "plain cube":
            return replace(cube(), contrast=0.0, grey=BLACK_NYLON)
        case _:
            return replace(cube(), contrast=0.2)


@kept_rendered
def exposed(name: str) -> tuple[FrameBundle, trimesh.Trimesh]:
    placed = tumble(body(name), rig(), stream(SEED, 32, BODIES.index(name)))
    bundle = render_bundle([placed], simulated(), stream(SEED, 33, BODIES.index(name)), sequence=1)
    return bundle, placed.world_mesh


@dataclass(frozen=True, kw_only=True)
class Case:
    bundle: FrameBundle
    truth: trimesh.Trimesh
    result: ParticleResult
    views: PreparedViews
    estimate: BodyEstimate
    refinement: Refinement

    def distances(self, mesh: ParticleMesh) -> SurfaceDistances:
        own = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
        return surface_distances(own, Surface(self.truth), np.random.default_rng(0))

    def volume_percent(self, mesh: ParticleMesh) -> float:
        return 100 * (solid_of(mesh.vertices_mm, mesh.faces).volume_mm3 / self.truth.volume - 1)


@cache
def case(name: str) -> Case:
    bundle, truth = exposed(name)
    result = measure_bundle(bundle, rig(), background(), BackgroundSegmenter(), PHOTO)
    assert result.hull is not None
    views = prepare_views(result.silhouettes, rig(), result.dropped).with_outline()
    estimate = estimate_body(result.hull, views)
    refinement = refine_body(estimate, result.hull, bundle.frames, views, background())
    return Case(
        bundle=bundle, truth=truth, result=result, views=views, estimate=estimate, refinement=refinement
    )


def test_dents_are_found():
    dented = case("dented")
    before, after = (dented.distances(each.mesh) for each in (dented.estimate, dented.refinement))
    assert before.mean_mm > 0.03
    assert after.mean_mm < 0.02
    assert after.back_mean_mm < 0.02
    assert dented.volume_percent(dented.estimate.mesh) > 1.5
    assert abs(dented.volume_percent(dented.refinement.mesh)) < 0.5
    assert dented.refinement.support.share > 0.9


def test_the_estimates_edges_do_not_stand_out_of_a_rough_body():
    rough = case("rough")
    before, after = (rough.distances(each.mesh) for each in (rough.estimate, rough.refinement))
    assert before.signed_mm > 0.05
    assert abs(after.signed_mm) < 0.008
    assert after.mean_mm < 0.5 * before.mean_mm


@pytest.mark.parametrize("name", first_quick(["plain sphere", "plain cube"]))
def test_what_shows_no_texture_stays_as_estimated(name: str):
    plain = case(name)
    before, after = (plain.distances(each.mesh) for each in (plain.estimate, plain.refinement))
    assert after.mean_mm < before.mean_mm + 0.002
    assert plain.volume_percent(plain.refinement.mesh) == pytest.approx(
        plain.volume_percent(plain.estimate.mesh), abs=0.05
    )
    assert plain.refinement.support.share < 0.05


@pytest.mark.full
def test_sharp_edges_stay_sharp():
    mottled = case("mottled cube")
    before, after = (mottled.distances(each.mesh) for each in (mottled.estimate, mottled.refinement))
    assert after.max_mm < before.max_mm + 0.06
    assert after.back_max_mm < before.back_max_mm + 0.06
    assert after.mean_mm < before.mean_mm + 0.005


@pytest.mark.parametrize("name", first_quick(BODIES))
def test_the_refined_body_is_closed_within_the_hull_and_does_not_cross_itself(name: str):
    any_body = case(name)
    mesh, hull = any_body.refinement.mesh, any_body.result.hull
    assert hull is not None
    own = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    assert own.is_watertight
    assert own.is_winding_consistent
    assert not crossing_vertices(mesh.vertices_mm, mesh.faces).any()
    outside_mm = Surface(trimesh.Trimesh(hull.vertices_mm, hull.faces, process=False)).signed_distances_mm(
        mesh.vertices_mm
    )
    assert outside_mm.max() < 0.01


def test_the_same_images_give_the_same_body():
    dented = case("dented")
    assert dented.result.hull is not None
    again = refine_body(dented.estimate, dented.result.hull, dented.bundle.frames, dented.views, background())
    np.testing.assert_array_equal(again.mesh.vertices_mm, dented.refinement.mesh.vertices_mm)


def test_the_record_says_how_much_of_the_surface_the_pixels_show():
    measurement = case("dented").result.measurement
    assert measurement is not None
    assert measurement.body == "photo"
    assert measurement.supported_share == case("dented").refinement.support.share
    assert abs(100 * (measurement.volume_mm3 / case("dented").truth.volume - 1)) < 0.5
    assert measurement.volume_sd_percent < 1.5
    plain = case("plain sphere").result.measurement
    assert plain is not None
    assert (plain.body, plain.supported_share) == ("estimate", 0.0)
    assert plain.refinement_fallback == "no texture that the views share"
