"""Compile what measuring needs, by measuring a ball: seconds that the first stone has not."""

import numpy as np

from pipeline.geometry.icosphere import icosphere
from pipeline.measuring.angularity import gradient_angularity
from pipeline.measuring.shape import ShapeMeasurement, measure_shape

RADIUS_MM = 5.0


def warm_up() -> ShapeMeasurement:
    """The shape of a coarse ball."""
    directions, faces = icosphere(subdivisions=2)
    vertices_mm = RADIUS_MM * directions
    angle = np.linspace(0, 2 * np.pi, 100, endpoint=False)
    gradient_angularity(np.column_stack([np.cos(angle), np.sin(angle)]))
    return measure_shape(vertices_mm, faces)
