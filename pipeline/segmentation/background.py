"""What each camera sees of the empty rig: learnt from empty frames, kept up to date slowly, never from a stone.

The model is a running mean per pixel, after the strength of the flash has been divided out. Its
state depends on nothing but the empty frames in their order, so that a recording measured offline,
live, by one worker or by many meets the same background. What the light does between two empty frames
is read off each frame itself (`uneven_light`), which needs no state at all.

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
LIT = 4
"""Edge of the blocks, in coarse ones, on which the light is judged."""
DARK = 0.5
"""A background darker than this share of the wall is a screw, a vent or an aperture and says nothing of the light."""
UNLIKE = 0.1
"""What the fitted light misses by more than this share may be no wall: body, shadow, glint, or a dusty patch."""
NEAR, STEP, MAX_STEPS = 1.5, 0.05, 16
"""The light is followed into such a patch a few blocks at a time, no steeper than this, and so often."""
FADING = np.float32(1e-3)
"""Weight of the fitted light itself: it is all there is where no wall is near."""
MAX_SAMPLES = 320
MIN_SAMPLES = 24
RIDGE = 1e-4
"""Blocks of plain wall that the light is fitted to."""
APPROACH = ((3, 0.4), (3, 0.2), (3, 0.12), (6, 0.1), (6, 0.06))
"""Steps of the fit: terms of the polynomial, and the relative deviation up to which a block takes part."""
EVEN, EVEN_SHARE = 0.015, 0.05
"""The light is a factor and no more if so few blocks, those at the outline of a body, differ from it by more."""
REACH = 3.0
"""Standard deviation, in blocks of light, over which a local deviation of the light is carried on."""


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
        return float(np.median(self.coarse))

    @cached_property
    def blocks(self) -> Array:
        """(H/16, W/16) means of the blocks on which the light is judged."""
        return coarsen(self.coarse)

    @cached_property
    def plain(self) -> Mask:
        """(H/16, W/16) the blocks of plain wall."""
        return np.asarray(self.blocks > DARK * self.typical)

    @cached_property
    def flat_field(self) -> Array:
        """(H/16, W/16) the rig as it was when it was clean, which the mean slowly forgets."""
        return self.blocks if self.clean is None else self.clean

    @cached_property
    def shows_wall(self) -> Mask:
        """(H/16, W/16) blocks of plain wall."""
        field = self.flat_field
        return np.asarray(field > DARK * np.median(field))


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
    gain = np.float32(flash_gain(coarsen(image), known.coarse))
    steady = image / gain
    coarse = coarsen(steady)
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
    weight = np.float32(max(1 / (known.n_frames + 1), SLOWEST_WEIGHT))
    mean = known.mean + weight * (steady - known.mean)
    if changed.any():
        _put(mean, steady if is_new_wall else known.mean, changed)
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


def flash_gain(coarse: NDArray[np.generic], coarse_background: Array) -> float:
    """Strength of this flash relative to the background's, from the blocks that still show it.

    A dark body covers up to half of the image: the gain is the median of the ratios near their
    upper mode, not of all of them.
    """
    # every fourth block each way is plenty for two quantiles
    seen, wall = coarse[::4, ::4], coarse_background[::4, ::4]
    is_seen = wall > 16
    ratios: Array = seen[is_seen].astype(np.float32) / wall[is_seen]
    if ratios.size == 0:
        return 1.0
    rank = ratios.size // 10
    bright = float(np.partition(ratios, -rank - 1)[-rank - 1])
    near = ratios[np.abs(ratios - bright) < 0.1 * bright]
    middle = ((near.size - 1) // 2, near.size // 2)  # a third of the time that np.median takes
    gain = float(np.partition(near, middle)[list(middle)].mean()) if near.size else bright
    return gain if gain > 0.05 else 1.0


def coarsen(image: NDArray[np.float32]) -> Array:
    """Means (H/4, W/4), at least one, of 4x4 blocks; a rest at the right and lower border is left out."""
    height, width = (max(size // COARSE, 1) for size in image.shape)
    blocks = image[: height * COARSE, : width * COARSE]
    return np.asarray(cv2.resize(blocks, (width, height), interpolation=cv2.INTER_AREA))


def uneven_light(coarse: NDArray[np.generic], known: CameraBackground, gain: float) -> Array | None:
    """Strength of the light at each place, on top of the flash's, from the frame itself; `None`: it is even.

    A flash differs by a factor, a panel that fails by a slope, dust on the window by patches: a quadratic in
    both coordinates is fitted to the plain wall, and from the blocks that agree with it the light is
    followed outwards, as long as it changes slowly. A body is not followed, for its outline is a step: beneath
    it, and a little around it, the light is what its surroundings say.

    Parameters
    ----------
    coarse
        (H/4, W/4) block means of the frame, or one pixel of each block.
    gain
        Strength of the flash, see `flash_gain`.

    Returns
    -------
    array
        (H/4, W/4) factors, smooth over some `LIT` * `REACH` blocks.
    """
    seen, is_wall = coarsen(coarse.astype(np.float32, copy=False)), known.plain
    ratio: Array = np.divide(seen, np.maximum(known.blocks * np.float32(gain), 1), dtype=np.float32)
    error = np.abs(ratio - 1)
    if np.count_nonzero((error > EVEN) & (error < UNLIKE) & is_wall) < EVEN_SHARE * ratio.size:
        return None
    fitted = fitted_light(ratio, is_wall)
    left = ratio / fitted
    is_lit = is_wall & (np.abs(left - 1) < UNLIKE)
    for _ in range(MAX_STEPS):
        near = _carried(left, is_lit, NEAR)
        grown = is_wall & (np.abs(left - near) < STEP * near)
        if np.array_equal(grown, is_lit):
            break
        is_lit = grown
    light = fitted * _carried(left, is_lit, REACH)
    return np.asarray(cv2.resize(light, coarse.shape[::-1], interpolation=cv2.INTER_LINEAR))


def _carried(values: Array, is_known: Mask, reach: float) -> Array:
    """Values (h, w) carried on from where they are known, and all around known, fading to 1."""
    known = cv2.erode(is_known.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.float32)
    weight = cv2.GaussianBlur(known, (0, 0), reach)
    above = cv2.GaussianBlur((values - 1) * known, (0, 0), reach)
    return np.asarray(1 + above / (weight + FADING))


def fitted_light(ratio: Array, is_wall: Mask) -> Array:
    """Quadratic (h, w) through the ratios (h, w) of the plain wall.

    A stone covers up to half of the view and is darker as a rule: the fit begins at the upper mode, with a
    plane, and closes in on those blocks that agree.
    """
    h, w = ratio.shape
    x = (np.arange(w, dtype=np.float32) * 2 - w + 1) / w
    y = ((np.arange(h, dtype=np.float32) * 2 - h + 1) / h)[:, None]
    step = max(1, round((ratio.size / MAX_SAMPLES) ** 0.5))
    few = (slice(step // 2, None, step),) * 2
    chosen = is_wall[few]
    values = ratio[few][chosen]
    light = np.median(values) if len(values) else np.float32(1)
    if len(values) >= MIN_SAMPLES:
        light = np.sort(values)[-len(values) // 10]
        u, v = (np.broadcast_to(at, ratio.shape)[few][chosen] for at in (x, y))
        terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
        fitted, fit = light, np.zeros(6, np.float32)
        for n_terms, below in APPROACH:
            near = np.abs(values - fitted) < below * fitted
            if np.count_nonzero(near) < MIN_SAMPLES:
                break
            some = terms[near, :n_terms]
            # the little on the diagonal only matters where a stone leaves no more than a column or two of blocks
            fit[:n_terms] = np.linalg.solve(some.T @ some + RIDGE * np.eye(n_terms), some.T @ values[near])
            fitted = terms @ fit
        else:
            light = fit[0] + x * (fit[1] + fit[3] * x) + y * (fit[2] + fit[4] * x + fit[5] * y)
    return np.asarray(np.maximum(light, np.float32(0.02)) + np.zeros_like(ratio))
