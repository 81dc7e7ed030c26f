"""Several calibrated cameras as arrays, for what is computed for all views at once."""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np

from pipeline.arrays import Directions, Floats, Indices, PointsMM, PointsUV, Values, Vector
from pipeline.rig.cameras import CameraCalibration
from pipeline.rig.lens import normalized_coordinates


class CameraArrays(NamedTuple):
    """The calibrations of V cameras."""

    K: Annotated[Floats, "(V, 3, 3)"]  # px
    distortion: Annotated[Floats, "(V, 5)"]
    R: Annotated[Floats, "(V, 3, 3)"]
    t_mm: PointsMM  # (V, 3)

    @property
    def centers_mm(self) -> PointsMM:
        """Optical centres (V, 3) in the world frame."""
        return -(self.t_mm[:, None] @ self.R)[:, 0]

    @property
    def focals_px(self) -> Values:
        """Mean focal lengths (V,)."""
        return (self.K[:, 0, 0] + self.K[:, 1, 1]) / 2

    def normalized_coordinates(self, pixels_uv: PointsUV, owners: Indices) -> PointsUV:
        """Return the undistorted image coordinates (x/z, y/z) of pixels (N, 2), each seen by camera `owners` (N,)."""
        return normalized_coordinates(pixels_uv, owners, self.K, self.distortion)

    def subset(self, kept: Sequence[int]) -> "CameraArrays":
        """Return the cameras with these indices."""
        return CameraArrays(*(array[kept] for array in self))


def camera_arrays(cameras: Sequence[CameraCalibration]) -> CameraArrays:
    """Return the cameras as arrays, in their order."""
    if not cameras:
        return CameraArrays(np.empty((0, 3, 3)), np.empty((0, 5)), np.empty((0, 3, 3)), np.empty((0, 3)))
    calibrations = [(camera.K, camera.distortion, camera.R, camera.t_mm) for camera in cameras]
    # several times as fast as np.array, which inspects every element
    K, distortion, R, t_mm = (np.concatenate(arrays) for arrays in zip(*calibrations, strict=True))
    return CameraArrays(
        K.reshape(-1, 3, 3), distortion.reshape(-1, 5), R.reshape(-1, 3, 3), t_mm.reshape(-1, 3)
    )


def nearest_point(origins_mm: PointsMM, directions: Directions) -> Vector:
    """Return the point of least sum of squared distances to N >= 2 rays, eq. (9) of the paper.

    p = [sum (I - d d^T)]^-1 sum (I - d d^T) c for rays from c along the unit vectors d; where all are parallel, the
    one of these points that is nearest to the origin.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    return np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, origins_mm))[0]
