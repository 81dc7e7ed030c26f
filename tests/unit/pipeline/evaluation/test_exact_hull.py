"""Exact hulls against analytic and polyhedral ones."""

from typing import Literal

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, HalfspaceIntersection
from scipy.spatial.transform import Rotation
from support.extents import first_quick
from support.forms import silhouettes_of

from pipeline.carving import CarvingParameters, carve
from pipeline.evaluation.exact_hull import exact_hull_mesh, polar_outline, star_center_mm
from pipeline.evaluation.surface_distances import Surface, even_samples, surface_distances
from pipeline.measuring import sphere_hull_excess
from pipeline.meshing import mesh_hull
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.irregular_bodies import irregular_body
from pipeline.views.prepared import prepare_views

NOMINAL = nominal_rig()
BUILT = as_built(NOMINAL, seed=1)
SPHERE = trimesh.creation.icosphere(subdivisions=5, radius=7.5)
CUBE = trimesh.creation.box([15, 15, 15])
CYLINDER = trimesh.creation.cylinder(radius=7.5, height=15, sections=128)


def posed(mesh: trimesh.Trimesh, seed: int) -> tuple[trimesh.Trimesh, NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    center_mm = rng.uniform(-2, 2, size=3)
    rotation = Rotation.random(rng=rng).as_matrix()
    return trimesh.Trimesh(mesh.vertices @ rotation.T + center_mm, mesh.faces, process=False), center_mm


def polyhedral_hull_volume(corners_mm: NDArray[np.float64], rig: RigCalibration) -> float:
    """Return the volume of a convex body's visual hull, the intersection of all planes that touch it from a camera."""
    planes = []
    for camera in rig.cameras:
        rays = (corners_mm - camera.center_mm) @ camera.R.T
        outline = rays[ConvexHull(rays[:, :2] / rays[:, 2:]).vertices] @ camera.R
        normals = np.cross(np.roll(outline, -1, axis=0), outline)
        offsets = -normals @ camera.center_mm
        planes.append(np.column_stack([normals, offsets]))
    hull = HalfspaceIntersection(np.concatenate(planes), corners_mm.mean(axis=0))
    return float(ConvexHull(hull.intersections).volume)


def test_floor_of_the_sphere() -> None:
    hull = exact_hull_mesh(SPHERE, np.zeros(3), NOMINAL)
    centers_mm = [camera.center_mm for camera in NOMINAL.cameras]
    # both meshes are inscribed, so their chords cancel
    assert hull.volume / SPHERE.volume == pytest.approx(
        sphere_hull_excess(centers_mm, np.zeros(3), 7.5), abs=5e-4
    )
    distances = surface_distances(hull, Surface(SPHERE), np.random.default_rng(0), 5000)
    assert distances.mean_mm == pytest.approx(0.0185, abs=1e-3)
    assert 0.25 < distances.max_mm < 0.34  # the spikes at the poles
    assert distances.signed_mm == pytest.approx(distances.mean_mm, abs=1e-3)


@pytest.mark.parametrize("rig", [NOMINAL, BUILT], ids=["nominal", "built"])
@pytest.mark.parametrize("body", [CUBE, CYLINDER], ids=["cube", "cylinder"])
def test_volume_of_a_convex_body_against_its_polyhedral_hull(
    body: trimesh.Trimesh, rig: RigCalibration
) -> None:
    for seed in range(2):
        mesh, center_mm = posed(body, seed)
        hull = exact_hull_mesh(mesh, center_mm, rig)
        expected = polyhedral_hull_volume(np.asarray(mesh.vertices), rig)
        assert hull.volume == pytest.approx(expected, rel=1.5e-3)
        assert 1.005 < hull.volume / mesh.volume < 1.3


def test_mean_floors_of_cube_and_cylinder() -> None:
    """About 0.26 and 0.10 mm over random poses; single poses vary by a factor of five."""
    rng = np.random.default_rng(0)
    for body, low, high in [(CUBE, 0.17, 0.32), (CYLINDER, 0.07, 0.14)]:
        means_mm = []
        for seed in range(4):
            mesh, center_mm = posed(body, seed)
            hull = exact_hull_mesh(mesh, center_mm, NOMINAL, subdivisions=5)
            distances = surface_distances(hull, Surface(mesh), rng, 1000)
            assert distances.signed_mm == pytest.approx(distances.mean_mm, rel=0.05), (
                "a hull contains its body"
            )
            means_mm.append(distances.mean_mm)
        assert low < np.mean(means_mm) < high


def test_distortion_does_not_matter_because_every_view_agrees() -> None:
    """Through the lenses: no camera sees the hull beyond the body, each hull point is on a silhouette."""
    body, center_mm = posed(SPHERE, 3)
    hull = exact_hull_mesh(body, center_mm, BUILT, subdivisions=4)
    assert any(camera.distortion.any() for camera in BUILT.cameras)
    beyond_px = []
    for camera in BUILT.cameras:
        outline = ConvexHull(camera.project(body.vertices)[0])
        seen = camera.project(hull.vertices)[0]
        beyond_px.append((seen @ outline.equations[:, :2].T + outline.equations[:, 2]).max(axis=1))
    np.testing.assert_allclose(np.max(beyond_px, axis=0), 0, atol=0.05)


def test_hull_of_a_dented_body_against_rays() -> None:
    """Just inside the hull every camera's ray meets the body, just outside one of them passes it."""
    body = SPHERE.copy()
    x, y, z = (np.asarray(body.vertices) / 7.5).T
    body.vertices *= (1 + 0.1 * np.sin(5 * x) + 0.1 * np.cos(4 * y) - 0.2 * np.exp(-((z / 0.3) ** 2)))[
        :, None
    ]
    hull = exact_hull_mesh(body, np.zeros(3), BUILT, subdivisions=4)
    assert 1.02 * body.volume < hull.volume < 0.98 * body.convex_hull.volume

    def seen_by_all(points_mm: NDArray[np.float64]) -> NDArray[np.bool_]:
        views = [
            body.ray.intersects_any(
                np.broadcast_to(camera.center_mm, points_mm.shape), points_mm - camera.center_mm
            )
            for camera in BUILT.cameras
        ]
        return np.all(views, axis=0)

    assert seen_by_all(hull.vertices * 0.998).mean() > 0.999
    assert seen_by_all(hull.vertices * 1.002).mean() < 0.001


@pytest.mark.parametrize("body", first_quick([SPHERE, CUBE, CYLINDER]), ids=["sphere", "cube", "cylinder"])
def test_the_sub_voxel_field_is_nearer_to_the_exact_hull_than_the_paper_s(body: trimesh.Trimesh) -> None:
    mesh, center_mm = posed(body, 1)
    floor = Surface(exact_hull_mesh(mesh, center_mm, BUILT))
    silhouettes = silhouettes_of(mesh, BUILT, np.random.default_rng(1))

    def off_mm(field: Literal["sub_voxel", "view_count"]) -> float:
        hull = mesh_hull(carve(prepare_views(silhouettes, BUILT), CarvingParameters(field=field)))
        assert hull is not None
        surface = trimesh.Trimesh(hull.vertices_mm, hull.faces, process=False)
        samples_mm = even_samples(surface, 1500, np.random.default_rng(2))
        return float(np.abs(floor.signed_distances_mm(samples_mm)).mean())

    assert off_mm("sub_voxel") < 0.01
    assert off_mm("view_count") > 0.02


def test_outline_of_a_square() -> None:
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], dtype=float)
    segments = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    segments[::2] = segments[::2, ::-1]  # sense does not matter
    segments = np.concatenate([segments, 0.3 * segments])  # nor what lies inside
    outline = polar_outline(segments)
    angle = np.arange(len(outline)) * 2 * np.pi / len(outline)
    expected = 1 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
    np.testing.assert_allclose(outline, expected, rtol=1e-12)


def test_a_center_outside_the_body_is_refused() -> None:
    with pytest.raises(ValueError, match="outside"):
        exact_hull_mesh(SPHERE, np.array([20.0, 0, 0]), NOMINAL, subdivisions=2)


def test_star_center() -> None:
    moved = CUBE.copy()
    moved.apply_translation([3, 4, 5])
    np.testing.assert_allclose(star_center_mm(moved), [3, 4, 5], atol=1e-6)
    horseshoe = irregular_body("horseshoe", 20.0, np.random.default_rng(0))
    assert star_center_mm(horseshoe.mesh) is None


def test_every_point_of_an_l_is_seen_from_its_corner_alone() -> None:
    tromino = irregular_body("tromino", 20.0, np.random.default_rng(1)).mesh
    center_mm = star_center_mm(tromino)
    assert center_mm is not None
    seen_from = np.einsum("ij,ij->i", tromino.triangles_center - center_mm, tromino.face_normals)
    assert seen_from.min() > 0
    seen_from = np.einsum("ij,ij->i", tromino.triangles_center - tromino.center_mass, tromino.face_normals)
    assert seen_from.min() < 0, "not from its centre of mass: the search was needed"
