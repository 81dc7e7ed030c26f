"""A smooth support function through the tangent planes, and how well it predicts those of a view left out.

The support function h(n) is the distance of the tangent plane with normal n from the centre. The planes of one view
tell it along a great circle of normals, to a few micrometres; up to 17 degrees beside the circles nothing tells it but
the other views. On a smooth body h is smooth: spherical harmonics fitted to all planes give it between the circles as
well, average the noise of the outlines, and their gradient is the point that touches (Schneider 2014, Convex Bodies,
1.7). On a body with corners h has kinks, and harmonics miss it. Which of the two it is, the planes themselves say:
those of each view are predicted from the other views' (leave one out), and the error of that is known in closed form.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pipeline.arrays import Directions, Floats, Values
from pipeline.compiled import compiled
from pipeline.estimate.inner import InnerBody, inner_body
from pipeline.estimate.tangents import Tangents
from pipeline.geometry.icosphere import icosphere

DEGREE = 10
"""Degree of the finest harmonics: waves of 36 degrees span the holes between the great circles of sixteen views."""
DEGREES = np.repeat(np.arange(DEGREE + 1), 2 * np.arange(DEGREE + 1) + 1)
"""Degree l of each of the harmonics."""
PENALTY = 1e-6
"""Weight of the squared Laplacian beside the mean squared residual: only where too few views leave a hole it counts."""
BULGE_GAIN = 3.0
"""Factor by which the bulge between contacts lessens the inner body's error on smooth bodies: 2.5 to 4 on spheres,
ellipsoids and superellipsoids."""
MIN_WEIGHT = 0.05
"""Weight of the smooth support function below which it is left aside."""
STEP_RAD = 1e-4
"""Half the step of the differences that give the gradient."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothSupport:
    """Coefficients of a support function, in mm, and its rms error for the planes of a view that was left out."""

    coefficients_mm: Values
    error_mm: float

    def heights_mm(self, normals: Directions) -> Values:
        """Return the support function (N,) along normals (N, 3)."""
        return np.asarray(harmonics(normals) @ self.coefficients_mm)

    def slopes_mm(self, normals: Directions, towards: Directions) -> Values:
        """Return its derivatives (N,) at normals (N, 3) towards directions (N, 3) square to them."""
        ahead, behind = (_unit(normals + step * towards) for step in (STEP_RAD, -STEP_RAD))
        return (self.heights_mm(ahead) - self.heights_mm(behind)) / (2 * STEP_RAD)


def fit_support(tangents: Tangents) -> SmoothSupport:
    """Fit a smooth support function to the tangent planes in least squares."""
    values = harmonics(tangents.normals)
    penalty = PENALTY * len(values) * (DEGREES * (DEGREES + 1.0)) ** 2
    inverse = np.linalg.inv(values.T @ values + np.diag(penalty))
    coefficients_mm = inverse @ (values.T @ tangents.offsets_mm)
    residuals_mm = tangents.offsets_mm - values @ coefficients_mm
    squares_mm2 = 0.0
    ends = np.flatnonzero(np.diff(tangents.owners)) + 1
    for own, residual_mm in zip(np.split(values, ends), np.split(residuals_mm, ends), strict=True):
        # what the others predict: the residuals over the share that the view's own planes do not decide
        missed_mm = np.linalg.solve(np.eye(len(own)) - own @ inverse @ own.T, residual_mm)
        squares_mm2 += float(missed_mm @ missed_mm)
    return SmoothSupport(coefficients_mm=coefficients_mm, error_mm=float(np.sqrt(squares_mm2 / len(values))))


def inner_of(tangents: Tangents) -> tuple[Tangents, InnerBody | None]:
    """Return the body that touches all tangent rays, where the planes have it smooth at its smooth points of contact.

    With it the tangents that it touches. On a smooth body a ray touches anywhere on its segment, and the point nearest
    to the other contacts is at one of its ends; the gradient of the smooth support function is far nearer.
    """
    inner = inner_body(tangents)
    if inner is None:
        return tangents, None
    support = fit_support(tangents)
    weight = smooth_weight(support, inner)
    if weight < MIN_WEIGHT:
        return tangents, inner
    tangents = smoothed(tangents, support, weight)
    return tangents, inner_body(tangents)


