"""The paper's method as parameters of the chain: https://doi.org/10.1051/wujns/2024294301.

The silhouettes are masks of a U2-Net (`segmentation.mask_segmenter`), the rig is calibrated by Algorithm 1
(`calibration.paper`). What follows is here: S by counting cones, the surface by scikit-image's marching cubes at a
level between 15 and 16, and nothing else: no view is left out, no body is estimated, no figure is corrected.
"""

from dataclasses import replace
from math import inf

from pipeline.carving import CarvingParameters
from pipeline.meshing import Mesher, MeshingParameters
from pipeline.particle import BodyParameters, PipelineParameters
from pipeline.views.consistency import ConsistencyParameters

PAPER = PipelineParameters(
    consistency=ConsistencyParameters(
        max_residual_px=inf, max_denied_share=inf, max_tangency_px=inf, max_tangency_ratio=inf
    ),
    carving=CarvingParameters(field="view_count"),
    meshing=MeshingParameters(mesher=Mesher.SKIMAGE),
    body=BodyParameters("hull", texture=False),
)


def paper_at(isolevel: float) -> PipelineParameters:
    """Return the paper's parameters with another level of the surface, from 15 to less than 16."""
    return replace(PAPER, carving=replace(PAPER.carving, isolevel=isolevel))
