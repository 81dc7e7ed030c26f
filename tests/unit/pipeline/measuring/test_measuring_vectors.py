"""Bodies whose measures are known exactly (T1-T14 of the domain notes), in random poses."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from support.known_bodies import BODIES, FORMS, SIZES, box

from pipeline.measuring import ShapeMeasurement, measure_shape


def measured(mesh: trimesh.Trimesh) -> ShapeMeasurement:
    return measure_shape(mesh.vertices, mesh.faces)


def posed(mesh: trimesh.Trimesh, seed: int) -> trimesh.Trimesh:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(rng=rng).as_matrix()
    shift_mm = rng.uniform(-20, 20, size=3)
    return trimesh.Trimesh(mesh.vertices @ rotation.T + shift_mm, mesh.faces, process=False)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("name", BODIES)
def test_known_body_in_a_random_pose(name: str, seed: int) -> None:
    make, sizes = BODIES[name]
    mesh = posed(make(*sizes), seed)
    shape = measured(mesh)

    volume, area, equivalent, sphericity, max_feret, min_feret, sieve = SIZES[name]
    assert shape.volume_mm3 == pytest.approx(volume, rel=1e-3)
    assert shape.surface_area_mm2 == pytest.approx(area, rel=1e-3)
    assert shape.equivalent_diameter_mm == pytest.approx(equivalent, rel=1e-3)
    assert shape.sphericity == pytest.approx(sphericity, rel=5e-3)
    assert shape.max_feret_mm == pytest.approx(max_feret, rel=1e-3)
    assert shape.min_feret_mm == pytest.approx(min_feret, rel=1e-3)
    assert shape.sieve_size_mm == pytest.approx(sieve, rel=1e-3)
    assert shape.convexity == pytest.approx(1, abs=1e-9)
    assert shape.length_mm == shape.max_feret_mm
    # every body of the list has its centre of mass at the mean of its vertices
    np.testing.assert_allclose(shape.center_mm, mesh.vertices.mean(axis=0), atol=1e-6)

    if name in FORMS:
        (a, b, c), krumbein, corey, zingg = FORMS[name]
        assert shape.min_box_mm == pytest.approx((a, b, c), rel=1e-3)
        assert shape.elongation_ratio == pytest.approx(b / a, rel=1e-3)
        assert shape.flatness_ratio == pytest.approx(c / b, rel=1e-3)
        assert shape.krumbein == pytest.approx(krumbein, abs=1e-3)
        assert shape.corey == pytest.approx(corey, abs=1e-3)
        assert shape.zingg_class == zingg


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_l_tromino_is_not_convex(seed: int) -> None:
    """T14: 20 x 20 x 10 without 10 x 10 x 10."""
    outline = np.array([(0, 0), (20, 0), (20, 10), (10, 10), (10, 20), (0, 20)], dtype=float)
    bottom, top = np.c_[outline, np.zeros(6)], np.c_[outline, np.full(6, 10.0)]
    caps = np.array([(0, 1, 3), (1, 2, 3), (0, 3, 5), (3, 4, 5)])
    sides = [(i, (i + 1) % 6, 6 + (i + 1) % 6) for i in range(6)]
    sides += [(i, 6 + (i + 1) % 6, 6 + i) for i in range(6)]
    mesh = trimesh.Trimesh(np.concatenate([bottom, top]), np.concatenate([caps[:, ::-1], caps + 6, sides]))

    shape = measured(posed(mesh, seed))

    assert shape.volume_mm3 == pytest.approx(3000, rel=1e-9)
    assert shape.surface_area_mm2 == pytest.approx(1400, rel=1e-9)
    assert shape.convexity == pytest.approx(0.8571, abs=1e-4)


@pytest.mark.parametrize("seed", [1, 2])
def test_d4791_length_of_a_box_is_its_diagonal_and_the_rest_is_perpendicular_to_it(seed: int) -> None:
    """Width and thickness against extents along 7200 directions around the diagonal."""
    edges = np.array([10.0, 14.0, 28.0])
    diagonal = edges / np.linalg.norm(edges)
    first = np.cross(diagonal, [1.0, 0, 0])
    first /= np.linalg.norm(first)
    angle = np.deg2rad(np.arange(0, 180, 0.025))[:, None]
    around = np.cos(angle) * first + np.sin(angle) * np.cross(diagonal, first)
    extents = np.ptp(box(*edges).vertices @ around.T, axis=0)

    shape = measured(posed(box(*edges), seed))

    assert shape.length_mm == pytest.approx(32.863, rel=1e-4)
    assert shape.width_mm == pytest.approx(extents.max(), rel=1e-5)
    # 90 degrees further on
    assert shape.thickness_mm == pytest.approx(extents[(extents.argmax() + 3600) % 7200], rel=1e-3)


@pytest.mark.parametrize("seed", range(8))
def test_least_width_of_a_polyhedron_is_that_of_a_face_or_of_two_edges(seed: int) -> None:
    """The width of a convex polyhedron is least across a face or across two edges: try them all."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(12, 3)) * rng.uniform(2, 15, size=3)
    mesh = trimesh.convex.convex_hull(points)
    edges = mesh.vertices[mesh.edges_unique]
    along = edges[:, 1] - edges[:, 0]
    i, j = np.triu_indices(len(along), 1)
    normals = np.concatenate([ConvexHull(points).equations[:, :3], np.cross(along[i], along[j])])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals[lengths > 1e-6] / lengths[lengths > 1e-6, None]
    least = np.ptp(points @ normals.T, axis=0).min()

    assert measured(mesh).min_feret_mm == pytest.approx(least, rel=2e-4)