def smooth_weight(support: SmoothSupport, inner: InnerBody) -> float:
    """Return the weight, 0..1, of the smooth support function against the body that bulges over an inner body.

    Both have independent errors, so weights are inverse to their squares. That of the smooth one is known; the mean
    square of the difference to the inner body is the sum of both.
    """
    corners_mm = inner.points_mm[np.unique(inner.facets.corners)]
    probes, values = _probes()
    difference_mm = (corners_mm @ probes.T).max(axis=0) - values @ support.coefficients_mm
    smooth_mm2 = support.error_mm**2
    bulged_mm2 = max(float((difference_mm**2).mean()) - smooth_mm2, 0.0) / BULGE_GAIN**2
    return bulged_mm2 / (bulged_mm2 + smooth_mm2)


def smoothed(tangents: Tangents, support: SmoothSupport, weight: float) -> Tangents:
    """Move planes, and where they touch, by a share of the way to the smooth support function."""
    normals, directions = tangents.normals, tangents.directions
    across = np.cross(directions, normals)
    heights_mm = support.heights_mm(normals)
    # from each point to where the smooth body touches: its gradient, part by part
    up_mm = heights_mm - _dot(tangents.points_mm, normals)
    across_mm = support.slopes_mm(normals, across) - _dot(tangents.points_mm, across)
    along_mm = support.slopes_mm(normals, directions) - _dot(tangents.points_mm, directions)
    return replace(
        tangents,
        offsets_mm=tangents.offsets_mm + weight * (heights_mm - tangents.offsets_mm),
        points_mm=tangents.points_mm + weight * (up_mm[:, None] * normals + across_mm[:, None] * across),
        low_mm=tangents.low_mm + weight * (along_mm - tangents.low_mm),
        high_mm=tangents.high_mm + weight * (along_mm - tangents.high_mm),
    )


def _dot(one: Floats, other: Floats) -> Values:
    return np.asarray((one * other).sum(axis=1))


def _unit(vectors: Floats) -> Directions:
    return np.asarray(vectors / np.sqrt((vectors * vectors).sum(axis=1, keepdims=True)))


def harmonics(directions: Directions) -> Floats:
    """Return the real spherical harmonics (N, H) up to `DEGREE` along unit directions, of mean square 1, by degree."""
    values, scratch = np.empty((len(DEGREES), len(directions))), np.empty((4, len(directions)))
    _evaluate(np.ascontiguousarray(directions.T), values, scratch)
    return values.T


@compiled
def _evaluate(directions: Floats, values: Floats, scratch: Floats) -> None:
    """Fill in harmonics (H, N) along directions (3, N): in vectors, as these are last; `scratch` is (4, N).

    Of degree l and order m they are P_lm(z) Re and Im (x + i y)^m, at l^2 + l + m and - m: without angles they have no
    poles (Holmes and Featherstone 2002).
    """
    n = directions.shape[1]
    real, imaginary, before, own = scratch[0], scratch[1], scratch[2], scratch[3]
    real[:], imaginary[:] = 1.0, 0.0
    highest = 1.0
    for m in range(DEGREE + 1):
        before[:], own[:] = 0.0, highest
        for degree in range(m, DEGREE + 1):
            middle, after = degree * degree + degree, degree + 1
            scale = np.sqrt((4.0 * after * after - 1) / (after * after - m * m))
            lag = np.sqrt((degree * degree - m * m) / (4.0 * degree * degree - 1)) if degree > m else 0.0
            for i in range(n):
                values[middle - m, i] = own[i] * imaginary[i]
                values[middle + m, i] = (
                    own[i] * real[i]
                )  # after the other: of order 0 there is no imaginary one
                following = scale * (directions[2, i] * own[i] - lag * before[i])
                before[i], own[i] = own[i], following
        for i in range(n):
            x, y = directions[0, i], directions[1, i]
            real[i], imaginary[i] = x * real[i] - y * imaginary[i], x * imaginary[i] + y * real[i]
        highest *= np.sqrt((2.0 * m + 3) / (2 * m + 2)) if m > 0 else np.sqrt(3.0)


@cache
def _probes() -> tuple[Directions, Floats]:
    """Return the directions (642, 3) in which bodies are compared, and their harmonics (642, H)."""
    directions, _ = icosphere(subdivisions=3)
    return directions, harmonics(directions)
