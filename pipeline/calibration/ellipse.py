"""Fit an ellipse to an outline that is nearly a circle, and find the points that do not belong to it.

A sphere's image is an ellipse whose axes differ by less than 1 % in our field of view. In polar coordinates about
its centre such an ellipse is r + a cos 2t + b sin 2t, and a centre that is off by (x, y) adds x cos t + y sin t:
the fit is linear, and repeated about the improved centre.
"""

from dataclasses import dataclass

import numpy as np

from pipeline.arrays import Flags, Floats, PointsUV, Values, Vector2

SEARCHED_POINTS = 150
"""Number of points of the outline in the search for the first ellipse."""
N_ARCS = 12
"""Number of arcs that are tried."""
ARC_SHARE = 0.6
"""Length of each, as a share of the outline: what hides the ball elsewhere is taken to be in one place."""
CORE_SIGMAS = 0.842
"""60 % (`ARC_SHARE`) of normal deviates are smaller."""
OUTLIER_SIGMAS = 4.0
MIN_OUTLIER_PX = 0.15
"""A point closer to the ellipse is no outlier, however well the others fit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ellipse:
    """An ellipse fitted to N points."""

    center_uv: Vector2
    radius_px: float  # mean of the semi-axes
    ellipticity_px: Vector2  # a and b; the semi-axes differ by twice their norm
    residuals_px: Values  # of all points, positive outside
    is_inlier: Flags

    @property
    def rms_px(self) -> float:
        """Rms residual of the inliers."""
        return float(np.sqrt(np.mean(self.residuals_px[self.is_inlier] ** 2)))


def fit_ellipse(points_uv: PointsUV) -> Ellipse:
    """Return the ellipse on which most of N >= 12 points lie, which are in order along the outline."""
    center_uv, solution = _likeliest(points_uv[:: max(len(points_uv) // SEARCHED_POINTS, 1)])
    for _ in range(6):
        angles, radii_px = polar(points_uv, center_uv)
        design = harmonics(angles, 2)
        residuals_px = radii_px - design @ solution
        sigma_px = float(np.quantile(np.abs(residuals_px), ARC_SHARE)) / CORE_SIGMAS
        is_inlier = np.abs(residuals_px) <= max(OUTLIER_SIGMAS * sigma_px, MIN_OUTLIER_PX)
        center_uv, solution = _improved(center_uv, design[is_inlier], radii_px[is_inlier])
    return Ellipse(
        center_uv=center_uv,
        radius_px=float(solution[0]),
        ellipticity_px=solution[3:],
        residuals_px=residuals_px,
        is_inlier=is_inlier,
    )


def _likeliest(points_uv: PointsUV) -> tuple[Vector2, Values]:
    """Return centre and harmonics (5,) of the ellipse through that one of the arcs which fits an ellipse best."""
    n, best = len(points_uv), np.inf
    n_arc = int(np.ceil(ARC_SHARE * n))
    for start in np.linspace(0, n, N_ARCS, endpoint=False).astype(int):
        arc_uv = points_uv[(start + np.arange(n_arc)) % n]
        tried_uv = _circle_center(arc_uv)
        for _ in range(3):
            angles, radii_px = polar(arc_uv, tried_uv)
            tried_uv, tried = _improved(tried_uv, harmonics(angles, 2), radii_px)
        angles, radii_px = polar(arc_uv, tried_uv)
        rms_px = float(np.sqrt(np.mean((radii_px - harmonics(angles, 2) @ tried) ** 2)))
        if rms_px < best:
            best, center_uv, solution = rms_px, tried_uv, tried
    return center_uv, solution


def _circle_center(points_uv: PointsUV) -> Vector2:
    """Return the centre of the circle of least squared algebraic distance: |p|^2 = 2 p . c + const."""
    relative_uv = points_uv - points_uv.mean(axis=0)
    design = np.column_stack([2 * relative_uv, np.ones(len(relative_uv))])
    return points_uv.mean(axis=0) + np.linalg.lstsq(design, (relative_uv**2).sum(axis=1))[0][:2]


def _improved(center_uv: Vector2, design: Floats, radii_px: Values) -> tuple[Vector2, Values]:
    """Return an improved centre and the harmonics (5,) about it."""
    solution = np.linalg.lstsq(design, radii_px)[0]
    shift_uv = solution[1:3]
    return center_uv + shift_uv, np.concatenate([solution[:1], np.zeros(2), solution[3:]])


def polar(points_uv: PointsUV, center_uv: Vector2) -> tuple[Values, Values]:
    """Return the angles in rad and the distances of points about a centre."""
    offsets_uv = points_uv - center_uv
    return np.arctan2(offsets_uv[:, 1], offsets_uv[:, 0]), np.linalg.norm(offsets_uv, axis=1)


def harmonics(angles: Values, order: int) -> Floats:
    """Return the columns 1, cos t, sin t, cos 2t, ... (N, 1 + 2 order)."""
    waves = [wave(k * angles) for k in range(1, order + 1) for wave in (np.cos, np.sin)]
    return np.column_stack([np.ones_like(angles), *waves])
