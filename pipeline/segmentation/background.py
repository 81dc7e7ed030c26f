"""What each camera sees of the empty rig: learnt from empty frames, kept up to date slowly.

The model is a running mean per pixel, after the strength of the flash has been divided out. Its
state depends on nothing but the empty frames in their order, so that a recording measured offline,
live, by one worker or by many meets the same background.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId, Frame

SLOWEST_WEIGHT = 0.1
"""Least weight of a new empty frame: the model forgets dust and drift of the light within some tens of them."""
CHANGED_SHARE = 2e-3
"""A frame that differs from the model in a larger share of its pixels is not empty and teaches nothing."""
MAX_REFUSED = 3
"""So many such frames in a row, and it is the model that shows something else: it is learnt anew."""
COARSE = 4
"""Edge of the blocks, in pixels, on which a body is looked for first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraBackground:
    """The empty view of one camera."""

    mean: NDArray[np.float32]  # (H, W) grey level
    n_frames: int
    n_refused: int = 0  # frames in a row that differed from it

    @cached_property
    def coarse(self) -> NDArray[np.float32]:
        """(H/4, W/4) block means."""
        return coarsen(self.mean)

    @cached_property
    def typical(self) -> float:
        """Grey level of the plain wall."""
        return float(np.median(self.coarse))


BackgroundModel = Mapping[CameraId, CameraBackground]


def learn_background(model: BackgroundModel, frames: Mapping[CameraId, Frame]) -> BackgroundModel:
    """The model after one more exposure of the empty rig; cameras without a frame keep their state."""
    learnt = dict(model)
    for camera, frame in frames.items():
        known = model.get(camera)
        image = frame.image.astype(np.float32)
        if known is None or known.mean.shape != image.shape:
            learnt[camera] = CameraBackground(mean=image, n_frames=1)
            continue
        image /= np.float32(flash_gain(coarsen(image), known.coarse))
        if np.mean(np.abs(coarsen(image) - known.coarse) > 0.1 * known.coarse + 4) > CHANGED_SHARE:
            n_refused = known.n_refused + 1
            learnt[camera] = (
                replace(known, n_refused=n_refused)
                if n_refused < MAX_REFUSED
                else CameraBackground(mean=frame.image.astype(np.float32), n_frames=1)
            )
            continue
        weight = np.float32(max(1 / (known.n_frames + 1), SLOWEST_WEIGHT))
        mean = known.mean + weight * (image - known.mean)
        learnt[camera] = CameraBackground(mean=mean, n_frames=known.n_frames + 1)
    return learnt


def flash_gain(coarse: NDArray[np.float32], coarse_background: NDArray[np.float32]) -> float:
    """Strength of this flash relative to the background's, from the blocks that still show it.

    A dark body covers up to half of the image: the gain is the median of the ratios near their
    upper mode, not of all of them.
    """
    # every fourth block each way is plenty for two quantiles
    seen, wall = coarse[::4, ::4], coarse_background[::4, ::4]
    ratios = seen[wall > 16] / wall[wall > 16]
    if ratios.size == 0:
        return 1.0
    bright = float(np.quantile(ratios, 0.9))
    near = ratios[np.abs(ratios - bright) < 0.1 * bright]
    gain = float(np.median(near)) if near.size else bright
    return gain if gain > 0.05 else 1.0


def coarsen(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means (H/4, W/4) of 4x4 blocks; a rest at the right and lower border is left out."""
    height, width = (size // COARSE for size in image.shape)
    blocks = image[: height * COARSE, : width * COARSE]
    return np.asarray(cv2.resize(blocks, (width, height), interpolation=cv2.INTER_AREA))
