"""Irregular bodies have the size and form they are asked for, and their images cover what rays hit."""

import numpy as np
import pytest
from support import rendered
from support.extents import first_quick

from pipeline.evaluation.trials import random_body
from pipeline.measuring import measure_shape
from pipeline.synthesis.irregular_bodies import IRREGULAR_FORMS, irregular_body
from pipeline.synthesis.pixel_coverage import coverage, mesh_edges, silhouette_edges, window_around
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.shading import embree_scene


@pytest.mark.parametrize("form", first_quick(IRREGULAR_FORMS))
def test_forms(form: str) -> None:
    bodies = [irregular_body(form, 20.0, np.random.default_rng(seed)) for seed in (1, 2)]
    assert bodies[0].mesh.volume != pytest.approx(bodies[1].mesh.volume, rel=1e-3)
    shape = measure_shape(bodies[0].mesh.vertices, bodies[0].mesh.faces)
    assert shape.max_feret_mm == pytest.approx(20.0, rel=1e-3)
    np.testing.assert_allclose(bodies[0].mesh.center_mass, 0, atol=1e-6)
    if form == "splinter":
        assert shape.convexity > 0.995
    else:
        assert shape.convexity < 0.985


@pytest.mark.parametrize("form", ["horseshoe", "rough"])
def test_the_image_of_a_body_that_is_not_star_shaped(form: str) -> None:
    """The covered pixels are those that rays hit: bodies need not be star-shaped to be rendered."""
    rng = np.random.default_rng(5)
    body = irregular_body(form, 20.0, rng)
    mesh = tumble(body, rendered.rig(), rng).world_mesh
    for camera in rendered.rig().cameras[::5]:
        pixels_uv, _ = camera.project(mesh.vertices)
        window = window_around(pixels_uv, 2)
        is_front = np.einsum("ij,ij->i", mesh.face_normals, camera.center_mm - mesh.triangles[:, 0]) > 0
        edges = pixels_uv[silhouette_edges(mesh_edges(mesh.faces), is_front)]
        covered = coverage(edges[:, 0], edges[:, 1], window)
        u, v = np.meshgrid(window.left + np.arange(window.width), window.top + np.arange(window.height))
        rays = camera.rays(np.stack([u, v], axis=-1).reshape(-1, 2)).astype(np.float32)
        origins = np.broadcast_to(camera.center_mm.astype(np.float32), rays.shape)
        is_hit = embree_scene(mesh).run(np.ascontiguousarray(origins), rays).reshape(u.shape) >= 0
        assert np.array_equal(is_hit[covered > 0.999], np.ones_like(is_hit[covered > 0.999]))
        assert not is_hit[covered < 0.001].any()
        assert covered.sum() == pytest.approx(is_hit.sum(), rel=1e-3)


def test_random_bodies_follow_name_number_and_seed() -> None:
    first = random_body("tromino", 3, 1)
    assert np.array_equal(first.mesh.vertices, random_body("tromino", 3, 1).mesh.vertices)
    others = [random_body("tromino", 4, 1), random_body("tromino", 3, 2), random_body("angular", 3, 1)]
    assert all(first.mesh.volume != pytest.approx(other.mesh.volume) for other in others)
