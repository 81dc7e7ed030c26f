"""Gradient angularity of an outline, after AIMS (AASHTO T 381).

AIMS adds up how much the direction theta of the outline's normal changes from one point to the third
next, |theta_i - theta_(i+3)|, over n points. On a convex outline that sum is 3 x 360 degrees whatever
its corners, so it tells rough from smooth, not sharp from round. We add up the squares: their sum is
least for the circle, the one outline that turns evenly, and grows with every corner and every dent.
Values are comparable with each other, not with those of an AIMS device.
"""

import numpy as np
from numpy.typing import ArrayLike

from pipeline.arrays import Floats, PointsUV, Values
from pipeline.compiled import compiled

N_POINTS = 180
"""Equally spaced points along the outline; three steps are 1/60 of the perimeter, 0.5 mm on a stone of 10 mm."""
STEP = 3
"""Number of points between the two directions that are compared, as in AIMS."""
SMOOTHING_STEPS = 1.0
"""Standard deviation, in points, of the Gaussian along the outline; hides pixel stairs on stones from 4 mm on."""
MAX_ANGULARITY = 10_000.0
OVERSAMPLING = 4
"""Number of sets of points, each shifted by a part of a step, over which the sum is averaged: the result does not
depend on which point of the outline is the first."""
REACH = round(7 * SMOOTHING_STEPS * OVERSAMPLING)
"""Half-width of the smoothing kernel in oversampled points; 1e-11 of the Gaussian lies beyond."""


def gradient_angularity(contour_uv: ArrayLike) -> float:
    """Return the angularity, 0...10000, of a closed contour (N, 2), N >= 3, whose last point joins the first.

    GA = 1/(n/3 - 1) sum_i (theta_i - theta_(i+3))^2 over all n = 180 points, theta in degrees. A circle
    has 110, a square about 1115. Size, position, orientation, sense and first point do not matter.

    Raises
    ------
    ValueError
        The contour has fewer than three distinct points.
    """
    contour = np.ascontiguousarray(contour_uv, dtype=np.float64)
    if contour.ndim != 2 or contour.shape[1] != 2 or not np.isfinite(contour).all():
        raise ValueError(f"a contour is a finite array (N, 2), not {contour.shape}")
    n = N_POINTS * OVERSAMPLING
    arc, even, tangents = np.empty(len(contour) + 1), np.empty((2, n + 2 * REACH)), np.zeros((2, n))
    squares = _squared_turns(contour, arc, even, tangents)
    if squares < 0:
        raise ValueError("a contour needs three distinct points")
    angularity = np.rad2deg(np.rad2deg(squares)) / OVERSAMPLING / (N_POINTS / STEP - 1)
    return min(float(angularity), MAX_ANGULARITY)


@compiled
def _squared_turns(contour: PointsUV, arc: Values, even: Floats, tangents: Floats) -> float:
    """Return the sum of squared turns of the smoothed outline in rad^2, or -1 if fewer than three points differ.

    Work arrays: `arc` (N + 1,) takes the arc length at each point and back at the first, `even` (2, n + 2 REACH) the n
    equally spaced points with `REACH` of them repeated beyond either end, `tangents` (2, n), zeros, their tangents.
    """
    n_points, n = len(contour), tangents.shape[1]
    arc[0] = 0.0
    n_distinct = 0
    for i in range(n_points):
        following = i + 1 if i + 1 < n_points else 0
        du, dv = contour[following, 0] - contour[i, 0], contour[following, 1] - contour[i, 1]
        n_distinct += du != 0 or dv != 0
        arc[i + 1] = arc[i] + np.sqrt(du * du + dv * dv)
    if n_distinct < 3:
        return -1.0

    i = 0
    for k in range(n):
        along = k * (arc[n_points] / n)
        while arc[i + 1] <= along:
            i += 1
        share = (along - arc[i]) / (arc[i + 1] - arc[i])
        following = i + 1 if i + 1 < n_points else 0
        for axis in range(2):
            start = contour[i, axis]
            even[axis, REACH + k] = start + share * (contour[following, axis] - start)
    for axis in range(2):
        for k in range(REACH):
            even[axis, k] = even[axis, n + k]
            even[axis, REACH + n + k] = even[axis, REACH + k]

    # tangents of the smoothed outline, not of unit length; they turn as the normals do
    for k in range(1, REACH + 1):
        weight = k * np.exp(-((k / (SMOOTHING_STEPS * OVERSAMPLING)) ** 2) / 2)
        for axis in range(2):
            for i in range(n):
                tangents[axis, i] += weight * (even[axis, REACH + i + k] - even[axis, REACH + i - k])

    squares = 0.0
    for i in range(n):
        later = (i + STEP * OVERSAMPLING) % n
        u, v, later_u, later_v = tangents[0, i], tangents[1, i], tangents[0, later], tangents[1, later]
        squares += np.arctan2(u * later_v - v * later_u, u * later_u + v * later_v) ** 2
    return squares
