"""A better body than the visual hull, from the same silhouettes."""

from pipeline.estimate.body import BodyEstimate, estimate_body
from pipeline.estimate.warming import warm_up

__all__ = ["BodyEstimate", "estimate_body", "warm_up"]
