"""Distances between surfaces against formulas, and errors of rigs against rigid motions."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.extents import examples

from pipeline.evaluation.scene import rig_error
from pipeline.evaluation.surface_distances import Surface, even_samples, surface_distances
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig

SPHERE = trimesh.creation.icosphere(subdivisions=5, radius=7.5)


@pytest.mark.parametrize("offset_mm", [0.1, -0.2])
def test_distances_of_concentric_spheres(offset_mm: float) -> None:
    other = trimesh.creation.icosphere(subdivisions=5, radius=7.5 + offset_mm)
    distances = surface_distances(other, Surface(SPHERE), np.random.default_rng(0), 2000)
    assert distances.mean_mm == pytest.approx(abs(offset_mm), abs=2e-3)
    assert distances.max_mm == pytest.approx(abs(offset_mm), abs=4e-3)
    assert distances.signed_mm == pytest.approx(offset_mm, abs=2e-3)
    assert distances.back_mean_mm == pytest.approx(abs(offset_mm), abs=2e-3)
    assert distances.back_max_mm == pytest.approx(abs(offset_mm), abs=4e-3)


def test_what_is_missing_is_seen_on_the_way_back_only() -> None:
    whole = trimesh.creation.box([10, 10, 40])
    half = trimesh.creation.box([10, 10, 20])
    half.apply_translation([0, 0, -10])
    distances = surface_distances(half, Surface(whole), np.random.default_rng(0), 2000)
    assert 4 < distances.max_mm <= 5, "the middle of the cut lies five from the sides"
    assert distances.back_max_mm == pytest.approx(20, abs=1e-6)


def test_distance_to_a_box_against_its_formula() -> None:
    half = np.array([5.0, 2.0, 9.0])
    points = even_samples(
        trimesh.creation.icosphere(subdivisions=3, radius=6.0), 2000, np.random.default_rng(0)
    )
    beyond = np.abs(points) - half
    expected = np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)
    box = Surface(trimesh.creation.box(2 * half))
    np.testing.assert_allclose(box.signed_distances_mm(points), expected, atol=1e-9)
    assert box.greatest_distance_mm(points) == pytest.approx(np.abs(expected).max(), abs=1e-9)


def test_samples_are_even() -> None:
    box = trimesh.creation.box([1, 2, 30])
    points = even_samples(box, 10_000, np.random.default_rng(0))
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=0.1)
    at_end = np.isclose(np.abs(points[:, 2]), 15)
    assert at_end.mean() == pytest.approx(4 / box.area, abs=3e-4)


def transformed(rig: RigCalibration, turn: Rotation, t_mm: np.ndarray, scale: float) -> RigCalibration:
    """Return the rig that images scale * (turn x + t) where `rig` images x."""
    cameras = []
    for camera in rig.cameras:
        R = camera.R @ turn.inv().as_matrix()
        cameras.append(replace(camera, R=R, t_mm=scale * (camera.t_mm - R @ t_mm)))
    return replace(rig, cameras=tuple(cameras))


@examples(0.1)
@given(
    seed=st.integers(0, 1000),
    scale=st.floats(0.98, 1.02),
)
def test_rigs_that_differ_by_a_similarity(seed: int, scale: float) -> None:
    rng = np.random.default_rng(seed)
    turn, t_mm = Rotation.from_rotvec(rng.normal(size=3) / 20), rng.normal(size=3)
    true_rig = as_built(nominal_rig(), seed)
    error = rig_error(transformed(true_rig, turn, t_mm, scale), true_rig)
    assert error.scale_percent == pytest.approx(100 * (scale - 1), abs=1e-6)
    np.testing.assert_allclose(error.R @ turn.as_matrix(), np.eye(3), atol=1e-9)
    np.testing.assert_allclose(error.t_mm, -scale * turn.inv().apply(t_mm), atol=1e-6)
    # rms distance from the middle of the points within +-12 mm on a grid of 5 an axis
    spread_mm = np.sqrt(3 * np.mean(np.linspace(-12, 12, 5) ** 2))
    assert error.rms_mm == pytest.approx(abs(scale - 1) * spread_mm, abs=1e-6)
