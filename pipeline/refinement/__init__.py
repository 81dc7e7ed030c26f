"""The body refined by the pixels inside the outlines: dents that no silhouette shows."""

from pipeline.refinement.refine import Refinement, refine_body, warm_up
from pipeline.refinement.sightings import photo_views
from pipeline.refinement.texture import vertex_greys
from pipeline.refinement.texture import warm_up as warm_up_texture

__all__ = ["Refinement", "photo_views", "refine_body", "vertex_greys", "warm_up", "warm_up_texture"]
