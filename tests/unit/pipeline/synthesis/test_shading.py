from dataclasses import replace

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from support.extents import first_quick
from support.synthetic_rigs import QUIET, rig_of, upright

from pipeline.frames import CameraId
from pipeline.synthesis import shading
from pipeline.synthesis.bodies import Body, SurfaceKind, sphere
from pipeline.synthesis.irregular_bodies import irregular_body
from pipeline.synthesis.renderer import PlacedBody, illuminate, photograph, simulate_rig

C05 = CameraId("c05")


@pytest.fixture(scope="module")
def dented() -> Body:
    return irregular_body("dented", 20.0, np.random.default_rng(3))


def image_of(body: Body) -> np.ndarray:
    rig = simulate_rig(rig_of("c05", binning=2), np.random.default_rng(0), QUIET)
    return photograph([upright(body)], rig, np.random.default_rng(1))[C05].astype(float)


@pytest.mark.full
def test_even_light_is_that_of_random_rays_without_their_noise(dented: Body) -> None:
    scene = shading.embree_scene(dented.mesh)
    even = shading.even_irradiance(dented.mesh, scene)
    noisy = shading.irradiance(dented.mesh, scene, np.random.default_rng(0))
    assert even.mean() == pytest.approx(noisy.mean(), abs=0.002)
    assert (even - noisy).std() < 0.1
    ball = sphere().mesh
    light = shading.even_irradiance(ball, shading.embree_scene(ball))
    # of a convex body: linear in the height of the normal
    np.testing.assert_allclose(light, 1 + 2 / 3 * shading.DOME_GRADIENT * ball.face_normals[:, 2], atol=0.01)


def test_a_face_without_area_is_dark() -> None:
    ball = sphere().mesh
    flat = trimesh.Trimesh(ball.vertices, np.vstack([ball.faces, [[0, 0, 1]]]), process=False)
    light = shading.even_irradiance(flat, shading.embree_scene(flat))
    assert light[-1] == 0
    assert light[:-1].min() > 0.7


@pytest.mark.full
def test_faces_that_hide_the_dome_send_their_own_light(dented: Body) -> None:
    scene = shading.embree_scene(dented.mesh)
    dark = shading.even_irradiance(dented.mesh, scene)
    lit = shading.even_irradiance(dented.mesh, scene, 60.0)
    hidden = 1 - shading.even_irradiance(dented.mesh, scene) / (
        1 + 2 / 3 * shading.DOME_GRADIENT * dented.mesh.face_normals[:, 2]
    )
    assert (lit >= dark).all()
    assert (lit - dark)[hidden < 0.001].max() < 0.01
    assert (lit - dark).max() > 0.2 * 60.0 / shading.WALL_GREY, "in the depth of a dent"


@pytest.mark.parametrize("surface", first_quick(SurfaceKind))
def test_only_textures_have_fine_detail(surface: SurfaceKind) -> None:
    image = image_of(replace(sphere(), surface=surface, contrast=0.2))
    inside = image[216:296, 280:360]
    detail = inside - cv2.GaussianBlur(inside, (0, 0), 8.0)
    if surface is SurfaceKind.PLAIN:
        assert detail.std() < 0.5, "no more than rounding"
    else:
        assert detail.std() > 2.0


@pytest.mark.full
def test_crystals_turn_and_move_with_the_body() -> None:
    granite = replace(sphere(), surface=SurfaceKind.GRANITE, contrast=0.25)
    R, offset_mm = Rotation.random(rng=np.random.default_rng(2)).as_matrix(), np.array([1.0, 2.0, -3.0])
    faces = np.arange(0, len(granite.mesh.faces), 50)
    relative = []
    for placed in (upright(granite), PlacedBody(body=granite, R=R, offset_mm=offset_mm)):
        lit = illuminate(placed, np.random.default_rng(1))
        assert lit.grain is not None
        relative.append(
            lit.grain.radiance(faces, lit.mesh.triangles_center[faces]) / lit.face_radiance[faces]
        )
    assert np.std(relative[0]) > 0.1
    np.testing.assert_allclose(*relative, atol=1e-6)


@pytest.mark.full
def test_a_wet_surface_mirrors_its_own_faces_where_they_hide_the_dome(dented: Body) -> None:
    scene, camera = shading.embree_scene(dented.mesh), rig_of("c05").cameras[0]
    no_lamps, black = np.empty((0, 3)), np.zeros(len(dented.mesh.faces))
    alone = shading.reflection(dented.mesh, scene, no_lamps, camera)
    mirrored = shading.reflection(dented.mesh, scene, no_lamps, camera, black)
    shows_body = mirrored == 0
    assert np.array_equal(mirrored[~shows_body], alone[~shows_body])
    # of the faces that see the camera; rays of the others begin inside the body
    faces_camera = (dented.mesh.face_normals * (camera.center_mm - dented.mesh.triangles_center)).sum(
        axis=1
    ) > 0
    assert 0.005 < shows_body[faces_camera].mean() < 0.3
