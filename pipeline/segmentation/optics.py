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

from pipeline.compiled import compiled
from pipeline.each import Each
from pipeline.frames import CameraId, Frame, Image
from pipeline.segmentation.background import COARSE, SLOWEST_WEIGHT, BackgroundModel, CameraBackground
from pipeline.segmentation.light import LIT
from pipeline.segmentation.silhouette import Silhouette, ViewStatus

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

UNPLACED = (ViewStatus.MULTIPLE, ViewStatus.CLIPPED)
"""A body is in view, but nothing says where: it would count as dark wall."""
BLOCK_PX = COARSE * LIT
ROWS = (4, 12)
"""Of each block these rows are looked at."""
EVERY = 3
"""Of so many blocks one tells of the noise: fifteen hundred are plenty."""
LEAST_LIGHT = 0.02
RIDGE = 1e-3
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
REACH_PX, STEP_PX, N_STEPS = 12.0, 0.8, 31
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
    each: Each = map,
) -> dict[CameraId, ViewOptics]:
    """Of every frame that has a background to compare with, unless bodies were seen whose place is not known.

    `each` may look at several at a time.
    """
    placed = [
        frame
        for camera, frame in frames.items()
        if (silhouette := silhouettes.get(camera)) is None or silhouette.status not in UNPLACED
    ]
    observed = each(lambda frame: observe_optics(frame, background, silhouettes.get(frame.camera)), placed)
    pairs = zip(placed, observed, strict=True)
    return {frame.camera: optics for frame, optics in pairs if optics is not None}


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
    if np.count_nonzero(is_wall) < MIN_BLOCKS:
        return None
    height, width = is_wall.shape
    columns = np.zeros((2, width * BLOCK_PX), np.uint16)
    means, saturated_share = _block_means(frame.image, height, width, columns)
    ratio: Array = np.divide(means, np.maximum(known.flat_field, 1), dtype=np.float32)
    brightness, slope_u, slope_v = _plane(ratio, is_wall)
    level = _levels(ratio, is_wall, brightness, slope_u, slope_v)
    clearest = np.partition(level, -len(level) // 20)[-len(level) // 20]
    edge = None if silhouette is None else _edge(frame.image, silhouette.outline_uv)
    return ViewOptics(
        brightness=brightness,
        gradient_uv=(2 * slope_u / brightness, 2 * slope_v / brightness),
        dust=max(0.0, 1 - float(level.mean() / max(clearest, 1e-6))),
        spots_share=_spots_share(ratio, is_wall),
        saturated_share=saturated_share,
        noise_grey=_noise_grey(frame.image, known, is_wall),
        edge_width_px=None if edge is None else edge[0],
        contrast=None if edge is None else edge[1],
    )


@compiled
def _block_means(image: Image, height: int, width: int, columns: NDArray[np.uint16]) -> tuple[Array, float]:
    """Means (h, w) of blocks of an image (H, W), from two rows of each, and the share of pixels that is saturated.

    `columns` (2, W), of zeros, are room for sums.
    """
    means = np.empty((height, width), np.float32)
    n_columns = min(width * BLOCK_PX, image.shape[1])
    sums, saturated = columns[0], columns[1]
    n_saturated = 0
    for row in range(height):
        upper = image[min(row * BLOCK_PX + ROWS[0], len(image) - 1)]
        lower = image[min(row * BLOCK_PX + ROWS[1], len(image) - 1)]
        for u in range(n_columns):
            sums[u] = np.uint16(upper[u]) + np.uint16(lower[u])
            saturated[u] += (upper[u] == SATURATED) + (lower[u] == SATURATED)
        for column in range(width):
            total = 0
            for u in range(column * BLOCK_PX, (column + 1) * BLOCK_PX):
                total += sums[u]
            means[row, column] = np.float32(total) / np.float32(len(ROWS) * BLOCK_PX)
    for u in range(n_columns):
        n_saturated += saturated[u]
    return means, n_saturated / (len(ROWS) * height * n_columns)


def _near_body(silhouette: Silhouette | None, shape: tuple[int, ...]) -> Mask:
    """Blocks (h, w) of the body's box and its margin."""
    near = np.zeros(shape, bool)
    if silhouette is not None:
        (u, v), (height, width) = silhouette.offset_uv, silhouette.labels.shape
        near[v // BLOCK_PX : -(-(v + height) // BLOCK_PX), u // BLOCK_PX : -(-(u + width) // BLOCK_PX)] = True
    return near


def _plane(values: Array, is_wall: Mask) -> tuple[float, float, float]:
    """Least squares plane through some of the values (h, w): in the middle, and its slopes along u and v."""
    products = np.zeros((4, 4))
    _add_products(values, is_wall, np.ones(4), products)
    # the little on the diagonal only matters where all lie on one line
    middle, slope_u, slope_v = np.linalg.solve(products[:3, :3] + RIDGE * np.eye(3), products[:3, 3])
    return max(float(middle), 0.01), float(slope_u), float(slope_v)


@compiled
def _add_products(
    values: Array, is_wall: Mask, terms: NDArray[np.float64], sums: NDArray[np.float64]
) -> None:
    """Add the products (4, 4) of the terms 1, u, v and value of some places (h, w), -1..1 from border to border."""
    height, width = values.shape
    for row in range(height):
        for column in range(width):
            if is_wall[row, column]:
                terms[1], terms[2] = (2 * column + 1) / width - 1, (2 * row + 1) / height - 1
                terms[3] = values[row, column]
                for i in range(4):
                    for j in range(4):
                        sums[i, j] += terms[i] * terms[j]


@compiled
def _levels(values: Array, is_wall: Mask, middle: float, slope_u: float, slope_v: float) -> Array:
    """The values (N,) at some places (h, w), relative to a plane."""
    height, width = values.shape
    levels = np.empty(height * width, np.float32)
    n = 0
    for row in range(height):
        for column in range(width):
            if is_wall[row, column]:
                u, v = (2 * column + 1) / width - 1, (2 * row + 1) / height - 1
                levels[n] = values[row, column] / max(middle + slope_u * u + slope_v * v, LEAST_LIGHT)
                n += 1
    return levels[:n]


def _spots_share(ratio: Array, is_wall: Mask) -> float:
    """Share of the wall that is darker than what surrounds it."""
    of_wall = ratio[is_wall]
    if of_wall.min() >= (1 - SPOT) * of_wall.max():
        return 0.0  # no block is darker than any other
    window = (SURROUNDINGS, SURROUNDINGS)
    weight = cv2.blur(is_wall.astype(np.float32), window)
    around = cv2.blur(ratio * is_wall, window)
    return float(np.mean((ratio * weight < (1 - SPOT) * around)[is_wall]))


def _noise_grey(image: Image, known: CameraBackground, is_wall: Mask) -> float:
    """From one pixel of each block of wall, less its neighbour's, so that no slope of light or dust counts."""
    # the mean has noise of its own: of so many frames, or of those that it remembers
    of_mean = max(1 / known.n_frames, SLOWEST_WEIGHT / (2 - SLOWEST_WEIGHT))
    # of a normal distribution sqrt(2 / pi) times its standard deviation; of two pixels
    deviation = _deviation(image, known.mean, is_wall)
    return float(deviation * np.sqrt(np.pi / 2) / np.sqrt(2 * (1 + of_mean)))


@compiled
def _deviation(image: Image, mean: Array, is_wall: Mask) -> float:
    """Mean deviation of a pixel's difference to its neighbour from the background's (H, W), at blocks (h, w)."""
    differences = np.empty((is_wall.size // EVERY + 1, 2))
    n, n_wall, seen, empty = 0, 0, 0.0, 0.0
    for row in range(is_wall.shape[0]):
        for column in range(is_wall.shape[1]):
            n_wall += is_wall[row, column]
            if is_wall[row, column] and n_wall % EVERY == 0:
                v, u = row * BLOCK_PX + BLOCK_PX // 2, column * BLOCK_PX + BLOCK_PX // 2
                seen += image[v, u]
                empty += mean[v, u]
                differences[n, 0] = float(image[v, u]) - float(image[v, u + 1])
                differences[n, 1] = mean[v, u] - mean[v, u + 1]
                n += 1
    gain, total = seen / max(empty, 1.0), 0.0
    for i in range(n):
        total += min(abs(differences[i, 0] - gain * differences[i, 1]), MAX_NOISE_GREY)
    return total / max(n, 1)


def _edge(image: Image, outline_uv: NDArray[np.float64]) -> tuple[float, float] | None:
    """Width from 10 to 90 % in px, and contrast, of the median profile across an outline (N, 2)."""
    if len(outline_uv) < MIN_OUTLINE_PX:
        return None
    rises, contrasts = _profiles(image, outline_uv)
    if len(rises) < MIN_BLOCKS:
        return None
    # the upper median, in a fifth of the time that np.median takes
    middle = len(rises) // 2
    rise = np.sort(rises, axis=0)[middle]
    low, high = np.interp([0.1, 0.9], np.maximum.accumulate(rise), np.arange(N_STEPS))
    return float(high - low) * STEP_PX, float(np.sort(contrasts)[middle])


@compiled
def _profiles(image: Image, outline_uv: NDArray[np.float64]) -> tuple[Array, Array]:
    """Across an outline where it runs unbroken: rises (P, N_STEPS) outwards, 0..1, and contrasts (P,)."""
    height, width = image.shape
    n_points, n_plateau = len(outline_uv), int((REACH_PX - PLATEAU_PX) / STEP_PX) + 1
    doubled_area = 0.0  # positive for an outline that runs clockwise as seen
    for i in range(n_points):
        after = (i + 1) % n_points
        doubled_area += outline_uv[i, 0] * outline_uv[after, 1] - outline_uv[after, 0] * outline_uv[i, 1]
    every = max(1, n_points // PROFILES)
    rises = np.empty((n_points // every + 1, N_STEPS), np.float32)
    contrasts = np.empty(len(rises), np.float32)
    n_clear = 0
    for i in range(0, n_points, every):
        before, after = (i - TANGENT_POINTS) % n_points, (i + TANGENT_POINTS) % n_points
        along_u = outline_uv[after, 0] - outline_uv[before, 0]
        along_v = outline_uv[after, 1] - outline_uv[before, 1]
        length = np.sqrt(along_u**2 + along_v**2)
        if not TANGENT_POINTS < length < 3 * TANGENT_POINTS:
            continue
        length = length if doubled_area > 0 else -length
        for k in range(N_STEPS):
            outwards_px = STEP_PX * k - REACH_PX
            u = min(max(outline_uv[i, 0] + outwards_px * along_v / length, 0.0), width - 1.001)
            v = min(max(outline_uv[i, 1] - outwards_px * along_u / length, 0.0), height - 1.001)
            x, y = int(u), int(v)
            upper = image[y, x] + (u - x) * (float(image[y, x + 1]) - image[y, x])
            lower = image[y + 1, x] + (u - x) * (float(image[y + 1, x + 1]) - image[y + 1, x])
            rises[n_clear, k] = upper + (v - y) * (lower - upper)
        within, beyond = 0.0, 0.0
        for k in range(n_plateau):
            within += rises[n_clear, k] / n_plateau
            beyond += rises[n_clear, N_STEPS - 1 - k] / n_plateau
        if abs(beyond - within) > MIN_STEP_GREY:
            for k in range(N_STEPS):
                rises[n_clear, k] = (rises[n_clear, k] - within) / (beyond - within)
            contrasts[n_clear] = abs(beyond - within) / max(beyond, 1.0)
            n_clear += 1
    return rises[:n_clear], contrasts[:n_clear]
