"""The visual hull of a sphere, against counting random points."""

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.measuring import sphere_hull_excess
from pipeline.rig.design import as_built, nominal_rig

CENTERS_MM = np.array([camera.center_mm for camera in nominal_rig().cameras])


def counted(centers_mm: NDArray[np.float64], center_mm: NDArray[np.float64], radius_mm: float) -> float:
    """Share of random points around the sphere that every camera sees in front of, in or behind it."""
    rng = np.random.default_rng(0)
    outer = 1.3
    n = 300_000
    points = rng.normal(size=(n, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= radius_mm * np.cbrt(rng.uniform(1, outer**3, size=(n, 1)))  # even in the shell
    inside = np.ones(n, dtype=bool)
    for camera_mm in centers_mm:
        rays = points + center_mm - camera_mm
        axis = center_mm - camera_mm
        distance_mm = np.linalg.norm(axis)
        cosine = rays @ axis / (np.linalg.norm(rays, axis=1) * distance_mm)
        inside &= cosine >= np.sqrt(1 - (radius_mm / distance_mm) ** 2)
    return 1 + inside.mean() * (outer**3 - 1)


@pytest.mark.parametrize(("n_cameras", "radius_mm"), [(16, 7.5), (16, 20), (12, 7.5)])
def test_against_counting_points(n_cameras: int, radius_mm: float) -> None:
    center_mm = np.array([2.0, -1.0, 3.0])
    centers_mm = CENTERS_MM[:n_cameras]
    excess = sphere_hull_excess(centers_mm, center_mm, radius_mm) - 1
    assert excess == pytest.approx(counted(centers_mm, center_mm, radius_mm) - 1, rel=0.08)


def test_reference_of_the_nominal_rig() -> None:
    """A sphere of 15 mm in the middle: +0.76 % by intersecting half-spaces."""
    assert sphere_hull_excess(CENTERS_MM, np.zeros(3), 7.5) == pytest.approx(1.0076, abs=2e-4)


def test_the_as_built_rig_is_about_as_good() -> None:
    centers_mm = [camera.center_mm for camera in as_built(nominal_rig(), seed=3).cameras]
    assert sphere_hull_excess(centers_mm, np.zeros(3), 7.5) == pytest.approx(1.0076, abs=1e-3)


def test_every_lost_camera_makes_the_hull_larger() -> None:
    excesses = [sphere_hull_excess(CENTERS_MM[:n], np.zeros(3), 7.5) for n in range(16, 7, -1)]
    assert excesses == sorted(excesses)
    assert excesses[0] < excesses[-1]


def test_many_cameras_see_a_sphere() -> None:
    directions = np.random.default_rng(1).normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert sphere_hull_excess(300 * directions, np.zeros(3), 7.5) == pytest.approx(1, abs=2e-4)


@pytest.mark.parametrize(
    ("centers_mm", "radius_mm", "problem"),
    [
        (CENTERS_MM[:1], 7.5, "open"),
        (CENTERS_MM, 301.0, "inside"),
        (CENTERS_MM, 0.0, "positive"),
    ],
)
def test_no_hull(centers_mm: NDArray[np.float64], radius_mm: float, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        sphere_hull_excess(centers_mm, np.zeros(3), radius_mm)
