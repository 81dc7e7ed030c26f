"""Marching cubes over leaves against scikit-image's over the whole field."""

from typing import Literal

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree
from skimage.measure import marching_cubes
from support.extents import examples

from pipeline.arrays import Singles
from pipeline.carving import LEAF, VisualHull, all_leaves
from pipeline.meshing import Mesher, mesh_hull
from pipeline.meshing.cubes import march

SHAPES = st.tuples(*[st.integers(3, 14)] * 3)
SEEDS = st.integers(0, 2**32 - 1)


def noise(shape: tuple[int, ...], seed: int, smoothness: float = 0.0) -> Singles:
    """Samples about 0, never on it; the outermost ones are negative."""
    values = gaussian_filter(np.random.default_rng(seed).normal(size=shape), smoothness)
    values[np.abs(values) < 1e-3] = 1e-3
    inner = tuple(slice(1, -1) for _ in shape)
    field = np.full(shape, -1.0, np.float32)
    field[inner] = values[inner]
    return field


def ball(n: int, radius: float, center: tuple[float, float, float]) -> Singles:
    from_center = np.indices((n, n, n)) - np.reshape(center, (3, 1, 1, 1))
    field = (radius - np.linalg.norm(from_center, axis=0)).astype(np.float32)
    field[field == 0] = 1e-4
    return field


def surface(field: Singles, level: float = 0.0) -> trimesh.Trimesh:
    vertices, faces = march(field, level, all_leaves(field.shape))
    return trimesh.Trimesh(vertices, faces, process=False)


def skimage_surface(
    field: Singles, level: float = 0.0, method: Literal["lewiner", "lorensen"] = "lorensen"
) -> trimesh.Trimesh:
    vertices, faces, _, _ = marching_cubes(field, level, gradient_direction="ascent", method=method)
    return trimesh.Trimesh(vertices, faces, process=False)


def hull_of(field: Singles, leaves: NDArray[np.int32] | None = None) -> VisualHull:
    return VisualHull(
        field=field,
        leaves=all_leaves(field.shape) if leaves is None else leaves,
        level=0.0,
        origin_mm=np.array([-1.0, 2.0, 3.0]),
        pitch_mm=0.5,
        touches_border=False,
    )


def assert_same_points(points: NDArray[np.float64], others: NDArray[np.float64]) -> None:
    assert len(points) == len(others)
    distances, nearest = KDTree(others).query(points)
    assert distances.max() < 1e-5
    assert len(np.unique(nearest)) == len(others)


def assert_closed_over_all_cut_edges(field: Singles) -> None:
    mesh = surface(field)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.area_faces.min() > 0
    assert_same_points(mesh.vertices, skimage_surface(field).vertices)


def test_every_case_beside_every_other() -> None:
    field = noise((24, 24, 24), seed=0)
    is_inside = field > 0
    cases = sum(
        is_inside[i : 23 + i, j : 23 + j, k : 23 + k].astype(int) << (4 * i + 2 * j + k)
        for i, j, k in np.ndindex(2, 2, 2)
    )
    assert len(np.unique(cases)) == 256
    assert_closed_over_all_cut_edges(field)


@examples(0.3)
@given(SHAPES, SEEDS)
def test_any_field_has_a_closed_surface(shape: tuple[int, ...], seed: int) -> None:
    field = noise(shape, seed)
    if (field > 0).any():
        assert_closed_over_all_cut_edges(field)


@examples(0.25)
@given(SHAPES, SEEDS)
def test_a_smooth_field_has_scikit_image_s_surface(shape: tuple[int, ...], seed: int) -> None:
    field = noise(tuple(n + 8 for n in shape), seed, smoothness=2.5)
    if (field > 0).any():
        mesh, reference = surface(field), skimage_surface(field, method="lewiner")
        assert_same_points(mesh.vertices, reference.vertices)
        assert mesh.euler_number == reference.euler_number
        assert mesh.volume == pytest.approx(reference.volume, rel=0.01)


