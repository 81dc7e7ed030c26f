"""Grey values of vertices: the stone's own, whatever the light, the pose and the state of single views."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from support.extents import examples
from support.render_cache import kept_rendered
from support.rendered import SEED, background, rig, simulated

from pipeline.arrays import Greys, Values
from pipeline.body_measurement import BodyKind
from pipeline.estimate import estimate_body
from pipeline.frames import Frame, FrameBundle
from pipeline.meshing import ParticleMesh
from pipeline.particle import BodyParameters, ParticleResult, PipelineParameters, measure_bundle
from pipeline.refinement import photo_views, sightings, texture, vertex_greys, warm_up_texture
from pipeline.segmentation.subtraction import BackgroundSegmenter
from pipeline.synthesis import shading
from pipeline.synthesis.bundles import render_bundle, stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.renderer import PlacedBody
from pipeline.synthesis.stones import stone
from pipeline.views.prepared import PreparedViews, prepare_views

POSES = (0, 1)
NEAR = 20
"""Faces whose mean is what a vertex shows: they are finer than the pixels."""


@dataclass(frozen=True, kw_only=True)
class Exposed:
    """A stone of strong texture in one of two poses; its texture is the same in both."""

    bundle: FrameBundle
    placed: PlacedBody
    albedo: Values  # of its faces


@kept_rendered
def exposed(pose: int) -> Exposed:
    body = replace(stone("angular", 16.0, stream(SEED, 41)), contrast=0.35)
    placed = tumble(body, rig(), stream(SEED, 42, pose))
    return Exposed(
        bundle=render_bundle([placed], simulated(), stream(SEED, 43), sequence=1),
        placed=placed,
        albedo=shading.texture(body, stream(SEED, 43)),  # the first that is drawn for the bundle
    )


@cache
def measured(kind: BodyKind, pose: int = 0, texture: bool | None = None) -> ParticleResult:
    parameters = PipelineParameters(body=BodyParameters(kind, texture))
    return measure_bundle(exposed(pose).bundle, rig(), background(), BackgroundSegmenter(), parameters)


def greys_of(result: ParticleResult) -> tuple[ParticleMesh, Greys]:
    assert result.mesh is not None
    assert result.greys is not None
    return result.mesh, result.greys


def albedo_at(mesh: ParticleMesh, stone_: Exposed) -> Values:
    _, near = cKDTree(stone_.placed.world_mesh.triangles_center).query(mesh.vertices_mm, k=NEAR)
    return np.asarray(stone_.albedo[near].mean(axis=1))


def correlation(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.corrcoef(one.astype(float), other.astype(float))[0, 1])


@pytest.mark.parametrize("kind", ["photo", "estimate"])
def test_greys_are_those_of_the_stone_in_even_light(kind: BodyKind):
    mesh, greys = greys_of(measured(kind, texture=True))
    albedo = albedo_at(mesh, exposed(0))
    assert greys.dtype == np.uint8
    assert greys.shape == (len(mesh.vertices_mm),)
    assert correlation(greys, albedo) > 0.82
    assert greys.mean() == pytest.approx(albedo.mean(), rel=0.1)
    assert greys.std() > 0.7 * albedo.std()


def test_the_shade_is_divided_out():
    """The light is a third brighter from above: greys of top and bottom differ by what the stone's do."""
    mesh, greys = greys_of(measured("photo"))
    up = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).vertex_normals[:, 2]
    ratio = greys / albedo_at(mesh, exposed(0))
    assert ratio[up > 0.7].mean() / ratio[up < -0.7].mean() == pytest.approx(1.0, abs=0.12)


def test_a_stone_looks_the_same_in_another_pose():
    points_mm, greys = [], []
    for pose in POSES:
        mesh, of_pose = greys_of(measured("photo", pose))
        placed = exposed(pose).placed
        points_mm.append((mesh.vertices_mm - placed.offset_mm) @ placed.R)
        greys.append(of_pose)
    _, near = cKDTree(points_mm[1]).query(points_mm[0])
    assert correlation(greys[0], greys[1][near]) > 0.9


