"""What each camera sees of the empty rig: learnt from empty frames, kept up to date slowly, never from a stone.

The model is a running mean per pixel, after the strength of the flash has been divided out. Its
state depends on nothing but the empty frames in their order, so that a recording measured offline,
live, by one worker or by many meets the same background. What the light does between two empty frames
is read off each frame itself (`light`), which needs no state at all.

What differs from the model is not learnt, in its place and around it, until three exposures in a row
show the same there: dust on the window stays where it is, what flies does not.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId, Frame
from pipeline.segmentation.light import LEAST_GREY, LIT, SPARSE, PlainWall, flash_gain, gain_of

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

SLOWEST_WEIGHT = 0.1
"""Least weight of a new empty frame: the model forgets dust and drift of the light within some tens of them."""
CHANGED_SHARE = 2e-3
"""A frame that differs from the model in a larger share of its pixels is not empty and teaches nothing."""
STATIC_SHARE = 0.9
"""A change of which so much was there in the frame before, equally bright, has not moved."""
MAX_REFUSED = 3
"""A change that stood still for so many frames is the rig's: it is learnt."""
COARSE = 4
"""Edge of the blocks, in pixels, on which a body is looked for first."""
CAUTION = 4
"""Coarse blocks around a change that are not learnt either: the blur of its edge, and its shadow."""
SETTLED = 5
"""Frames that the flat field of the clean rig rests on; it is kept from then on, whatever the mean learns."""
BRIGHTER, BRIGHTER_SHARE = 1.1, 0.05
"""Of a rig that has become so much brighter than the clean one in such a share of the view, that one was not clean."""
DARK = 0.5
"""A background darker than this share of the wall is a screw, a vent or an aperture and says nothing of the light."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraBackground:
    """The empty view of one camera."""

    mean: Array  # (H, W) grey level
    n_frames: int
    n_refused: int = 0  # frames in a row that showed the same change
    refused: Array | None = None  # (H/4, W/4) the latest of them, the flash divided out
    clean: Array | None = None  # (H/16, W/16) flat field of the clean rig; `None`: the mean is all there is

    @cached_property
    def coarse(self) -> Array:
        """(H/4, W/4) block means."""
        return coarsen(self.mean)

    @cached_property
    def typical(self) -> float:
        """Grey level of the plain wall."""
        return float(np.median(self.coarse[SPARSE]))

    @cached_property
    def levels(self) -> Grey:
        """(H, W) the mean in whole grey levels, a quarter of its bytes: rounding is far below an image's noise."""
        return np.asarray(cv2.convertScaleAbs(self.mean), np.uint8)

    @cached_property
    def neighbours(self) -> Array:
        """(H/16, W/16, 2) the mean at the middle pixel of each block, and at the one to its right."""
        height, width = self.plain_wall.levels.shape
        edge = COARSE * LIT
        rows = self.mean[edge // 2 :: edge][:height]
        return np.stack([rows[:, edge // 2 + side :: edge][:, :width] for side in (0, 1)], axis=2)

    @cached_property
    def coarse_levels(self) -> Grey:
        """(H/4, W/4) block means in whole grey levels."""
        return np.asarray(cv2.convertScaleAbs(self.coarse), np.uint8)

    @cached_property
    def coarse_darkest(self) -> Grey:
        """(H/4, W/4) the least block mean of each block and its neighbours."""
        return np.asarray(cv2.erode(self.coarse_levels, np.ones((3, 3), np.uint8)), np.uint8)

    @cached_property
    def plain_wall(self) -> PlainWall:
        """(H/16, W/16) what the light is read off."""
        levels = coarsen(self.coarse)
        return PlainWall(levels=levels, is_plain=np.asarray(levels > DARK * self.typical))

    @cached_property
    def flat_field(self) -> Array:
        """(H/16, W/16) the rig as it was when it was clean, which the mean slowly forgets."""
        return self.plain_wall.levels if self.clean is None else self.clean

    @cached_property
    def shows_wall(self) -> Mask:
        """(H/16, W/16) blocks of plain wall."""
        field = self.flat_field
        return np.asarray(field > DARK * np.median(field))

    def gain(self, seen: Grey) -> float:
        """Strength of the flash in which blocks (H/4, W/4) were seen, see `flash_gain`."""
        is_lit, levels = self._flash_wall
        return gain_of(np.divide(seen[SPARSE][is_lit], levels, dtype=np.float32))

    @cached_property
    def _flash_wall(self) -> tuple[Mask, Array]:
        """What that is read off: which of the sparse blocks, and the means (N,) of these."""
        wall = np.maximum(self.coarse[SPARSE], 1)
        is_lit = np.asarray(wall > LEAST_GREY)
        return is_lit, wall[is_lit]


BackgroundModel = Mapping[CameraId, CameraBackground]


def learn_background(model: BackgroundModel, frames: Mapping[CameraId, Frame]) -> BackgroundModel:
    """The model after one more exposure of the empty rig; cameras without a frame keep their state."""
    learnt = dict(model)
    for camera, frame in frames.items():
        known, image = model.get(camera), frame.image.astype(np.float32)
        learnt[camera] = (
            _begun(image) if known is None or known.mean.shape != image.shape else _learnt(known, image)
        )
    return learnt


def _begun(image: Array, clean: Array | None = None) -> CameraBackground:
    return CameraBackground(mean=image, n_frames=1, clean=clean)


def _learnt(known: CameraBackground, image: Array) -> CameraBackground:
    """The model of one camera after one more image (H, W)."""
    coarse = coarsen(image)
    gain = flash_gain(coarse, known.coarse)
    coarse /= np.float32(gain)
    changed = _differs(coarse, known.coarse)
    n_refused = 0
    if changed.any():
        is_static = known.refused is not None and (
            np.mean(
                _differs(known.refused, known.coarse)[changed] & ~_differs(coarse, known.refused)[changed]
            )
            >= STATIC_SHARE
        )
        n_refused = known.n_refused + 1 if is_static else 1
    is_new_wall = n_refused >= MAX_REFUSED
    refused = coarse if changed.any() and not is_new_wall else None
    if np.mean(changed) > CHANGED_SHARE:
        if is_new_wall:  # a model that never settled began with a stone, and its flat field with it
            return _begun(image, clean=None if _is_cleaned(image, known.clean) else known.clean)
        return replace(known, n_refused=n_refused, refused=refused)
    weight = max(1 / (known.n_frames + 1), SLOWEST_WEIGHT)
    mean = np.asarray(cv2.addWeighted(known.mean, 1 - weight, image, weight / gain, 0), np.float32)
    if changed.any():
        _put(mean, image / np.float32(gain) if is_new_wall else known.mean, changed)
    n_frames = known.n_frames + 1
    clean = known.clean
    if clean is None and n_frames >= SETTLED:
        clean = coarsen(coarsen(mean))
    return CameraBackground(mean=mean, n_frames=n_frames, n_refused=n_refused, refused=refused, clean=clean)


def _is_cleaned(image: Array, clean: Array | None) -> bool:
    """Whether dust that the flat field (H/16, W/16) was learnt with is gone: kept, it would be missed for ever."""
    return clean is not None and bool(
        np.mean(coarsen(coarsen(image)) > BRIGHTER * np.maximum(clean, 1)) > BRIGHTER_SHARE
    )


def _differs(coarse: Array, other: Array) -> Mask:
    return np.asarray(np.abs(coarse - other) > 0.1 * other + 4)


def _put(mean: Array, image: Array, changed: Mask) -> None:
    """Copy `image` (H, W) into `mean` in the changed blocks (H/4, W/4) and around them."""
    around = cv2.dilate(changed.astype(np.uint8), np.ones((2 * CAUTION + 1,) * 2, np.uint8))
    height, width = mean.shape
    place = cv2.resize(around, (width, height), interpolation=cv2.INTER_NEAREST).astype(bool)
    mean[place] = image[place]


def coarsen(image: NDArray[np.float32]) -> Array:
    """Means (H/4, W/4), at least one, of 4x4 blocks; a rest at the right and lower border is left out."""
    height, width = (max(size // COARSE, 1) for size in image.shape)
    blocks = image[: height * COARSE, : width * COARSE]
    halved = cv2.resize(
        blocks, (2 * width, 2 * height), interpolation=cv2.INTER_AREA
    )  # by 4 takes twice as long
    return np.asarray(cv2.resize(halved, (width, height), interpolation=cv2.INTER_AREA))
