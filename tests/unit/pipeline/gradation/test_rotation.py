"""A lot is the same in whatever poses its stones fell."""

from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from support.extents import examples

from pipeline.arrays import Matrix33
from pipeline.gradation.estimates import Estimate
from pipeline.gradation.estimators import Basis
from pipeline.gradation.evaluation import Gradation, evaluate
from pipeline.gradation.stones import Stone, lot_of
from pipeline.measuring import measure_shape
from pipeline.synthesis.stones import STONE_FORMS, stone

N_STONES = 30
SIEVES_MM = (4.0, 8.0, 10.0, 11.2, 12.5, 14.0, 16.0, 20.0, 25.0, 31.5)
SEARCH_SD = 0.001
"""Relative, of sizes: what `measure_shape` says of its searches."""


@cache
def stones() -> list[trimesh.Trimesh]:
    """Convex stones: of the others only the volume would differ."""
    rng = np.random.default_rng(21)
    forms = [*STONE_FORMS, "flaky", "elongated"]
    drawn = [stone(forms[number % len(forms)], rng.uniform(12, 32), rng) for number in range(N_STONES)]
    return [body.mesh.convex_hull for body in drawn]


def measured(mesh: trimesh.Trimesh, R: Matrix33) -> Stone:
    shape = measure_shape(mesh.vertices @ R.T, mesh.faces)
    return Stone(
        volume_mm3=shape.volume_mm3,
        sieve_size_mm=shape.sieve_size_mm,
        max_feret_mm=shape.max_feret_mm,
        min_feret_mm=shape.min_feret_mm,
        length_mm=shape.length_mm,
        width_mm=shape.width_mm,
        thickness_mm=shape.thickness_mm,
        sieve_size_sd_mm=SEARCH_SD * shape.sieve_size_mm,
        feret_sd_mm=SEARCH_SD * shape.min_feret_mm,
    )


@cache
def upright() -> Gradation:
    return evaluate(lot_of(measured(mesh, np.eye(3)) for mesh in stones()), SIEVES_MM)


def figures(of: Gradation) -> dict[str, Estimate]:
    shares = {f"passing {point.sieve_mm:g} mm": point.by_mass for point in of.curve}
    shares |= {f"number passing {point.sieve_mm:g} mm": point.by_number for point in of.curve}
    shares |= {"flakiness": of.indices.flakiness_percent, "shape": of.indices.shape_percent}
    at_three = next(each for each in of.indices.flat_and_elongated if each.ratio == 3)
    return shares | {
        f"flat and elongated {basis}": at_three.flat_and_elongated_percent[basis] for basis in Basis
    }


@pytest.mark.full
@examples(0.5)
@given(st.integers(0, 2**32 - 1))
def test_percentages_ignore_the_poses_of_stones(seed: int) -> None:
    poses = Rotation.random(N_STONES, rng=np.random.default_rng(seed)).as_matrix()
    turned = evaluate(lot_of(measured(mesh, R) for mesh, R in zip(stones(), poses, strict=True)), SIEVES_MM)
    for name, found in figures(turned).items():
        expected = figures(upright())[name]
        assert found.value is not None and expected.value is not None, name
        assert found.measuring_se is not None, name
        # a stone that an error of a standard deviation takes over a limit adds 0.37 of its share to the standard error
        assert abs(found.value - expected.value) <= 4 * found.measuring_se + 1e-6, name


@pytest.mark.full
def test_the_stones_of_that_lot_are_flaky_and_not_flaky_on_many_sieves() -> None:
    assert all(2 < (upright().passing(mm).value or 0.0) < 98 for mm in (11.2, 12.5, 14.0, 16.0))
    for of in (upright().indices.flakiness_percent, upright().indices.shape_percent):
        assert 2 < (of.value or 0.0) < 98
