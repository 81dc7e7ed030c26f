"""How well a camera sees: figures of one exposure, with or without a body, against the rig when it was clean.

The background forgets dust and fading light, as it should; what is judged here is the flat field it
began with (`CameraBackground.flat_field`). All figures are of the plain wall beside the body, in blocks of 16
pixels, but for the edge's, which come from grey profiles across the outline.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId, Frame, Image
from pipeline.segmentation.background import COARSE, LIT, SLOWEST_WEIGHT, BackgroundModel, CameraBackground
from pipeline.segmentation.silhouette import Silhouette, ViewStatus

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

UNPLACED = (ViewStatus.MULTIPLE, ViewStatus.CLIPPED)
"""A body is in view, but nothing says where: it would count as dark wall."""
BLOCK_PX = COARSE * LIT
ROW_STEP = 8
"""Of so many rows of the image one is looked at."""
RIDGE = np.float32(1e-3)
SATURATED = 255
SPOT = 0.05
"""A block that is darker than its surroundings by this share is a spot."""
SURROUNDINGS = 9
"""Blocks, along an edge, that a spot is compared with."""
MIN_BLOCKS = 24
MAX_NOISE_GREY = 40.0
"""A larger difference of two neighbours is an edge."""
PROFILES = 48
"""Places along the outline at which its edge is looked at."""
MIN_OUTLINE_PX = 150
"""The grey level behind the edge of a body with a shorter outline is not flat anywhere."""
REACH_PX, STEP_PX = 12.0, 0.8
PLATEAU_PX = 8.0
"""Beyond this distance from the edge, blur (to 5 px of motion) mixes nothing in."""
TANGENT_POINTS = 6
"""Points of the outline, about a pixel apart, to both sides that say where it runs."""
MIN_STEP_GREY = 16.0
"""A lower edge is lost in the noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewOptics:
    """Of one camera and one exposure; `None` where the view does not show it."""

    brightness: float  # light on the plain wall, 1: as in the clean rig
    gradient_uv: tuple[float, float]  # of that, from the left to the right border and from top to bottom
    dust: float  # share of the light lost, on average, against the clearest part of the field
    spots_share: float  # of the plain wall: darker than its surroundings and than in the clean rig
    saturated_share: float  # of all pixels
    noise_grey: float  # standard deviation of a pixel from exposure to exposure
    edge_width_px: float | None  # of the body's outline, from 10 to 90 %
    contrast: float | None  # of body and wall at the outline, as a share of the wall's level


def observe_all(
    frames: Mapping[CameraId, Frame],
    background: BackgroundModel,
    silhouettes: Mapping[CameraId, Silhouette] = MappingProxyType({}),
) -> dict[CameraId, ViewOptics]:
    """Of every frame that has a background to compare with, unless bodies were seen whose place is not known."""
    observed = {
        camera: observe_optics(frame, background, silhouette)
        for camera, frame in frames.items()
        if (silhouette := silhouettes.get(camera)) is None or silhouette.status not in UNPLACED
    }
    return {camera: optics for camera, optics in observed.items() if optics is not None}


