"""Calipers and sieve touch the body where they are said to, and are as far apart as it is long."""

from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from support.known_bodies import BODIES, SIZES

from pipeline.measuring import measure_shape
from pipeline.measuring.contacts import TOUCHING_MM, Contacts, contacts_of

CALIPERS = ("length", "width", "thickness", "max_feret", "min_feret")


def turned(mesh: trimesh.Trimesh, seed: int) -> trimesh.Trimesh:
    """Return a copy in a random pose, away from the origin."""
    pose = trimesh.transformations.random_rotation_matrix(np.random.default_rng(seed).random(3))
    pose[:3, 3] = 1.5, -4.0, 2.5
    copy = mesh.copy()
    copy.apply_transform(pose)
    return copy


def assert_touches(found: Contacts, vertices_mm: Any) -> None:
    """Fail unless all planes are tangent at the points, and the square holds the whole projection and touches it."""
    vertices = np.asarray(vertices_mm)
    for name in CALIPERS:
        caliper = getattr(found, name)
        heights_mm = vertices @ caliper.direction
        assert np.linalg.norm(caliper.direction) == pytest.approx(1)
        assert np.ptp(heights_mm) == pytest.approx(caliper.value_mm, rel=1e-4), name
        a_mm, b_mm = np.array(caliper.a_mm), np.array(caliper.b_mm)
        assert a_mm @ caliper.direction == pytest.approx(heights_mm.max(), abs=1e-2), name
        assert b_mm @ caliper.direction == pytest.approx(heights_mm.min(), abs=1e-2), name
        for point in (a_mm, b_mm):
            assert np.linalg.norm(vertices - point, axis=1).min() < 1e-9, name
        assert (a_mm - b_mm) @ caliper.direction == pytest.approx(caliper.value_mm), name
    axes = np.array([found.length.direction, found.width.direction, found.thickness.direction])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-9)
    square = found.sieve
    corners_mm = np.array(square.corners_mm)
    sides = np.roll(corners_mm, -1, axis=0) - corners_mm
    assert np.linalg.norm(sides, axis=1) == pytest.approx(square.value_mm)
    assert sides @ square.direction == pytest.approx(0, abs=1e-9)
    assert abs(sides[0] @ sides[1]) < 1e-9 * square.value_mm**2
    units = sides[:2] / square.value_mm
    within_mm = (vertices - corners_mm[0]) @ units.T
    tolerance_mm = 1e-4 * square.value_mm  # vertices that stand out by less are not of the hull
    assert within_mm.min() >= -tolerance_mm
    assert within_mm.max() <= square.value_mm + tolerance_mm
    touching = (np.array(square.touches_mm) - corners_mm[0]) @ units.T
    gaps_mm = np.minimum(touching, square.value_mm - touching)
    assert (gaps_mm.min(axis=1) < 1.01 * TOUCHING_MM).all()
    for side in (0, 1):  # one pair of opposite sides at least is touched on both
        if (np.ptp(touching[:, side])) > square.value_mm - 3 * TOUCHING_MM:
            break
    else:
        pytest.fail("the square could be smaller")


@pytest.mark.parametrize("name", BODIES)
def test_known_bodies(name: str) -> None:
    make, sizes = BODIES[name]
    mesh = turned(make(*sizes), seed=1)
    found = contacts_of(mesh.vertices, mesh.faces)
    assert_touches(found, mesh.vertices)
    volume, _, _, _, max_feret, min_feret, sieve = SIZES[name]
    assert found.max_feret.value_mm == pytest.approx(max_feret, rel=2e-3)
    assert found.min_feret.value_mm == pytest.approx(min_feret, rel=2e-3)
    assert found.sieve.value_mm == pytest.approx(sieve, rel=2e-3)
    assert found.volume_mm3 == pytest.approx(volume, rel=5e-3)


def test_a_dented_body_is_touched_where_it_stands_out() -> None:
    """T14: an L of three cubes of 10 mm."""
    outline = np.array([(0, 0), (20, 0), (20, 10), (10, 10), (10, 20), (0, 20)], float)
    faces_2d = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
    mesh = turned(trimesh.creation.extrude_triangulation(outline, faces_2d, height=10.0), seed=2)
    assert mesh.volume == pytest.approx(3000)
    found = contacts_of(mesh.vertices, mesh.faces)
    assert_touches(found, mesh.vertices)
    assert found.max_feret.value_mm == pytest.approx(30.0)


@given(seed=st.integers(0, 2**31), n_points=st.integers(8, 200), flat=st.floats(0.1, 1.0))
def test_they_touch_any_convex_body_and_measure_what_is_measured(
    seed: int, n_points: int, flat: float
) -> None:
    points = np.random.default_rng(seed).normal(size=(n_points, 3)) * (10.0, 7.0, 10.0 * flat)
    mesh = turned(trimesh.convex.convex_hull(points), seed)
    found, shape = contacts_of(mesh.vertices, mesh.faces), measure_shape(mesh.vertices, mesh.faces)
    assert_touches(found, mesh.vertices)
    assert found.length.value_mm == pytest.approx(shape.length_mm, rel=1e-9)
    assert found.width.value_mm == pytest.approx(shape.width_mm, rel=1e-6)
    assert found.thickness.value_mm == pytest.approx(shape.thickness_mm, rel=1e-6)
    assert found.min_feret.value_mm == pytest.approx(shape.min_feret_mm, rel=2e-4)
    assert found.sieve.value_mm == pytest.approx(shape.sieve_size_mm, rel=1e-6)
    assert found.volume_mm3 == shape.volume_mm3
