"""The ellipse through an outline that is nearly a circle, and the points that do not belong to it.

A sphere's image is an ellipse whose axes differ by less than 1 % in our field of view. In polar coordinates about
its centre such an ellipse is r + a cos 2t + b sin 2t, and a centre that is off by (x, y) adds x cos t + y sin t:
the fit is linear, repeated about the better centre.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SEARCHED_POINTS = 150
"""So many of the outline are plenty to find out which of them belong to the ellipse."""
N_ARCS = 12
ARC_SHARE = 0.6
"""Of the outline, without a gap, is tried as the ball's own; what hides the rest sits in one place."""
CORE_SIGMAS = 0.842  # 60 % of normal deviates are smaller
OUTLIER_SIGMAS = 4.0
LEAST_OUTLIER_PX = 0.15
"""Nothing closer to the ellipse than this is an outlier, however well the rest fits."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ellipse:
    """Fitted to (N, 2) points."""

    center_uv: Array  # (2,)
    radius_px: float  # mean of the semi-axes
    ellipticity_px: Array  # (2,) a and b; the semi-axes differ by twice their norm
    residuals_px: Array  # (N,) of all the points, positive outside
    is_inlier: NDArray[np.bool_]  # (N,)

    @property
    def rms_px(self) -> float:
        """Of the inliers."""
        return float(np.sqrt(np.mean(self.residuals_px[self.is_inlier] ** 2)))


def fit_ellipse(points_uv: Array) -> Ellipse:
    """The ellipse that most of the points (N, 2), in order along the outline, N >= 12, lie on."""
    center_uv, solution = _likeliest(points_uv[:: max(len(points_uv) // SEARCHED_POINTS, 1)])
    for _ in range(6):
        angles, radii_px = polar(points_uv, center_uv)
        design = harmonics(angles, 2)
        residuals_px = radii_px - design @ solution
        sigma_px = float(np.quantile(np.abs(residuals_px), ARC_SHARE)) / CORE_SIGMAS
        is_inlier = np.abs(residuals_px) <= max(OUTLIER_SIGMAS * sigma_px, LEAST_OUTLIER_PX)
        center_uv, solution = _improved(center_uv, design[is_inlier], radii_px[is_inlier])
    return Ellipse(
        center_uv=center_uv,
        radius_px=float(solution[0]),
        ellipticity_px=solution[3:],
        residuals_px=residuals_px,
        is_inlier=is_inlier,
    )


def _likeliest(points_uv: Array) -> tuple[Array, Array]:
    """Centre (2,) and harmonics (5,) of the ellipse through that arc, of many, which is closest to one."""
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


def _circle_center(points_uv: Array) -> Array:
    """(2,) of the circle of least squared algebraic distance: |p|^2 = 2 p . c + const."""
    relative_uv = points_uv - points_uv.mean(axis=0)
    design = np.column_stack([2 * relative_uv, np.ones(len(relative_uv))])
    return points_uv.mean(axis=0) + np.linalg.lstsq(design, (relative_uv**2).sum(axis=1))[0][:2]


def _improved(center_uv: Array, design: Array, radii_px: Array) -> tuple[Array, Array]:
    """A better centre, and the harmonics (5,) about it."""
    solution = np.linalg.lstsq(design, radii_px)[0]
    shift_uv = solution[1:3]
    return center_uv + shift_uv, np.concatenate([solution[:1], np.zeros(2), solution[3:]])


def polar(points_uv: Array, center_uv: Array) -> tuple[Array, Array]:
    """Angles (N,) in rad and distances (N,) of points (N, 2) about a centre."""
    offsets_uv = points_uv - center_uv
    return np.arctan2(offsets_uv[:, 1], offsets_uv[:, 0]), np.linalg.norm(offsets_uv, axis=1)


def harmonics(angles: Array, order: int) -> Array:
    """Columns 1, cos t, sin t, cos 2t, ... (N, 1 + 2 order)."""
    waves = [wave(k * angles) for k in range(1, order + 1) for wave in (np.cos, np.sin)]
    return np.column_stack([np.ones_like(angles), *waves])
