"""The rig as designed, and as a workshop would build it.

Sixteen cameras on a sphere of 300 mm radius, four layers of four at elevations -54, -18, 18 and 54
degrees, adjacent layers staggered by 45 degrees, f = 25 mm, 4 um pixels, 1280 x 1024. The paper's
principal point (640, 480) does not fit that sensor; ours is the image centre (639.5, 511.5).
"""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.arrays import Matrix33, Vector
from pipeline.frames import CameraId
from pipeline.rig.cameras import CameraCalibration, RigCalibration

RADIUS_MM = 300.0
ELEVATIONS_DEG = (-54.0, -18.0, 18.0, 54.0)
FOCAL_MM = 25.0
PIXEL_MM = 0.004
IMAGE_SIZE_PX = (1280, 1024)


def nominal_rig(created_at: str = "1970-01-01T00:00:00Z") -> RigCalibration:
    """Return the rig as designed: cameras `c01`...`c16` layer by layer from the lowest, counter-clockwise from +x."""
    width_px, height_px = IMAGE_SIZE_PX
    focal_px = FOCAL_MM / PIXEL_MM
    K = np.array([[focal_px, 0, (width_px - 1) / 2], [0, focal_px, (height_px - 1) / 2], [0, 0, 1]])
    cameras = []
    for layer, elevation_deg in enumerate(ELEVATIONS_DEG):
        for quarter in range(4):
            azimuth, elevation = np.deg2rad([90 * quarter + 45 * (layer % 2), elevation_deg])
            toward_camera = np.array(
                [
                    np.cos(elevation) * np.cos(azimuth),
                    np.cos(elevation) * np.sin(azimuth),
                    np.sin(elevation),
                ]
            )
            R = looking_along(-toward_camera)
            cameras.append(
                CameraCalibration(
                    id=CameraId(f"c{4 * layer + quarter + 1:02d}"),
                    image_size_px=IMAGE_SIZE_PX,
                    K=K.copy(),
                    distortion=np.zeros(5),
                    R=R,
                    t_mm=-R @ (RADIUS_MM * toward_camera),
                )
            )
    return RigCalibration(name="nominal", method="nominal", created_at=created_at, cameras=tuple(cameras))


def looking_along(direction: Vector) -> Matrix33:
    """Return the world-to-camera rotation of an upright camera that looks along a unit direction."""
    right = np.cross(direction, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction])


def as_built(rig: RigCalibration, seed: int, name: str = "true") -> RigCalibration:
    """Return the rig with the deviations of a workshop, seeded.

    Each camera is turned by 1 degree about a random axis and shifted by 2 mm in a random direction;
    its focal length varies by 1 % (sd), its principal point by up to 15 px, k1 is -0.10 +- 0.05
    (at 6250 px that is 0.1 px in the corner of the image).
    """
    rng = np.random.default_rng(seed)

    def deviated(camera: CameraCalibration) -> CameraCalibration:
        turn = Rotation.from_rotvec(np.deg2rad(1.0) * _unit(rng))
        center_mm = camera.center_mm + 2.0 * _unit(rng)
        R = turn.as_matrix() @ camera.R
        K = camera.K.copy()
        K[[0, 1], [0, 1]] *= 1 + 0.01 * np.clip(rng.normal(), -2.5, 2.5)
        K[:2, 2] += rng.uniform(-15, 15, size=2)
        return replace(
            camera,
            K=K,
            R=R,
            t_mm=-R @ center_mm,
            distortion=np.array([rng.normal(-0.10, 0.05), 0, 0, 0, 0]),
        )

    cameras = tuple(deviated(camera) for camera in rig.cameras)
    return replace(rig, name=name, method="imported", cameras=cameras)


def _unit(rng: np.random.Generator) -> Vector:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))