@examples(0.2)
@given(st.floats(9, 11), *[st.floats(13, 15)] * 3)
def test_a_ball_has_scikit_image_s_volume_and_area(radius: float, x: float, y: float, z: float) -> None:
    field = ball(28, radius, (x, y, z))
    mesh, reference = surface(field), skimage_surface(field)
    assert mesh.volume == pytest.approx(reference.volume, rel=1e-4)
    assert mesh.area == pytest.approx(reference.area, rel=1e-4)
    assert mesh.euler_number == 2


@pytest.mark.parametrize("level", [3.5, 15.5])
def test_the_level_lies_between_counts(level: float) -> None:
    count = np.rint(np.clip(8 + 4 * ball(24, 8, (11.3, 11.6, 11.9)), 0, 16)).astype(np.float32)
    assert_same_points(surface(count, level).vertices, skimage_surface(count, level).vertices)


def test_faces_look_towards_where_the_field_is_lower() -> None:
    mesh = surface(ball(20, 7, (9.3, 9.6, 9.9)))
    outwards = mesh.triangles_center - [9.3, 9.6, 9.9]
    assert (np.einsum("ij,ij->i", mesh.face_normals, outwards) > 0).all()


def cut_leaves(field: Singles, first: int = 0) -> NDArray[np.int32]:
    """Leaves that begin at `first` along each axis, and that the surface cuts."""
    leaves = first + all_leaves(tuple(n - first for n in field.shape))
    return leaves[[0 < np.mean(block_at(field, leaf) > 0) < 1 for leaf in leaves]]


def block_at(field: Singles, leaf: NDArray[np.int32]) -> Singles:
    """The samples of a leaf's cubes, as a view."""
    return field[tuple(slice(first, first + LEAF + 1) for first in leaf)]


@examples(0.25)
@given(SEEDS, st.integers(0, LEAF - 1))
def test_leaves_may_come_in_any_order_and_begin_anywhere(seed: int, first: int) -> None:
    field = ball(20, 5, (9.3, 9.6, 9.9))
    whole = surface(field)
    shuffled = np.random.default_rng(seed).permutation(cut_leaves(field, first))
    vertices, faces = march(field, 0.0, shuffled)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert_same_points(mesh.vertices, whole.vertices)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(whole.volume)


def test_an_edge_that_no_leaf_holds_is_told() -> None:
    field = ball(20, 7, (9.3, 9.6, 9.9))
    with pytest.raises(ValueError, match="no leaf"):
        march(field, 0.0, cut_leaves(field)[:-1])


def test_what_lies_in_no_leaf_is_not_read() -> None:
    field = ball(20, 7, (9.3, 9.6, 9.9))
    leaves = cut_leaves(field)
    only_leaves = np.full_like(field, np.nan)
    for leaf in leaves:
        block_at(only_leaves, leaf)[:] = block_at(field, leaf)
    assert np.isnan(only_leaves).any()
    for expected, found in zip(march(field, 0.0, leaves), march(only_leaves, 0.0, leaves), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("mesher", Mesher)
def test_a_mesh_is_the_largest_part_in_mm(mesher: Mesher) -> None:
    field = np.maximum(ball(32, 6, (9, 9.3, 9.1)), ball(32, 4, (22, 21.3, 20.8)))
    mesh = mesh_hull(hull_of(field), mesher)
    assert mesh is not None
    body = trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False)
    assert body.is_watertight
    assert body.body_count == 1
    assert body.volume == pytest.approx(4 / 3 * np.pi * 3**3, rel=0.02)
    assert body.center_mass == pytest.approx([3.5, 6.65, 7.55], abs=0.01)


@pytest.mark.parametrize("mesher", Mesher)
@pytest.mark.parametrize("shape", [(0, 0, 0), (9, 8, 7)])
def test_an_empty_hull_has_no_mesh(shape: tuple[int, ...], mesher: Mesher) -> None:
    assert mesh_hull(hull_of(np.full(shape, -1, np.float32)), mesher) is None
