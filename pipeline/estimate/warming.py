"""Compile what the estimate needs, by estimating a ball made up for it: seconds that the first stone has not."""

from pipeline.estimate.body import BodyEstimate, estimate_body
from pipeline.geometry.icosphere import icosphere
from pipeline.meshing import ParticleMesh
from pipeline.rig.design import nominal_rig
from pipeline.segmentation.ball_silhouettes import RADIUS_MM, ball_silhouettes
from pipeline.views.prepared import prepare_views


def warm_up() -> BodyEstimate:
    """The estimate of a coarse ball in the middle of the rig as designed."""
    rig = nominal_rig()
    directions, faces = icosphere(subdivisions=2)
    hull = ParticleMesh(RADIUS_MM * directions, faces)
    return estimate_body(hull, prepare_views(ball_silhouettes(rig), rig))
