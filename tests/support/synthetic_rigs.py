"""Small synthetic rigs: the design with fewer cameras or fewer, larger pixels, and no randomness of light."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import nominal_rig
from pipeline.synthesis.bodies import Body
from pipeline.synthesis.exposure import ExposureParameters
from pipeline.synthesis.renderer import PlacedBody

QUIET = ExposureParameters(exposure_us=0, flash_sd=0, camera_flash_sd=0, read_noise=0, shot_noise=0)
"""No motion, no noise, no flicker."""


def rig_of(*camera_ids: str, binning: int = 1) -> RigCalibration:
    """Some cameras of the nominal rig, with `binning` x `binning` pixels in one."""
    rig = nominal_rig().subset(CameraId(name) for name in camera_ids)
    cameras = []
    for camera in rig.cameras:
        width, height = camera.image_size_px
        size_px = (width // binning, height // binning)
        K = camera.K.copy()
        K[:2] /= binning
        K[:2, 2] = (size_px[0] - 1) / 2, (size_px[1] - 1) / 2
        cameras.append(replace(camera, image_size_px=size_px, K=K))
    return replace(rig, cameras=tuple(cameras))


def upright(body: Body, offset_mm: Sequence[float] = (0, 0, 0)) -> PlacedBody:
    """The body as it stands in its own frame."""
    return PlacedBody(body=body, R=np.eye(3), offset_mm=np.array(offset_mm, dtype=float))
