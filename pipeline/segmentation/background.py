"""The background model of each camera: learnt from frames of the empty rig, updated slowly, never from a stone.

The model is a running mean per pixel, after the strength of the flash has been divided out. Its
state depends on nothing but the empty frames in their order, so that a recording measured offline,
live, by one worker or by many meets the same background. How the light changes between two empty frames
is estimated from each frame itself (`light`), which needs no state at all.

What differs from the model is not learnt, nor are its surroundings, until three exposures in a row
show the same there: dust on the window stays where it is, what flies does not.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from pipeline.arrays import FloatImage, GreyImage, Mask, Singles
from pipeline.frames import CameraId, Frame
from pipeline.segmentation.light import (
    LIGHT_BLOCK,
    MIN_WALL_GREY,
    SPARSE,
    PlainWall,
    flash_gain,
    gain_from_ratios,
)
from pipeline.segmentation.noise import TYPICAL_NOISE, SensorNoise, sensor_noise

MIN_WEIGHT = 0.1
"""Least weight of a new empty frame: the model forgets dust and drift of the light within some tens of them."""
CHANGED_SHARE = 2e-3
"""Share of changed pixels beyond which a frame is not empty and is not learnt."""
STATIC_SHARE = 0.9
"""Share of a change that the frame before must show equally bright for the change to count as static."""
MAX_REFUSED = 3
"""A change that is static for this many frames belongs to the rig: it is learnt."""
COARSE = 4
"""Edge of the blocks, in pixels, on which a body is looked for first."""
CHANGE_MARGIN = 4
"""Coarse blocks around a change that are not learnt either: the blur of its edge, and its shadow."""
SETTLED_FRAMES = 5
"""Frames after which the mean becomes the flat field of the clean rig, which is kept from then on."""
CLEANED_GAIN, CLEANED_SHARE = 1.1, 0.05
"""Factor and share of the view by which a rig is brighter than its flat field, if that was learnt with dust."""
DARK_SHARE = 0.5
"""A background darker than this share of the wall is a screw, a vent or an aperture and says nothing of the light."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraBackground:
    """The empty view of one camera."""

    mean: FloatImage  # (H, W) grey level
    n_frames: int
    n_refused: int = 0  # frames in a row that showed the same change
    refused: FloatImage | None = None  # (H/4, W/4) the latest of them, the flash divided out
    clean: FloatImage | None = (
        None  # (H/16, W/16) flat field of the clean rig; `None` until the model has settled
    )
    noise: SensorNoise = TYPICAL_NOISE

    @cached_property
    def coarse(self) -> FloatImage:
        """Block means (H/4, W/4)."""
        return coarsen(self.mean)

    @cached_property
    def typical(self) -> float:
        """Grey level of the plain wall."""
        return float(np.median(self.coarse[SPARSE]))

    @cached_property
    def levels(self) -> GreyImage:
        """The mean in whole grey levels (H, W), a quarter of its bytes: rounding is far below an image's noise."""
        return np.asarray(cv2.convertScaleAbs(self.mean), np.uint8)

    @cached_property
    def neighbours(self) -> Singles:
        """The mean at the middle pixel of each block and at the one to its right (H/16, W/16, 2)."""
        height, width = self.plain_wall.levels.shape
        edge = COARSE * LIGHT_BLOCK
        rows = self.mean[edge // 2 :: edge][:height]
        return np.stack([rows[:, edge // 2 + side :: edge][:, :width] for side in (0, 1)], axis=2)

    @cached_property
    def coarse_levels(self) -> GreyImage:
        """Block means in whole grey levels (H/4, W/4)."""
        return np.asarray(cv2.convertScaleAbs(self.coarse), np.uint8)

    @cached_property
    def coarse_darkest(self) -> GreyImage:
        """The least block mean of each block and its neighbours (H/4, W/4)."""
        return np.asarray(cv2.erode(self.coarse_levels, np.ones((3, 3), np.uint8)), np.uint8)

    @cached_property
    def plain_wall(self) -> PlainWall:
        """The wall that the light is estimated from (H/16, W/16)."""
        levels = coarsen(self.coarse)
        return PlainWall(levels=levels, is_plain=np.asarray(levels > DARK_SHARE * self.typical))

    @cached_property
    def flat_field(self) -> FloatImage:
        """The rig as it was when it was clean (H/16, W/16), which the mean slowly forgets."""
        return self.plain_wall.levels if self.clean is None else self.clean

    @cached_property
    def shows_wall(self) -> Mask:
        """Blocks that show plain wall (H/16, W/16)."""
        field = self.flat_field
        return np.asarray(field > DARK_SHARE * np.median(field))

    def gain(self, seen: GreyImage) -> float:
        """Return the strength of the flash in which blocks (H/4, W/4) were seen, see `flash_gain`."""
        is_lit, levels = self._flash_wall
        return gain_from_ratios(np.divide(seen[SPARSE][is_lit], levels, dtype=np.float32))

    @cached_property
    def _flash_wall(self) -> tuple[Mask, Singles]:
        """Choose the sparse blocks that the flash is estimated from, with their means (N,)."""
        wall = np.maximum(self.coarse[SPARSE], 1)
        is_lit = np.asarray(wall > MIN_WALL_GREY)
        return is_lit, wall[is_lit]


BackgroundModel = Mapping[CameraId, CameraBackground]


def learn_background(model: BackgroundModel, frames: Mapping[CameraId, Frame]) -> BackgroundModel:
    """Return the model after one more exposure of the empty rig; cameras without a frame keep their state."""
    learnt = dict(model)
    for camera, frame in frames.items():
        known, image = model.get(camera), frame.image.astype(np.float32)
        learnt[camera] = (
            _new_model(image) if known is None or known.mean.shape != image.shape else _updated(known, image)
        )
    return learnt


def _new_model(image: FloatImage, clean: FloatImage | None = None) -> CameraBackground:
    return CameraBackground(mean=image, n_frames=1, clean=clean, noise=sensor_noise(image))


def _updated(known: CameraBackground, image: FloatImage) -> CameraBackground:
    """Return the model of one camera after one more image (H, W)."""
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
        if is_new_wall:  # begin anew: the model may have begun with a stone in view
            return _new_model(image, clean=None if _was_cleaned(image, known.clean) else known.clean)
        return replace(known, n_refused=n_refused, refused=refused)
    weight = max(1 / (known.n_frames + 1), MIN_WEIGHT)
    mean = np.asarray(cv2.addWeighted(known.mean, 1 - weight, image, weight / gain, 0), np.float32)
    if changed.any():
        _replace_changed(mean, image / np.float32(gain) if is_new_wall else known.mean, changed)
    n_frames = known.n_frames + 1
    clean = known.clean
    if clean is None and n_frames >= SETTLED_FRAMES:
        clean = coarsen(coarsen(mean))
    noise = SensorNoise(
        *(
            weight * new + (1 - weight) * old
            for new, old in zip(sensor_noise(image), known.noise, strict=True)
        )
    )
    return CameraBackground(
        mean=mean, n_frames=n_frames, n_refused=n_refused, refused=refused, clean=clean, noise=noise
    )


def _was_cleaned(image: FloatImage, clean: FloatImage | None) -> bool:
    """True when dust that the flat field (H/16, W/16) was learnt with is gone: the flat field must be renewed."""
    return clean is not None and bool(
        np.mean(coarsen(coarsen(image)) > CLEANED_GAIN * np.maximum(clean, 1)) > CLEANED_SHARE
    )


def _differs(coarse: FloatImage, other: FloatImage) -> Mask:
    return np.asarray(np.abs(coarse - other) > 0.1 * other + 4)


def _replace_changed(mean: FloatImage, image: FloatImage, changed: Mask) -> None:
    """Copy `image` (H, W) into `mean` where blocks (H/4, W/4) have changed, and around them."""
    around = cv2.dilate(changed.astype(np.uint8), np.ones((2 * CHANGE_MARGIN + 1,) * 2, np.uint8))
    height, width = mean.shape
    place = cv2.resize(around, (width, height), interpolation=cv2.INTER_NEAREST).astype(bool)
    mean[place] = image[place]


def coarsen(image: FloatImage) -> FloatImage:
    """Return the means (H/4, W/4) of 4 x 4 blocks, at least one; incomplete ones at right and bottom are left out."""
    height, width = (max(size // COARSE, 1) for size in image.shape)
    blocks = image[: height * COARSE, : width * COARSE]
    halved = cv2.resize(
        blocks, (2 * width, 2 * height), interpolation=cv2.INTER_AREA
    )  # by 4 takes twice as long
    return np.asarray(cv2.resize(halved, (width, height), interpolation=cv2.INTER_AREA))
