"""Measure one stone: volume, sizes, form and angularity, and how much too large its visual hull is."""

from pipeline.measuring.angularity import gradient_angularity
from pipeline.measuring.hull_bias import sphere_hull_excess
from pipeline.measuring.shape import ShapeMeasurement, measure_shape, warm_up

__all__ = ["ShapeMeasurement", "gradient_angularity", "measure_shape", "sphere_hull_excess", "warm_up"]
