"""The body refined by the pixels inside the outlines: dents that no silhouette shows."""

from pipeline.refinement.refine import Refinement, refine_body, warm_up

__all__ = ["Refinement", "refine_body", "warm_up"]
