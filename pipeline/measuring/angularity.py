"""Gradient angularity of an outline, after AIMS (AASHTO T 381).

AIMS adds up how much the direction theta of the outline's normal changes from one point to the third
next, |theta_i - theta_(i+3)|, over n points. On a convex outline that sum is 3 x 360 degrees whatever
its corners, so it tells rough from smooth, not sharp from round. We add up the squares: their sum is
least for the circle, the one outline that turns evenly, and grows with every corner and every dent.
Values are comparable with each other, not with those of an AIMS device.
"""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

N_POINTS = 180
"""Points of equal distance; three steps are 1/60 of the perimeter, 0.5 mm on a stone of 10 mm."""
STEP = 3
SMOOTHING_STEPS = 1.0
"""Standard deviation of the Gaussian along the outline; hides pixel stairs of a stone of 4 mm and more."""
MAX_ANGULARITY = 10_000.0
OVERSAMPLING = 4
"""The sum is averaged over this many sets of points, each a part of a step further on: no first point."""


def gradient_angularity(contour_uv: ArrayLike) -> float:
    """Angularity 0...10000 of a closed contour (N, 2), N >= 3; the last point joins the first.

    GA = 1/(n/3 - 1) sum_i (theta_i - theta_(i+3))^2 over all n = 180 points, theta in degrees. A circle
    has 110, a square about 1115. Size, position, orientation, sense and first point do not matter.

    Raises
    ------
    ValueError
        The contour has fewer than three distinct points.
    """
    contour = np.asarray(contour_uv, dtype=np.float64)
    if contour.ndim != 2 or contour.shape[1] != 2 or not np.isfinite(contour).all():
        raise ValueError(f"a contour is a finite array (N, 2), not {contour.shape}")
    outline = contour[:, 0] + 1j * contour[:, 1]
    outline = outline[outline != np.roll(outline, 1)]
    if len(outline) < 3:
        raise ValueError("a contour needs three distinct points")
    closed = np.append(outline, outline[0])
    arc = np.append(0.0, np.cumsum(np.abs(np.diff(closed))))
    n = N_POINTS * OVERSAMPLING
    even = np.interp(np.arange(n) * (arc[-1] / n), arc, closed)

    # tangents of the smoothed outline; they turn as the normals do
    tangents = np.fft.ifft(_smooth_derivative(n) * np.fft.fft(even))
    turns_deg = np.rad2deg(np.angle(np.roll(tangents, -STEP * OVERSAMPLING) * tangents.conj()))
    angularity = float(np.sum(turns_deg**2)) / OVERSAMPLING / (N_POINTS / STEP - 1)
    return min(angularity, MAX_ANGULARITY)


@cache
def _smooth_derivative(n: int) -> NDArray[np.complex128]:
    """What the derivative of a smoothed outline of n points has of each frequency."""
    frequency = np.fft.fftfreq(n) * 2 * np.pi
    smooth = np.exp(-((frequency * SMOOTHING_STEPS * OVERSAMPLING) ** 2) / 2)
    factors = np.array(1j * frequency * smooth)
    factors.setflags(write=False)
    return factors
