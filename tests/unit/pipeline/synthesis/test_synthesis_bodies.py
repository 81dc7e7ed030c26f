import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist
from support.extents import first_quick

from pipeline.errors import MeshError
from pipeline.frames import BundleKind
from pipeline.synthesis.bodies import Body, ball, body_from_mesh, cube, cylinder, sphere
from pipeline.synthesis.stones import STONE_FORMS, random_size_mm, stone

VOLUMES_MM3 = [
    (ball(), np.pi / 6 * 10**3),
    (sphere(), np.pi / 6 * 15**3),
    (cylinder(), np.pi / 4 * 15**3),
    (cube(), 15**3),
]


def assert_photographable(body: Body) -> None:
    mesh = body.mesh
    assert mesh.is_volume
    assert np.linalg.norm(mesh.center_mass) < 1e-9
    outward = np.einsum("ij,ij->i", mesh.triangles_center, mesh.face_normals)
    assert outward.min() > 0, "not star-shaped about its centre of mass"


@pytest.mark.parametrize(("body", "volume_mm3"), VOLUMES_MM3, ids=lambda value: getattr(value, "name", ""))
def test_standards_have_the_volume_of_their_formula(body: Body, volume_mm3: float) -> None:
    assert_photographable(body)
    assert body.mesh.volume == pytest.approx(volume_mm3, rel=1e-9)
    assert body.kind is (BundleKind.BALL if body.name == "ball" else BundleKind.PARTICLE)


def test_facets_stay_within_2_um_of_the_ideal_surface() -> None:
    radii_mm = np.linalg.norm(sphere().mesh.triangles_center, axis=1)
    assert np.abs(radii_mm - 7.5).max() < 0.002
    assert abs(sphere().radius_mm - 7.5) < 0.002
    side = cylinder().mesh.vertices
    side = side[np.abs(side[:, 2]) < 7.4]
    assert np.abs(np.hypot(side[:, 0], side[:, 1]) - 7.5).max() < 0.002


@pytest.mark.parametrize("form", first_quick(STONE_FORMS))
def test_stones_are_closed_bodies_of_their_size_and_class(form: str) -> None:
    body = stone(form, 20.0, np.random.default_rng(5))
    assert_photographable(body)
    assert 20_000 <= len(body.mesh.faces) <= 40_000
    corners_mm = body.mesh.vertices[ConvexHull(body.mesh.vertices).vertices]
    assert pdist(corners_mm).max() == pytest.approx(20.0, rel=1e-9)
    assert 0.93 < body.mesh.volume / body.mesh.convex_hull.volume < 0.9999, "neither smooth nor shredded"

    long, wide, thick = body.mesh.extents
    assert (wide / long < 0.6) == (form == "elongated")
    assert (thick / wide < 0.6) == (form == "flaky")


def test_a_stone_is_given_by_its_seed() -> None:
    first, same, other = (stone("angular", 20.0, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(first.mesh.vertices, same.mesh.vertices)
    assert np.abs(first.mesh.vertices - other.mesh.vertices).max() > 0.5


def test_sizes_are_mostly_between_8_and_30_mm() -> None:
    rng = np.random.default_rng(0)
    sizes_mm = np.array([random_size_mm(rng) for _ in range(500)])
    assert sizes_mm.min() >= 5
    assert sizes_mm.max() <= 40
    assert 0.7 < ((sizes_mm >= 8) & (sizes_mm <= 30)).mean() < 0.9
    assert sizes_mm.min() < 8 and sizes_mm.max() > 30


def test_a_foreign_mesh_is_centred_and_turned_outside_out() -> None:
    mesh = trimesh.creation.box(extents=[4, 6, 8])
    mesh.apply_translation([100, 0, 0])
    mesh.invert()
    body = body_from_mesh("brick", mesh)
    assert_photographable(body)
    assert body.mesh.volume == pytest.approx(192)


def test_an_open_mesh_is_refused() -> None:
    mesh = trimesh.creation.box()
    mesh.update_faces(np.arange(11))
    with pytest.raises(MeshError, match="not closed"):
        body_from_mesh("open", mesh)
