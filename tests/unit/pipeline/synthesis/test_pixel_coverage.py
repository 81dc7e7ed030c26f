import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.synthetic_rigs import rig_of

from pipeline.arrays import FloatImage, PointsUV
from pipeline.synthesis.bodies import cube, sphere
from pipeline.synthesis.pixel_coverage import (
    LINES_PER_PIXEL,
    Window,
    coverage,
    intersection,
    mesh_edges,
    silhouette_edges,
    window_around,
)

coordinates = st.floats(-5, 45)


def covered_by(loop_uv: PointsUV, window: Window) -> FloatImage:
    return coverage(loop_uv, np.roll(loop_uv, -1, axis=0), window)


@given(st.lists(st.tuples(coordinates, coordinates), min_size=3, max_size=3))
def test_the_coverage_of_a_triangle_is_its_area(corners: list[tuple[float, float]]) -> None:
    triangle = np.array(corners)
    (ax, ay), (bx, by) = triangle[1] - triangle[0], triangle[2] - triangle[0]
    covered = covered_by(triangle, Window(-10, -10, 70, 70))
    assert covered.min() > -1e-5
    assert covered.max() < 1 + 1e-5
    # a horizontal edge may lie anywhere between two lines, the other errors are of second order
    bound = np.ptp(triangle[:, 0]) / LINES_PER_PIXEL / 2 + 1e-3
    assert covered.sum() == pytest.approx(abs(ax * by - ay * bx) / 2, abs=bound)


@given(st.lists(st.tuples(coordinates, coordinates), min_size=3, max_size=3))
def test_a_window_shows_what_a_larger_one_shows_there(corners: list[tuple[float, float]]) -> None:
    triangle = np.array(corners)
    whole, part = covered_by(triangle, Window(-10, -10, 70, 70)), covered_by(triangle, Window(5, 8, 20, 15))
    np.testing.assert_allclose(part, whole[18:33, 15:35], atol=1e-5)


def test_pixel_centres_are_on_integers() -> None:
    square = np.array([[1.5, 2.5], [4.25, 2.5], [4.25, 3.5], [1.5, 3.5]])
    covered = covered_by(square, Window(0, 0, 8, 6))
    expected = np.zeros((6, 8))
    expected[3, 2:5] = 1, 1, 0.75
    np.testing.assert_allclose(covered, expected, atol=1e-6)


def test_what_is_covered_twice_counts_once() -> None:
    square = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    starts = np.concatenate([square, square + 5])
    ends = np.concatenate([np.roll(square, -1, axis=0), np.roll(square, -1, axis=0) + 5])
    covered = coverage(starts, ends, Window(-2, -2, 25, 25))
    assert covered.max() == pytest.approx(1)
    assert covered.sum() == pytest.approx(175)


def test_an_open_border_is_refused() -> None:
    with pytest.raises(ValueError, match="no closed loops"):
        coverage(np.array([[1.0, 0.0]]), np.array([[1.0, 9.0]]), Window(0, 0, 10, 10))


@pytest.mark.parametrize("offset_mm", [(0, 0), (0.013, 0.017), (-0.031, 0.007)])
def test_a_sphere_covers_its_circle_without_bias(offset_mm: tuple[float, float]) -> None:
    """On the axis of a pinhole, sin(angle) = r / D, hence the image's radius is f r / sqrt(D^2 - r^2)."""
    camera = rig_of("c05").cameras[0]
    mesh = sphere().mesh
    vertices_mm = mesh.vertices + offset_mm @ camera.R[:2]  # across the axis, by parts of a pixel
    pixels_uv, _ = camera.project(vertices_mm)
    toward_camera = camera.center_mm - vertices_mm[mesh.faces[:, 0]]
    is_front = np.einsum("ij,ij->i", mesh.face_normals, toward_camera) > 0
    edges_uv = pixels_uv[silhouette_edges(mesh_edges(mesh.faces), is_front)]
    covered = coverage(edges_uv[:, 0], edges_uv[:, 1], window_around(pixels_uv, 2))
    radius_px = np.sqrt(covered.sum(dtype=np.float64) / np.pi)
    # 0.0047 px of the difference are the facets: their outline is 0.0002 mm outside the ideal one
    assert radius_px == pytest.approx(6250 * 7.5 / np.sqrt(300**2 - 7.5**2), abs=0.006)


def test_the_border_of_a_cube_seen_along_an_edge_is_two_of_its_faces() -> None:
    mesh = cube().mesh
    edges = silhouette_edges(mesh_edges(mesh.faces), mesh.face_normals @ [1.0, 1.0, 0.0] > 0.1)
    lengths_mm = np.linalg.norm(mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]], axis=1)
    assert lengths_mm.sum() == pytest.approx(6 * 15)  # 2 upright edges, 4 level ones
    starts, ends = np.sort(edges[:, 0]), np.sort(edges[:, 1])
    assert np.array_equal(starts, ends), "not closed"


def test_windows_that_do_not_meet_share_nothing() -> None:
    assert intersection(Window(0, 0, 4, 4), Window(4, 0, 4, 4)) is None
    assert intersection(Window(0, 0, 4, 4), Window(3, -2, 4, 4)) == Window(3, 0, 1, 2)
