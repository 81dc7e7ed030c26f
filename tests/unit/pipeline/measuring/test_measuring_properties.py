"""What holds for every body, whatever its form."""

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from skimage.measure import marching_cubes
from support.extents import examples

from pipeline.errors import MeshError
from pipeline.measuring import ShapeMeasurement, measure_shape
from pipeline.measuring.calipers import NEAR, least_width_within_mm
from pipeline.measuring.solid import solid_of

LENGTHS = (
    "length_mm",
    "width_mm",
    "thickness_mm",
    "max_feret_mm",
    "min_feret_mm",
    "sieve_size_mm",
    "equivalent_diameter_mm",
)
RATIOS = ("sphericity", "convexity")


def measured(mesh: trimesh.Trimesh) -> ShapeMeasurement:
    return measure_shape(mesh.vertices, mesh.faces)


@st.composite
def polyhedra(draw: st.DrawFn) -> trimesh.Trimesh:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    points = rng.normal(size=(draw(st.integers(8, 60)), 3)) * rng.uniform(3, 12, size=3)
    return trimesh.convex.convex_hull(points)


def assert_scaled(one: ShapeMeasurement, other: ShapeMeasurement, scale: float) -> None:
    assert other.volume_mm3 == pytest.approx(one.volume_mm3 * scale**3, rel=1e-9)
    assert other.surface_area_mm2 == pytest.approx(one.surface_area_mm2 * scale**2, rel=1e-9)
    # boxes of other edges may have nearly the same volume
    assert np.prod(other.min_box_mm) == pytest.approx(np.prod(one.min_box_mm) * scale**3, rel=1e-3)
    for name in LENGTHS:
        assert getattr(other, name) == pytest.approx(getattr(one, name) * scale, rel=1e-3), name
    for name in RATIOS:
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=2e-3), name


@examples(0.25)
@given(mesh=polyhedra(), scale=st.floats(0.01, 100))
def test_scaling(mesh: trimesh.Trimesh, scale: float) -> None:
    scaled = trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False)
    assert_scaled(measured(mesh), measured(scaled), scale)


