"""A support function fitted to tangent planes, and how far it may be trusted."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import eval_legendre
from support.silhouettes import sphere_silhouettes

from pipeline.estimate.inner import inner_body
from pipeline.estimate.smooth_support import (
    DEGREE,
    DEGREES,
    fit_support,
    harmonics,
    inner_of,
    smooth_weight,
    smoothed,
)
from pipeline.estimate.tangents import Tangents, find_tangents
from pipeline.geometry.icosphere import icosphere
from pipeline.rig.design import as_built, nominal_rig
from pipeline.views.prepared import prepare_views

RIG = as_built(nominal_rig(), seed=6)
CENTER_MM = np.array([0.4, -0.3, 0.2])
FOUND = find_tangents(prepare_views(sphere_silhouettes(RIG, CENTER_MM), RIG), CENTER_MM)
AXES_MM = np.array([6.0, 7.5, 10.0])
Array = NDArray[np.float64]


def tangents_of(points_mm: Array, offsets_mm: Array) -> Tangents:
    """The planes of a sphere's views moved to other offsets, with points and half a mm of doubt about them."""
    return Tangents(
        normals=FOUND.normals,
        offsets_mm=offsets_mm,
        points_mm=points_mm,
        directions=FOUND.directions,
        low_mm=np.full(len(offsets_mm), -0.1),
        high_mm=np.full(len(offsets_mm), 0.4),
        owners=FOUND.owners,
        is_seen=FOUND.is_seen,
    )


def ellipsoid(turn: Rotation, noise_mm: float = 0.0) -> tuple[Tangents, Array]:
    """An ellipsoid's planes, and where they touch it."""
    normals = turn.apply(FOUND.normals)
    offsets_mm = np.linalg.norm(normals * AXES_MM, axis=1)
    touched_mm = turn.inv().apply(normals * AXES_MM**2 / offsets_mm[:, None])
    noise = noise_mm * np.random.default_rng(1).normal(size=len(offsets_mm))
    return tangents_of(touched_mm, offsets_mm + noise), touched_mm


def cube() -> Tangents:
    corners_mm = 7.5 * (np.indices((2, 2, 2)).reshape(3, -1).T * 2.0 - 1)
    heights_mm = FOUND.normals @ corners_mm.T
    tangents = tangents_of(corners_mm[heights_mm.argmax(axis=1)], heights_mm.max(axis=1))
    return replace(tangents, low_mm=np.zeros(len(heights_mm)), high_mm=np.zeros(len(heights_mm)))


def test_harmonics_obey_the_addition_theorem() -> None:
    directions = icosphere(subdivisions=1)[0]
    values = harmonics(directions)
    for degree in range(DEGREE + 1):
        own = values[:, degree == DEGREES]
        expected = (2 * degree + 1) * eval_legendre(degree, np.clip(directions @ directions.T, -1, 1))
        np.testing.assert_allclose(own @ own.T, expected, atol=1e-10)


@pytest.mark.parametrize("seed", [1, 2])
def test_an_ellipsoid_is_found_in_any_pose_with_where_it_is_touched(seed: int) -> None:
    tangents, touched_mm = ellipsoid(Rotation.random(rng=np.random.default_rng(seed)))
    support = fit_support(tangents)
    assert support.error_mm < 0.003
    moved = smoothed(tangents, support, 1.0)
    np.testing.assert_allclose(moved.offsets_mm, tangents.offsets_mm, atol=0.005)
    np.testing.assert_allclose(moved.lengths_mm, 0, atol=1e-9)
    contacts_mm = moved.points_mm + moved.low_mm[:, None] * moved.directions
    np.testing.assert_allclose(
        contacts_mm, touched_mm, atol=0.06
    )  # 0.06^2 / 2 / 6: heights are within 0.3 um


def test_the_error_of_a_view_left_out_counts_the_noise() -> None:
    tangents, _ = ellipsoid(Rotation.identity(), noise_mm=0.02)
    support = fit_support(tangents)
    assert support.error_mm == pytest.approx(0.02, rel=0.15)
    true_mm = ellipsoid(Rotation.identity())[0].offsets_mm
    left_mm = support.heights_mm(tangents.normals) - true_mm
    assert np.sqrt((left_mm**2).mean()) < 0.4 * 0.02


def test_a_ball_is_smooth_and_a_cube_is_not() -> None:
    inner = inner_body(FOUND)
    assert inner is not None
    assert smooth_weight(fit_support(FOUND), inner) > 0.95
    tangents = cube()
    inner = inner_body(tangents)
    assert inner is not None
    assert smooth_weight(fit_support(tangents), inner) < 0.2


def test_the_inner_body_of_a_ball_reaches_its_surface() -> None:
    tangents, inner = inner_of(FOUND)
    before = inner_body(FOUND)
    assert inner is not None
    assert before is not None
    radii_mm, before_mm = (
        np.linalg.norm(body.points_mm[np.unique(body.facets.corners)], axis=1) for body in (inner, before)
    )
    assert np.abs(radii_mm - 7.5).max() < 0.02
    assert np.abs(before_mm - 7.5).max() > 0.03
    assert np.abs(tangents.offsets_mm - 7.5).max() < 0.01


def test_the_noise_of_many_contacts_makes_no_body_larger() -> None:
    exact = cube()
    noise_mm = 0.02 * np.random.default_rng(4).normal(size=exact.points_mm.shape)
    noisy = replace(exact, points_mm=exact.points_mm + noise_mm)
    widths_mm = []
    for tangents in (exact, noisy):
        inner = inner_body(tangents)
        assert inner is not None
        widths_mm.append(np.ptp(inner.points_mm[np.unique(inner.facets.corners)], axis=0))
    assert np.abs(widths_mm[1] - widths_mm[0]).max() < 0.03
    outermost_mm = np.ptp(noisy.points_mm + noisy.low_mm[:, None] * noisy.directions, axis=0)
    assert (outermost_mm - widths_mm[0]).min() > 0.06
