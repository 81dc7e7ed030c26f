"""Eq. (9) of the paper: where viewing rays meet."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def nearest_point(origins_mm: Array, directions: Array) -> Array:
    """(3,) the point of least sum of squared distances to rays from (N, 3) along unit directions (N, 3), N >= 2.

    p = [sum (I - d d^T)]^-1 sum (I - d d^T) c; of parallel rays that of these points that is nearest to the origin.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    return np.linalg.lstsq(across.sum(axis=0), np.einsum("nij,nj->i", across, origins_mm))[0]
