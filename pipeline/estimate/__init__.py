"""A better body than the visual hull, from the same silhouettes."""

from pipeline.estimate.body import BodyEstimate, estimate_body

__all__ = ["BodyEstimate", "estimate_body"]
