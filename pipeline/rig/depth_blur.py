"""The width that a lens gives to the edge of a body out of focus.

A point at depth z is spread to a disc, the image of the aperture, of diameter c |1 / focus - 1 / z| with
c = focal length in px x aperture in mm (thin lens). Squares of sigmas add up.
"""

from math import pi

import numpy as np

from pipeline.arrays import Values
from pipeline.rig.cameras import CameraCalibration

SIGMA_OF_DISC = 64 / (45 * pi**1.5)
"""Sigma (0.2554) of an edge that a disc of diameter 1 blurs, as `segmentation.edge_width` measures it: sqrt(pi) times
the integral of c (1 - c)."""


def expected_sigma_px(camera: CameraCalibration, depths_mm: Values) -> Values | None:
    """Return the sigma (N,) in px of edges at depths (N,) along the optical axis; None if the lens is not known."""
    if (lens := camera.lens) is None:
        return None
    discs_px = camera.focal_px * lens.aperture_mm * (1 / lens.focus_mm - 1 / depths_mm)
    return np.hypot(lens.blur_px, SIGMA_OF_DISC * discs_px)