@examples(0.25)
@given(mesh=polyhedra(), seed=st.integers(0, 2**32 - 1))
def test_pose_does_not_matter(mesh: trimesh.Trimesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(rng=rng).as_matrix()
    shift_mm = rng.uniform(-100, 100, size=3)
    posed = trimesh.Trimesh(mesh.vertices @ rotation.T + shift_mm, mesh.faces, process=False)

    before, after = measured(mesh), measured(posed)

    assert_scaled(before, after, 1.0)
    np.testing.assert_allclose(after.center_mm, rotation @ before.center_mm + shift_mm, atol=1e-9)


@examples(0.25)
@given(mesh=polyhedra())
def test_order_of_the_lengths(mesh: trimesh.Trimesh) -> None:
    shape = measured(mesh)
    a, b, c = shape.min_box_mm
    assert shape.length_mm == shape.max_feret_mm
    assert shape.length_mm >= shape.width_mm >= shape.thickness_mm >= shape.min_feret_mm > 0
    assert shape.max_feret_mm >= a >= b >= c >= shape.min_feret_mm
    assert shape.min_feret_mm <= shape.sieve_size_mm <= b * (1 + 1e-4)
    assert shape.equivalent_diameter_mm <= shape.max_feret_mm
    assert a * b * c >= shape.volume_mm3
    assert 0 < shape.sphericity <= 1
    assert 0 < shape.convexity <= 1


@examples(0.1)
@given(mesh=polyhedra(), seed=st.integers(0, 2**32 - 1))
def test_no_random_rotation_beats_the_searches(mesh: trimesh.Trimesh, seed: int) -> None:
    shape = measured(mesh)
    axes = Rotation.random(20_000, rng=np.random.default_rng(seed)).as_matrix()
    heights = axes.reshape(-1, 3) @ mesh.vertices.T
    widths = np.sort(np.ptp(heights, axis=1).reshape(-1, 3), axis=1)
    assert shape.min_feret_mm <= widths.min() * (1 + 1e-4)
    # the two least of three orthogonal widths are the sides of a hole
    assert shape.sieve_size_mm <= widths[:, 1].min() * (1 + 1e-4)
    assert np.prod(shape.min_box_mm) <= widths.prod(axis=1).min() * (1 + 1e-4)
    assert shape.max_feret_mm >= widths.max()


@examples(0.1)
@given(mesh=polyhedra())
def test_greatest_distance_of_two_vertices_is_the_max_feret(mesh: trimesh.Trimesh) -> None:
    distances = np.linalg.norm(mesh.vertices[:, None] - mesh.vertices[None], axis=2)
    assert measured(mesh).max_feret_mm == pytest.approx(distances.max(), rel=1e-12)


def voxel_ellipsoid(*axes: float, pitch: float, noise: float) -> trimesh.Trimesh:
    """An ellipsoid as carving leaves it: marching cubes on a noisy distance field."""
    half = [np.arange(-edge / 2 - 2 * pitch, edge / 2 + 3 * pitch, pitch) for edge in axes]
    points = np.stack(np.meshgrid(*half, indexing="ij"), axis=-1)
    semi = np.array(axes) / 2
    reach = np.linalg.norm(points / semi, axis=-1)
    gradient = np.linalg.norm(points / semi**2, axis=-1) / np.maximum(reach, 1e-9)
    field = (reach - 1) / np.maximum(gradient, 1e-9)  # mm, to first order
    field += np.random.default_rng(0).normal(scale=noise, size=field.shape)
    vertices, faces, _, _ = marching_cubes(-field, 0.0, spacing=(pitch,) * 3)
    return trimesh.Trimesh(vertices, faces, process=False)


def test_noisy_voxel_mesh() -> None:
    mesh = voxel_ellipsoid(12, 15, 20, pitch=0.25, noise=0.01)
    shape = measured(mesh)
    assert shape.volume_mm3 == pytest.approx(1884.96, rel=5e-3)
    assert shape.min_box_mm == pytest.approx((20, 15, 12), abs=0.1)
    assert shape.min_feret_mm == pytest.approx(12, abs=0.08)
    assert shape.max_feret_mm == pytest.approx(20, abs=0.08)
    assert shape.sieve_size_mm == pytest.approx(13.583, abs=0.08)
    assert 0.98 < shape.convexity < 1
    assert measured(mesh) == shape  # to the last bit


# --- what is refused ---

BOX = trimesh.creation.box([10, 20, 30])


def test_open_mesh_is_refused() -> None:
    with pytest.raises(MeshError, match="not closed: 3 of 18 edges"):
        measured(trimesh.Trimesh(BOX.vertices, BOX.faces[1:], process=False))


def test_mesh_with_a_face_turned_round_is_refused() -> None:
    faces = BOX.faces.copy()
    faces[4] = faces[4, ::-1]
    with pytest.raises(MeshError, match="not consistently oriented: faces disagree along 3 edges"):
        measured(trimesh.Trimesh(BOX.vertices, faces, process=False))


def test_inside_out_mesh_measures_the_same() -> None:
    inverted = trimesh.Trimesh(BOX.vertices, BOX.faces[:, ::-1], process=False)
    assert inverted.volume < 0
    assert measured(inverted) == measured(BOX)


@pytest.mark.parametrize(
    ("vertices", "faces", "problem"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3), dtype=int), "no faces"),
        (BOX.vertices, BOX.faces + 1, "missing"),
        (np.where(np.arange(8)[:, None] == 3, np.nan, BOX.vertices), BOX.faces, "not finite"),
        (BOX.vertices * [1, 1, 0], BOX.faces, "no volume"),
        (np.zeros((8, 3)), BOX.faces, "no volume"),
    ],
)
def test_no_solid(vertices: np.ndarray, faces: np.ndarray, problem: str) -> None:
    with pytest.raises(MeshError, match=problem):
        measured(trimesh.Trimesh(vertices, faces, process=False))


