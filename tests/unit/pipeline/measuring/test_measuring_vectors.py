"""Bodies whose measures are known exactly (T1-T14 of the domain notes), in random poses."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from pipeline.measuring import ShapeMeasurement, measure_shape


def measured(mesh: trimesh.Trimesh) -> ShapeMeasurement:
    return measure_shape(mesh.vertices, mesh.faces)


def box(*edges: float) -> trimesh.Trimesh:
    return trimesh.creation.box(edges)


def ellipsoid(*axes: float) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=5, radius=0.5)
    mesh.apply_scale(axes)
    return mesh


def cylinder(diameter: float, height: float) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=diameter / 2, height=height, sections=256)


def hull(corners: Any, edge: float) -> trimesh.Trimesh:
    points = np.array(corners, dtype=float)
    points *= edge / np.linalg.norm(points - points[0], axis=1)[1:].min()
    return trimesh.convex.convex_hull(points)


def tetrahedron(edge: float) -> trimesh.Trimesh:
    return hull([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], edge)


def octahedron(edge: float) -> trimesh.Trimesh:
    return hull(np.concatenate([np.eye(3), -np.eye(3)]), edge)


BODIES: dict[str, tuple[Callable[..., trimesh.Trimesh], tuple[float, ...]]] = {
    "T1": (ellipsoid, (15, 15, 15)),
    "T2": (box, (15, 15, 15)),
    "T3": (cylinder, (15, 15)),
    "T4": (box, (10, 20, 40)),
    "T5": (box, (5, 20, 40)),
    "T6": (box, (12, 15, 20)),
    "T7": (ellipsoid, (10, 20, 40)),
    "T8": (ellipsoid, (12, 15, 20)),
    "T9": (box, (10, 14, 28)),
    "T10": (cylinder, (20, 4)),
    "T11": (cylinder, (8, 40)),
    "T12": (tetrahedron, (20,)),
    "T13": (octahedron, (20,)),
}
SIZES = {
    # V, A, equivalent diameter, sphericity, max Feret, min Feret, sieve size
    "T1": (1767.15, 706.86, 15.000, 1.0000, 15.000, 15.000, 15.000),
    "T2": (3375.00, 1350.00, 18.611, 0.8060, 25.981, 15.000, 15.000),
    "T3": (2650.72, 1060.29, 17.171, 0.8736, 21.213, 15.000, 15.000),
    "T4": (8000.00, 2800.00, 24.814, 0.6909, 45.826, 10.000, 20.000),
    "T5": (4000.00, 2200.00, 19.695, 0.5539, 45.000, 5.000, 17.678),
    "T6": (3600.00, 1440.00, 19.015, 0.7888, 27.731, 12.000, 15.000),
    "T7": (4188.79, 1586.92, 20.000, 0.7919, 40.000, 10.000, 15.811),
    "T8": (1884.96, 763.44, 15.326, 0.9666, 20.000, 12.000, 13.583),
    "T9": (3920.00, 1624.00, 19.563, 0.7403, 32.863, 10.000, 14.000),
    "T10": (1256.64, 879.65, 13.389, 0.6402, 20.396, 4.000, 16.971),
    "T11": (2010.62, 1105.84, 15.660, 0.6966, 40.792, 8.000, 8.000),
    "T12": (942.81, 692.82, 12.166, 0.6711, 20.000, 14.142, 14.142),
    "T13": (3771.24, 1385.64, 19.312, 0.8456, 28.284, 16.330, 18.856),
}
FORMS = {
    # a, b, c (edges, axes, or diameter and height), Krumbein, Corey, Zingg
    "T1": ((15, 15, 15), 1, 1, "equant"),
    "T2": ((15, 15, 15), 1, 1, "equant"),
    "T3": ((15, 15, 15), 1, 1, "equant"),
    "T4": ((40, 20, 10), 0.5000, 0.3536, "blade"),
    "T5": ((40, 20, 5), 0.3969, 0.1768, "blade"),
    "T6": ((20, 15, 12), 0.7663, 0.6928, "equant"),
    "T7": ((40, 20, 10), 0.5000, 0.3536, "blade"),
    "T8": ((20, 15, 12), 0.7663, 0.6928, "equant"),
    "T9": ((28, 14, 10), 0.5631, 0.5051, "rod"),
    "T10": ((20, 20, 4), 0.585, 0.200, "disc"),
    "T11": ((40, 8, 8), 0.342, 0.447, "rod"),
}


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
        assert shape.krumbein_sphericity == pytest.approx(krumbein, abs=1e-3)
        assert shape.corey_shape_factor == pytest.approx(corey, abs=1e-3)
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
