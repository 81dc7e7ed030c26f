"""The light of one exposure relative to the empty rig's, estimated from the frame itself.

A flash differs by a factor, a panel that fails by a slope, dust on the window by patches. None of this is
kept from one frame to the next: results depend neither on order nor on workers.
"""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatImage, Mask, Singles

SPARSE = (slice(None, None, 8), slice(None, None, 8))
"""Every eighth block in both directions: plenty for two quantiles."""
MIN_WALL_GREY = 16
"""Grey level below which the wall says nothing of the flash."""
LIGHT_BLOCK = 4
"""Edge of the blocks, in coarse ones, on which the light is judged."""
MAX_WALL_DEVIATION = np.float32(0.1)
"""Relative deviation from the fitted light beyond which a block may be no wall: body, shadow, glint, a dusty patch."""
NEAR_BLOCKS, MAX_STEP_SHARE, MAX_STEPS = 1.5, np.float32(0.05), 16
"""How the light is followed into a dusty patch: standard deviation of a step, in blocks, its greatest relative change,
and how many steps."""
PRIOR_WEIGHT = np.float32(1e-3)
"""Weight of the fitted light itself, which decides where no wall is near."""
MAX_SAMPLES = 320
MIN_SAMPLES = 24
"""Blocks of plain wall that the light is fitted to."""
RIDGE = 1e-4
"""Regularization of the fit."""
FIT_STEPS = ((3, 0.4), (3, 0.2), (3, 0.12), (6, 0.1), (6, 0.06))
"""Steps of the fit: terms of the polynomial, and the relative deviation up to which a block takes part."""
MIN_LIGHT = np.float32(0.02)
EVEN, EVEN_SHARE = np.float32(0.015), 0.05
"""The light is one factor if at most this share of blocks, those at a body's outline, deviates by more than EVEN."""
REACH_BLOCKS = 3.0
"""Standard deviation, in blocks of light, over which a local deviation of the light is extrapolated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PlainWall:
    """The wall without screws, vents and apertures, from which the light is estimated, in blocks of 16 pixels."""

    levels: FloatImage  # (h, w) grey levels, the flash divided out
    is_plain: Mask  # (h, w)

    @cached_property
    def terms(self) -> Singles:
        """Terms (h * w, 6) of a quadratic in the place of each block, -1..1 from border to border."""
        y, x = (
            ((2 * at + 1) / size - 1).ravel()
            for at, size in zip(np.indices(self.levels.shape), self.levels.shape, strict=True)
        )
        return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1, dtype=np.float32)

    @cached_property
    def samples(self) -> NDArray[np.intp]:
        """Flat indices (N,) of some blocks of plain wall, evenly spread."""
        step = max(1, round((self.levels.size / MAX_SAMPLES) ** 0.5))
        few = (slice(step // 2, None, step),) * 2
        return np.arange(self.levels.size).reshape(self.levels.shape)[few][self.is_plain[few]]

    @cached_property
    def sampled_terms(self) -> Singles:
        """Terms (N, 6) at the samples."""
        return self.terms[self.samples]


def flash_gain(coarse: NDArray[np.generic], coarse_background: FloatImage) -> float:
    """Return the strength of this flash relative to the background's, from the blocks (h, w) that still show it."""
    wall = np.maximum(coarse_background[SPARSE], 1)
    ratios: Singles = np.divide(coarse[SPARSE], wall, dtype=np.float32)
    return gain_from_ratios(ratios[wall > MIN_WALL_GREY])


def gain_from_ratios(ratios: Singles) -> float:
    """Return the strength of the flash, from the ratios (N,) of some blocks to the background's.

    A dark body covers up to half of the image: the gain is the median of the ratios near their
    upper mode, not of all of them.
    """
    if ratios.size == 0:
        return 1.0
    ratios = np.sort(ratios)
    bright = ratios[-(ratios.size // 10) - 1]
    first, last = ratios.searchsorted((np.float32(0.9) * bright, np.float32(1.1) * bright)).tolist()
    gain = float(ratios[(first + last) // 2]) if first < last else float(bright)
    return gain if gain > 0.05 else 1.0


def uneven_light(ratio: FloatImage, wall: PlainWall, shape: tuple[int, ...]) -> FloatImage:
    """Return the strength of the light at each place, on top of the flash's.

    A quadratic in both coordinates is fitted to the plain wall, and from the blocks that agree with it the light is
    followed outwards, as long as it changes slowly. It is not followed into a body, whose outline is a step: there,
    and a little around it, the light is extrapolated from the surroundings.

    Parameters
    ----------
    ratio
        (H/16, W/16) brightness of each block relative to what the flash alone makes of it.
    shape
        H/4, W/4.

    Returns
    -------
    array
        (H/4, W/4) factors, smooth over some `LIGHT_BLOCK` * `REACH_BLOCKS` blocks.
    """
    fitted = fitted_light(ratio, wall)
    left = ratio / fitted
    is_lit = wall.is_plain & (np.abs(left - 1) < MAX_WALL_DEVIATION)
    for _ in range(MAX_STEPS):
        near = _extrapolated(left, is_lit, NEAR_BLOCKS)
        grown = wall.is_plain & (np.abs(left - near) < MAX_STEP_SHARE * near)
        if np.array_equal(grown, is_lit):
            break
        is_lit = grown
    light = fitted * _extrapolated(left, is_lit, REACH_BLOCKS)
    return np.asarray(cv2.resize(light, shape[::-1], interpolation=cv2.INTER_LINEAR))


def _extrapolated(values: FloatImage, is_known: Mask, sigma: float) -> FloatImage:
    """Extrapolate values (h, w) by normalized convolution from where they are known all around, fading to 1."""
    known = cv2.erode(is_known.view(np.uint8), np.ones((3, 3), np.uint8)).astype(np.float32)
    weight = cv2.GaussianBlur(known, (0, 0), sigma)
    above = cv2.GaussianBlur((values - 1) * known, (0, 0), sigma)
    return np.asarray(1 + above / (weight + PRIOR_WEIGHT))


def fitted_light(ratio: FloatImage, wall: PlainWall) -> FloatImage:
    """Fit a quadratic (h, w) to the ratios (h, w) of the plain wall.

    A stone covers up to half of the view and is darker as a rule: the fit begins at the upper mode, with a
    plane, and closes in on the blocks that agree.
    """
    values, terms = ratio.ravel()[wall.samples], wall.sampled_terms
    if len(values) < MIN_SAMPLES:
        return np.full_like(ratio, np.median(values) if len(values) else 1)
    bright = np.sort(values)[-len(values) // 10]
    fitted, fit = bright, np.zeros(terms.shape[1], np.float32)
    for n_terms, below in FIT_STEPS:
        is_near = np.abs(values - fitted) < np.float32(below) * fitted
        if np.count_nonzero(is_near) < MIN_SAMPLES:
            return np.full_like(ratio, max(bright, MIN_LIGHT))
        weighted = terms[:, :n_terms] * is_near[:, None]
        # the ridge only matters where a stone leaves no more than a column or two of blocks
        matrix = weighted.T @ terms[:, :n_terms] + RIDGE * np.eye(n_terms)
        fit[:n_terms] = np.linalg.solve(matrix, weighted.T @ values)
        fitted = terms @ fit
    return np.maximum(wall.terms @ fit, MIN_LIGHT).reshape(ratio.shape)