def test_vertices_without_a_face_do_not_count() -> None:
    loose = trimesh.Trimesh(np.concatenate([BOX.vertices, [[500.0, np.inf, 0]]]), BOX.faces, process=False)
    assert measured(loose) == measured(BOX)


def test_far_from_the_origin() -> None:
    far = trimesh.Trimesh(BOX.vertices + 1e6, BOX.faces, process=False)
    assert measured(far).volume_mm3 == pytest.approx(6000, rel=1e-9)


# --- sums over the faces ---


@examples(0.15)
@given(mesh=polyhedra(), seed=st.integers(0, 2**32 - 1), inverted=st.booleans())
def test_sums_are_those_of_the_solid(mesh: trimesh.Trimesh, seed: int, inverted: bool) -> None:
    shift_mm = np.random.default_rng(seed).uniform(-20, 20, size=3)
    solid = solid_of(mesh.vertices + shift_mm, mesh.faces[:, ::-1] if inverted else mesh.faces)
    assert solid.volume_mm3 == pytest.approx(mesh.volume, rel=1e-12)
    np.testing.assert_allclose(solid.center_mm, mesh.center_mass + shift_mm, atol=1e-10)
    assert solid.surface_area_mm2 == pytest.approx(mesh.area, rel=1e-12)
    largest = np.abs(mesh.moment_inertia).max()
    np.testing.assert_allclose(solid.inertia_mm5, mesh.moment_inertia, atol=1e-10 * largest)


def test_inertia_of_a_box() -> None:
    a, b, c = 10, 20, 30
    expected = np.diag([b**2 + c**2, a**2 + c**2, a**2 + b**2]) * a * b * c / 12
    np.testing.assert_allclose(solid_of(BOX.vertices, BOX.faces).inertia_mm5, expected, rtol=1e-12, atol=1e-9)


@examples(0.5)
@given(mesh=polyhedra(), seed=st.integers(0, 2**32 - 1))
def test_any_one_corner_moved_is_noticed(mesh: trimesh.Trimesh, seed: int) -> None:
    rng = np.random.default_rng(seed)
    faces = np.array(mesh.faces)
    at = tuple(rng.integers(faces.shape))
    faces[at] = (faces[at] + rng.integers(1, len(mesh.vertices))) % len(mesh.vertices)
    with pytest.raises(MeshError, match="not closed"):
        solid_of(mesh.vertices, faces)


@given(estimate_mm=st.floats(1, 60), gap=st.floats(0, 5))
def test_the_least_width_is_between_that_of_the_estimate_and_that_of_the_hull(
    estimate_mm: float, gap: float
) -> None:
    hull_mm = estimate_mm * (1 + gap * NEAR)
    least_mm = least_width_within_mm(estimate_mm, hull_mm)
    assert estimate_mm <= least_mm <= hull_mm
    if gap < 0.999:
        assert least_mm == pytest.approx((estimate_mm + hull_mm) / 2)
    if gap > 2:
        assert least_mm == estimate_mm


def test_a_round_bar_is_as_thin_as_its_estimate_and_its_hull_have_it_in_the_mean() -> None:
    """The chords between 36 planes that touch a cylinder, within what the planes leave."""
    estimate = trimesh.creation.cylinder(radius=10, height=40, sections=36)
    flat = np.cos(np.pi / 36)
    shape = measure_shape(estimate.vertices, estimate.faces, hull_mm=estimate.vertices / [flat, flat, 1])
    assert shape.min_feret_mm == pytest.approx(20 * (1 + flat) / 2, rel=1e-4)
    assert min(shape.thickness_mm, shape.sieve_size_mm, *shape.min_box_mm) >= shape.min_feret_mm
