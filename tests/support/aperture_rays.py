"""The coverage of a body through a lens of finite aperture, by rays: slow, and independent of `pipeline.synthesis`."""

import numpy as np
import trimesh
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from scipy.stats import qmc

from pipeline.arrays import FloatImage
from pipeline.rig.cameras import CameraCalibration

LOG2_RAYS = 9
"""Binary logarithm of the number of rays of a pixel, whose mean is within about 1 % of the coverage."""


def coverage_by_rays(
    mesh: trimesh.Trimesh,
    camera: CameraCalibration,
    *,
    aperture_mm: float,
    focus_mm: float,
    corner_uv: tuple[int, int],
    size_px: tuple[int, int],
) -> FloatImage:
    """Return the share (height, width) of the rays of each pixel that hit a mesh in the world frame.

    A ray leads from a point of the aperture to where the ray of the lens's centre meets the plane in focus.
    """
    scene = EmbreeScene()
    points_mm = mesh.vertices @ camera.R.T + camera.t_mm  # camera frame
    TriangleMesh(scene, points_mm.astype(np.float32), mesh.faces.astype(np.int32))
    u, v = np.meshgrid(np.arange(size_px[0]) + corner_uv[0], np.arange(size_px[1]) + corner_uv[1])
    pixels_uv = np.column_stack([u.ravel(), v.ravel()])
    hits = np.zeros(len(pixels_uv))
    samples = qmc.Sobol(4, rng=1).random_base2(LOG2_RAYS)
    for du, dv, radius, turn in samples:
        through = camera.normalized_coordinates(pixels_uv + np.array([du - 0.5, dv - 0.5]))
        in_focus_mm = focus_mm * np.column_stack([through, np.ones(len(through))])
        polar = aperture_mm / 2 * np.sqrt(radius), 2 * np.pi * turn
        origin_mm = np.array([polar[0] * np.cos(polar[1]), polar[0] * np.sin(polar[1]), 0.0])
        rays = (in_focus_mm - origin_mm).astype(np.float32)
        origins_mm = np.broadcast_to(origin_mm.astype(np.float32), rays.shape)
        hits += scene.run(np.ascontiguousarray(origins_mm), rays) >= 0
    return (hits / len(samples)).reshape(size_px[1], size_px[0]).astype(np.float32)