def changed(gains: Mapping[str, float], missing: tuple[str, ...] = ()) -> tuple[Greys, Greys]:
    """The greys of a mesh, and those of the same mesh when some views are darker, brighter or missing."""
    result, frames = measured("photo"), exposed(0).bundle.frames
    mesh, greys = greys_of(result)
    other = {camera: _with_gain(frame, gains.get(camera, 1.0)) for camera, frame in frames.items()}
    assert result.hull is not None
    estimate = estimate_body(
        result.hull, _views(result)
    )  # as its refinement, by which the images are cut out
    again = vertex_greys(mesh, photo_views(other, _views(result, missing), estimate.mesh.vertices_mm))
    assert again is not None
    assert again.shape == greys.shape
    return greys, again


def _with_gain(frame: Frame, gain: float) -> Frame:
    return replace(frame, image=np.clip(np.rint(frame.image * gain), 0, 255).astype(np.uint8))


def _views(result: ParticleResult, missing: tuple[str, ...] = ()) -> PreparedViews:
    kept = {camera: seen for camera, seen in result.silhouettes.items() if camera not in missing}
    return prepare_views(kept, rig(), result.dropped).with_outline()


@pytest.mark.parametrize("gains", [{"c03": 0.4}, {"c03": 1.8, "c12": 0.6}], ids=str)
def test_a_view_of_another_brightness_shows_the_same_stone(gains: Mapping[str, float]):
    greys, again = changed(gains)
    assert np.abs(again.astype(int) - greys).mean() < 1
    assert correlation(greys, again) > 0.99


def test_what_is_overexposed_counts_for_nothing_beside_the_others():
    greys, again = changed({"c03": 12.0})
    assert np.abs(again.astype(int) - greys).mean() < 1.5
    assert correlation(greys, again) > 0.97


@pytest.mark.parametrize("missing", [("c05",), ("c02", "c05", "c08", "c15")])
def test_the_other_views_make_up_for_missing_ones(missing: tuple[str, ...]):
    greys, again = changed({}, missing)
    assert correlation(greys, again) > 0.99


def test_what_no_view_shows_has_the_grey_of_what_is_next_to_it():
    everywhere, again = changed(
        {}, tuple(camera for camera in rig().camera_ids if camera not in ("c01", "c02"))
    )
    assert 0.5 * everywhere.min() < again.min() <= again.max() < 1.5 * everywhere.max()
    mesh, _ = greys_of(measured("photo"))
    nothing = photo_views(exposed(0).bundle.frames, _views(measured("photo")), mesh.vertices_mm)
    assert vertex_greys(mesh, nothing._replace(is_inner=np.zeros_like(nothing.is_inner))) is None


def test_the_same_images_give_the_same_greys_and_all_other_figures_are_those_without():
    greys, again = changed({})
    np.testing.assert_array_equal(again, greys)
    bare = measured("photo", texture=False)
    assert bare.greys is None
    assert bare.measurement == measured("photo").measurement


def test_only_a_refined_body_is_textured_unless_it_is_said_otherwise():
    assert [BodyParameters(kind).is_textured for kind in ("photo", "estimate", "hull")] == [
        True,
        False,
        False,
    ]
    assert [BodyParameters("hull", texture).is_textured for texture in (True, False)] == [True, False]
    assert measured("estimate").greys is None


@examples(0.5)
@given(n=st.integers(3, 60), seed=st.integers(0, 1000))
def test_each_vertex_takes_the_nearest_seed_along_edges(n: int, seed: int):
    """On a strip of triangles, where a vertex is two edges from the next but one."""
    faces = np.array([[i, i + 1, i + 2] for i in range(n - 2)])
    rng = np.random.default_rng(seed)
    seeds = np.flatnonzero(rng.random(n) < 0.2)
    seeds = seeds if len(seeds) else np.array([n - 1])
    edges = np.ceil(np.abs(np.arange(n)[:, None] - seeds) / 2)
    owners = texture._nearest(faces, seeds, n)
    np.testing.assert_array_equal(edges[np.arange(n), owners], edges.min(axis=1))


def test_after_the_warm_up_nothing_is_left_to_compile():
    kernels = [
        value
        for module in (texture, sightings)
        for value in vars(module).values()
        if hasattr(value, "signatures")
    ]
    assert warm_up_texture() is not None
    compiled = [kernel.signatures for kernel in kernels]
    assert sum(map(bool, compiled)) >= 4
    changed({})
    assert [kernel.signatures for kernel in kernels] == compiled