def observe_optics(
    frame: Frame, background: BackgroundModel, silhouette: Silhouette | None
) -> ViewOptics | None:
    """What the frame says about camera, window and light; nothing where it has no background to compare with.

    `silhouette` is what was found in the frame, `None` of an exposure of the empty rig.
    """
    known = background.get(frame.camera)
    if known is None or known.mean.shape != frame.image.shape:
        return None
    is_wall = known.shows_wall & ~_near_body(silhouette, known.shows_wall.shape)
    wall = np.flatnonzero(is_wall)[::3]  # fifteen hundred blocks are plenty
    if len(wall) < MIN_BLOCKS:
        return None
    few_rows = np.ascontiguousarray(frame.image[ROW_STEP // 2 :: ROW_STEP])
    ratio: Array = np.divide(
        block_means(few_rows, is_wall.shape), np.maximum(known.flat_field, 1), dtype=np.float32
    )
    rows, columns = _centred(wall, ratio.shape)
    of_wall = ratio.ravel()[wall]
    brightness, slope_u, slope_v = _plane(columns, rows, of_wall)
    level = of_wall / np.maximum(brightness + slope_u * columns + slope_v * rows, np.float32(0.02))
    clearest = np.partition(level, -len(level) // 20)[-len(level) // 20]
    edge = None if silhouette is None else _edge(frame.image, silhouette.outline_uv)
    return ViewOptics(
        brightness=brightness,
        gradient_uv=(2 * slope_u / brightness, 2 * slope_v / brightness),
        dust=max(0.0, 1 - float(level.mean() / max(clearest, 1e-6))),
        spots_share=_spots_share(ratio, is_wall),
        saturated_share=np.count_nonzero(few_rows == SATURATED) / few_rows.size,
        noise_grey=_noise(frame.image, known, wall),
        edge_width_px=None if edge is None else edge[0],
        contrast=None if edge is None else edge[1],
    )


def block_means(few_rows: Image, shape: tuple[int, ...]) -> Array:
    """Means (H/16, W/16) of blocks, in whole grey levels, from every eighth row (H/8, W) of an image."""
    height, width = shape
    rows = few_rows[: height * BLOCK_PX // ROW_STEP, : width * BLOCK_PX]
    return cv2.resize(rows, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)


def _near_body(silhouette: Silhouette | None, shape: tuple[int, ...]) -> Mask:
    """Blocks (h, w) of the body's box and its margin."""
    near = np.zeros(shape, bool)
    if silhouette is not None:
        (u, v), (height, width) = silhouette.offset_uv, silhouette.labels.shape
        near[v // BLOCK_PX : -(-(v + height) // BLOCK_PX), u // BLOCK_PX : -(-(u + width) // BLOCK_PX)] = True
    return near


def _centred(blocks: NDArray[np.intp], shape: tuple[int, ...]) -> tuple[Array, Array]:
    """Rows and columns (N,) of blocks with these flat indices (N,), -1..1 from border to border."""
    rows, columns = (
        ((2 * at + 1) / np.float32(size) - 1).astype(np.float32)
        for at, size in zip(np.divmod(blocks, shape[1]), shape, strict=True)
    )
    return rows, columns


def _plane(u: Array, v: Array, values: Array) -> tuple[float, float, float]:
    """Least squares plane through values (N,): in the middle, and its slopes along u and v."""
    terms = np.stack([np.ones_like(u), u, v])
    # the little on the diagonal only matters where all lie on one line
    middle, slope_u, slope_v = np.linalg.solve(terms @ terms.T + RIDGE * np.eye(3), terms @ values)
    return max(float(middle), 0.01), float(slope_u), float(slope_v)


def _spots_share(ratio: Array, is_wall: Mask) -> float:
    """Share of the wall that is darker than what surrounds it."""
    window = (SURROUNDINGS, SURROUNDINGS)
    weight = cv2.blur(is_wall.astype(np.float32), window)
    around = cv2.blur(np.where(is_wall, ratio, np.float32(0)), window)
    return float(np.mean((ratio * weight < (1 - SPOT) * around)[is_wall]))


def _noise(image: Image, known: CameraBackground, wall: NDArray[np.intp]) -> float:
    """From one pixel of each block of wall, less its neighbour's, so that no slope of light or dust counts."""
    row, column = np.divmod(wall, known.shows_wall.shape[1])
    here = (row * BLOCK_PX + BLOCK_PX // 2) * image.shape[1] + column * BLOCK_PX + BLOCK_PX // 2
    now, before = ((each.take(here), each.take(here + 1)) for each in (image, known.mean))
    gain = np.float32(now[0].sum() / max(float(before[0].sum()), 1.0))
    difference = now[0].astype(np.float32) - now[1] - gain * (before[0] - before[1])
    # the mean has noise of its own: of so many frames, or of those that it remembers
    of_mean = max(1 / known.n_frames, SLOWEST_WEIGHT / (2 - SLOWEST_WEIGHT))
    typical = np.minimum(np.abs(difference), MAX_NOISE_GREY).mean()
    # of a normal distribution sqrt(2 / pi) times its standard deviation; of two pixels
    return float(typical * np.sqrt(np.pi / 2) / np.sqrt(2 * (1 + of_mean)))


def _edge(image: Image, outline_uv: NDArray[np.float64]) -> tuple[float, float] | None:
    """Width from 10 to 90 % in px, and contrast, of the median profile across an outline (N, 2)."""
    steps_px = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    profiles = _profiles(image, outline_uv, steps_px)
    within = profiles[:, steps_px <= -PLATEAU_PX].mean(axis=1, keepdims=True)
    beyond = profiles[:, steps_px >= PLATEAU_PX].mean(axis=1, keepdims=True)
    step = beyond - within
    is_clear = np.abs(step[:, 0]) > MIN_STEP_GREY
    if np.count_nonzero(is_clear) < MIN_BLOCKS:
        return None
    rise = _middle(((profiles - within) / np.where(step == 0, 1, step))[is_clear])
    low_px, high_px = np.interp([0.1, 0.9], np.maximum.accumulate(rise), steps_px)
    return float(high_px - low_px), float(_middle(np.abs(step) / np.maximum(beyond, 1))[0])


def _profiles(image: Image, outline_uv: NDArray[np.float64], steps_px: NDArray[np.float64]) -> Array:
    """Grey levels (P, S) at so many px outwards from places along an outline, where it runs unbroken."""
    n_points = len(outline_uv)
    if n_points < MIN_OUTLINE_PX:
        return np.empty((0, len(steps_px)), np.float32)
    at = np.arange(0, n_points, max(1, n_points // PROFILES))
    tangent = outline_uv[(at + TANGENT_POINTS) % n_points] - outline_uv[at - TANGENT_POINTS]
    length = np.hypot(*tangent.T)
    unbroken = (length > TANGENT_POINTS) & (length < 3 * TANGENT_POINTS)
    outward = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.maximum(length, 1)[:, None]
    # positive for an outline that runs clockwise as seen
    outward *= np.sign(cv2.contourArea(outline_uv[::TANGENT_POINTS].astype(np.float32), oriented=True))
    at_u, at_v = (
        (outline_uv[at, axis, None] + steps_px * outward[:, axis, None])[unbroken].astype(np.float32)
        for axis in (0, 1)
    )
    grey = cv2.remap(image, at_u, at_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return grey.astype(np.float32)


def _middle(values: Array) -> Array:
    """The upper median (S,) of each column (N, S), in a fifth of the time that np.median takes."""
    return np.sort(values, axis=0)[len(values) // 2]
