"""Several calibrated cameras as arrays: what is asked of all views at once is asked of these."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Directions, PointsMM, Vector
from pipeline.rig.cameras import CameraCalibration
from pipeline.rig.lens import undistorted

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class CameraArrays(NamedTuple):
    """Of V cameras."""

    K: Array  # (V, 3, 3) px
    distortion: Array  # (V, 5)
    R: Array  # (V, 3, 3)
    t_mm: Array  # (V, 3)

    @property
    def centers_mm(self) -> Array:
        """Optical centres (V, 3) in the world frame."""
        return -(self.t_mm[:, None] @ self.R)[:, 0]

    @property
    def focals_px(self) -> Array:
        """Mean focal lengths (V,)."""
        return (self.K[:, 0, 0] + self.K[:, 1, 1]) / 2

    def flat_rays(self, pixels_uv: Array, owners: Indices) -> Array:
        """Where viewing rays (N, 2) meet the plane at depth 1 of their own camera, by its index (N,)."""
        return undistorted(pixels_uv, owners, self.K, self.distortion)


def arrays_of(cameras: Sequence[CameraCalibration]) -> CameraArrays:
    """The cameras in their order."""
    each = [(camera.K, camera.distortion, camera.R, camera.t_mm) for camera in cameras]
    # several times as fast as np.array, which looks at every element
    K, distortion, R, t_mm = (np.concatenate(arrays) for arrays in zip(*each, strict=True))
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
