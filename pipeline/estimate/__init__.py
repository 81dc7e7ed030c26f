"""An estimate of the body that is nearer to it than the visual hull, from the same silhouettes."""

from pipeline.estimate.body import BodyEstimate, estimate_body, warm_up

__all__ = ["BodyEstimate", "estimate_body", "warm_up"]
