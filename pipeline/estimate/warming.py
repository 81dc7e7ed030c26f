"""Compile what the estimate needs, by estimating a ball made up for it: seconds that the first stone has not."""

import numpy as np
import trimesh

from pipeline.estimate.body import BodyEstimate, estimate_body
from pipeline.meshing import ParticleMesh
from pipeline.rig_design import nominal_rig
from pipeline.segmentation.silhouette import Silhouette, ViewStatus

RADIUS_MM = 5.0


def warm_up() -> BodyEstimate:
    """The estimate of a coarse ball in the middle of the rig as designed."""
    rig = nominal_rig()
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle = RADIUS_MM * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    silhouettes = {
        camera.id: Silhouette(
            camera=camera.id,
            status=ViewStatus.OK,
            image_size_px=camera.image_size_px,
            outline_uv=camera.project(circle @ camera.R[:2])[0],
        )
        for camera in rig.cameras
    }
    ball = trimesh.creation.icosphere(subdivisions=2, radius=RADIUS_MM)
    hull = ParticleMesh(np.array(ball.vertices, np.float64), np.array(ball.faces, np.int64))
    return estimate_body(hull, silhouettes, rig)
