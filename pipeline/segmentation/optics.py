"""The optical health of a view: light, dust, noise and sharpness in one exposure, against the rig when it was clean.

The background forgets dust and fading light, as it should; the reference here is the flat field it began with
(`CameraBackground.flat_field`). Figures are taken on the plain wall, beside the body if there is one, in blocks of 16
pixels; sharpness and contrast come from grey profiles across the body's outline.
"""

from collections.abc import Mapping
from math import pi, sqrt
from types import MappingProxyType

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatImage, Floats, Mask, Singles
from pipeline.compiled import compiled
from pipeline.frames import CameraId, Frame, Image
from pipeline.segmentation.background import COARSE, MIN_WEIGHT, BackgroundModel, CameraBackground
from pipeline.segmentation.edge_profile import PLATEAU_PX, EdgeProfile, edge_profile
from pipeline.segmentation.light import LIGHT_BLOCK
from pipeline.segmentation.silhouette import Silhouette, ViewStatus
from pipeline.view_mapper import ViewMapper
from pipeline.view_optics import ViewOptics

UNLOCATED = (ViewStatus.MULTIPLE, ViewStatus.CLIPPED)
"""Views with a body of unknown place, which would count as dark wall."""
BLOCK_PX = COARSE * LIGHT_BLOCK
SAMPLED_ROWS = (4, 12)
"""Rows of each block that are looked at."""
NOISE_STRIDE = 3
"""One block of this many serves to estimate the noise: fifteen hundred are plenty."""
LANES, HIGHEST_LANE, IN_ALL_LANES = 4, np.uint64(48), np.uint64(0x0001_0001_0001_0001)
"""Sums of 16 bits in a word of 64, the shift to the last of them, and the factor that adds all of them up there."""
ONE = np.uint64(1)
MIN_LIGHT = 0.02
RIDGE = 1e-3
"""Regularization of the plane."""
SATURATED = np.uint8(255)
SPOT_CONTRAST = 0.05
"""Share by which a spot is darker than its surroundings."""
SURROUNDINGS_BLOCKS = 9
"""Edge, in blocks, of the square that a spot is compared with."""
MIN_BLOCKS = 24
"""Fewest blocks of plain wall from which a view is judged."""
MAX_NOISE_GREY = 40.0
"""Differences of two neighbours are clipped to this: larger ones are edges."""


WIDTH_SIGMAS = 2.563
"""Width of a Gaussian edge from 10 to 90 %, in sigmas."""


def observe_all(
    frames: Mapping[CameraId, Frame],
    background: BackgroundModel,
    silhouettes: Mapping[CameraId, Silhouette] = MappingProxyType({}),
    view_mapper: ViewMapper = map,
) -> dict[CameraId, ViewOptics]:
    """Return the figures of every frame with a background, unless it shows bodies whose place is not known."""
    placed = [
        frame
        for camera, frame in frames.items()
        if (silhouette := silhouettes.get(camera)) is None or silhouette.status not in UNLOCATED
    ]
    observed = view_mapper(
        lambda frame: observe_optics(frame, background, silhouettes.get(frame.camera)), placed
    )
    pairs = zip(placed, observed, strict=True)
    return {frame.camera: optics for frame, optics in pairs if optics is not None}


def observe_optics(
    frame: Frame, background: BackgroundModel, silhouette: Silhouette | None
) -> ViewOptics | None:
    """Return the optical figures of a view; `None` without a background or without visible wall.

    `silhouette` is what was found in the frame, `None` for an exposure of the empty rig.
    """
    known = background.get(frame.camera)
    if known is None or known.mean.shape != frame.image.shape:
        return None
    is_wall = _visible_wall(known, silhouette)
    n_wall = np.count_nonzero(is_wall)
    if n_wall < MIN_BLOCKS:
        return None
    light, levels = np.empty((2, *is_wall.shape), np.float32)
    room = np.zeros((2, is_wall.shape[1] * BLOCK_PX), np.uint16)
    sums = np.zeros((5, is_wall.shape[1]))
    saturated_share = _fill_light(
        frame.image, known.flat_field, is_wall, room, room[0].view(np.uint64), light, sums
    )
    brightness, slope_u, slope_v = plane = _fit_plane(sums)
    total, n_dark = _fill_levels(light, is_wall, plane, levels, np.zeros((2, is_wall.shape[1]), np.float32))
    mean = total / n_wall
    in_order = levels.reshape(-1)
    in_order.partition(-n_wall // 20)
    clearest = float(in_order[-n_wall // 20])
    edge = None if silhouette is None else edge_profile(frame.image, silhouette.outline_uv)
    return ViewOptics(
        brightness=brightness,
        gradient_uv=(2 * slope_u / brightness, 2 * slope_v / brightness),
        dust=max(0.0, 1 - mean / max(clearest, 1e-6)),
        spots_share=_spots_share(light, is_wall) if n_dark else 0.0,  # in a clean rig nothing is dark
        saturated_share=saturated_share,
        noise_grey=_noise_grey(frame.image, known, is_wall),
        edge_width_px=_edge_width_px(edge, silhouette),
        edge_widths_uv_px=_edge_widths_uv_px(silhouette),
        contrast=None if edge is None else edge.contrast,
    )


def _edge_width_px(edge: EdgeProfile | None, silhouette: Silhouette | None) -> float | None:
    """Return the width of an outline; that of the silhouette where it is too wide for the profile across it."""
    if edge is not None and edge.width_px <= PLATEAU_PX:
        return edge.width_px
    if silhouette is None or silhouette.edge_sigma_px is None:
        return None if edge is None else edge.width_px
    return WIDTH_SIGMAS * silhouette.edge_sigma_px


def _edge_widths_uv_px(silhouette: Silhouette | None) -> tuple[float, float] | None:
    if silhouette is None or silhouette.sigmas_across_px is None:
        return None
    u_px, v_px = silhouette.sigmas_across_px
    return WIDTH_SIGMAS * u_px, WIDTH_SIGMAS * v_px


def _visible_wall(known: CameraBackground, silhouette: Silhouette | None) -> Mask:
    """Return the blocks (h, w) of plain wall outside of the body's box and its margin."""
    is_wall = known.shows_wall.copy()
    if silhouette is not None:
        (u, v), (height, width) = silhouette.offset_uv, silhouette.labels.shape
        is_wall[v // BLOCK_PX : -(-(v + height) // BLOCK_PX), u // BLOCK_PX : -(-(u + width) // BLOCK_PX)] = (
            False
        )
    return is_wall


@compiled
def _fill_light(
    image: Image,
    flat_field: FloatImage,
    is_wall: Mask,
    room: NDArray[np.uint16],
    words: NDArray[np.uint64],
    light: FloatImage,
    sums: Floats,
) -> float:
    """Fill `light` (h, w): means over blocks of an image (H, W), relative to the clean rig; 0 where there is no wall.

    Two rows of each block are looked at; the share of their pixels that is saturated is returned.

    Parameters
    ----------
    room, words
        Zeros (2, 16 w) for sums of pixels; four of the first row are one of the `words` (4 w,) of the same memory.
    sums
        (5, w) to which sums over the wall in each column are added: of 1, v, v v, the light x, and v x, for v from -1
        to 1, from border to border.
    """
    height, width = light.shape
    n_columns = min(width * BLOCK_PX, image.shape[1])
    pairs, saturated = room[0], room[1]
    n_saturated = 0
    for row in range(height):
        upper = image[min(row * BLOCK_PX + SAMPLED_ROWS[0], len(image) - 1)]
        lower = image[min(row * BLOCK_PX + SAMPLED_ROWS[1], len(image) - 1)]
        # loops over whole rows, here and below: they are vectorized
        for u in range(n_columns):
            pairs[u] = np.uint16(upper[u]) + np.uint16(lower[u])
            saturated[u] += np.uint16(upper[u] == SATURATED) + np.uint16(lower[u] == SATURATED)
        for column in range(width):
            at = np.uint64(LANES * column)
            # all four sums of a word at once, and their sum into the highest of them
            total = words[at] + words[at + ONE] + words[at + ONE + ONE] + words[at + ONE + ONE + ONE]
            total = (total * IN_ALL_LANES) >> HIGHEST_LANE
            clean = max(flat_field[row, column], np.float32(1))
            relative = np.float32(total) / np.float32(len(SAMPLED_ROWS) * BLOCK_PX) / clean
            light[row, column] = relative if is_wall[row, column] else np.float32(0)
        v = (2 * row + 1) / height - 1
        for column in range(width):
            one, x = np.float64(is_wall[row, column]), np.float64(light[row, column])
            sums[0, column] += one
            sums[1, column] += v * one
            sums[2, column] += v * v * one
            sums[3, column] += x
            sums[4, column] += v * x
    for u in range(n_columns):
        n_saturated += saturated[u]
    return n_saturated / (len(SAMPLED_ROWS) * height * n_columns)


@compiled
def _fit_plane(sums: Floats) -> tuple[float, float, float]:
    """Fit a plane to values from their sums (5, w), see `_fill_light`; return its value in the middle and its slopes.

    u and v go from -1 to 1, from border to border.
    """
    n = su = sv = suu = suv = svv = sx = sux = svx = 0.0
    for column in range(sums.shape[1]):
        u = (2 * column + 1) / sums.shape[1] - 1
        n, sv, svv = n + sums[0, column], sv + sums[1, column], svv + sums[2, column]
        sx, svx = sx + sums[3, column], svx + sums[4, column]
        su, suu = su + u * sums[0, column], suu + u * u * sums[0, column]
        suv, sux = suv + u * sums[1, column], sux + u * sums[3, column]
    u_mean, v_mean, x_mean = su / n, sv / n, sx / n
    # the ridge only matters where all values lie on one line
    uu, uv, vv = suu - su * u_mean + RIDGE, suv - su * v_mean, svv - sv * v_mean + RIDGE
    ux, vx = sux - sx * u_mean, svx - sx * v_mean
    determinant = uu * vv - uv * uv
    slope_u, slope_v = (vv * ux - uv * vx) / determinant, (uu * vx - uv * ux) / determinant
    return max(x_mean - slope_u * u_mean - slope_v * v_mean, 0.01), slope_u, slope_v


@compiled
def _fill_levels(
    light: FloatImage, is_wall: Mask, plane: tuple[float, float, float], levels: FloatImage, room: Singles
) -> tuple[float, int]:
    """Fill `levels` (h, w), the light relative to a plane; return their sum, and how many blocks of wall are dark.

    Only a dark block can be darker than its surroundings. `room` (2, w), zeros, is for a sum and a maximum of each
    column, which are computed in vectors.
    """
    height, width = light.shape
    totals, highest = room[0], room[1]
    middle, slope_u, slope_v = plane
    step = 2 * slope_u / width
    for row in range(height):
        first = middle + slope_v * ((2 * row + 1) / height - 1) - slope_u + step / 2
        for column in range(width):
            here = light[row, column]
            level = np.float32(here / max(first + column * step, MIN_LIGHT))
            levels[row, column] = level
            totals[column] += level
            highest[column] = here if here > highest[column] else highest[column]
    total, brightest, n_dark = 0.0, np.float32(0), 0
    for column in range(width):
        total += totals[column]
        brightest = max(brightest, highest[column])
    dark = np.float32(1 - SPOT_CONTRAST) * brightest
    for row in range(height):
        for column in range(width):
            n_dark += is_wall[row, column] & (light[row, column] < dark)
    return total, n_dark


def _spots_share(light: FloatImage, is_wall: Mask) -> float:
    """Return the share of the wall's blocks (h, w) that are darker than the wall around; `light` is 0 elsewhere."""
    (height, width), reach = light.shape, SURROUNDINGS_BLOCKS // 2
    rows, columns = np.nonzero(is_wall & (light < (1 - SPOT_CONTRAST) * light.max()))
    top, bottom = np.maximum(rows - reach, 0), np.minimum(rows + reach + 1, height)
    left, right = np.maximum(columns - reach, 0), np.minimum(columns + reach + 1, width)
    lit, n_lit = (
        before[bottom, right] - before[top, right] - before[bottom, left] + before[top, left]
        for before in (cv2.integral(light), cv2.integral(is_wall.view(np.uint8)))
    )
    n_spots = np.count_nonzero(light[rows, columns] * n_lit < (1 - SPOT_CONTRAST) * lit)
    return n_spots / np.count_nonzero(is_wall)


def _noise_grey(image: Image, known: CameraBackground, is_wall: Mask) -> float:
    """Estimate a pixel's noise from differences of two neighbours in blocks of wall: slopes of light or dust cancel."""
    # the mean has noise of its own, of as many frames as it averages
    mean_variance = max(1 / known.n_frames, MIN_WEIGHT / (2 - MIN_WEIGHT))
    # mean deviation = sqrt(2 / pi) standard deviations of a normal distribution, here of a difference of two pixels
    return float(
        _mean_deviation(image, known.neighbours, is_wall) * sqrt(pi / 2) / sqrt(2 * (1 + mean_variance))
    )


@compiled
def _mean_deviation(image: Image, neighbours: Singles, is_wall: Mask) -> float:
    """Return the mean deviation of the difference of two neighbouring pixels from the background's, at blocks (h, w).

    `neighbours` (h, w, 2) are the background's pixels at these places of the image (H, W).
    """
    differences = np.empty((is_wall.size // NOISE_STRIDE + 1, 2))
    n, n_wall, seen, empty = 0, 0, 0.0, 0.0
    for row in range(is_wall.shape[0]):
        pixels = image[row * BLOCK_PX + BLOCK_PX // 2]
        for column in range(is_wall.shape[1]):
            n_wall += is_wall[row, column]
            if n_wall == NOISE_STRIDE:
                n_wall = 0
                u = column * BLOCK_PX + BLOCK_PX // 2
                seen += pixels[u]
                empty += neighbours[row, column, 0]
                differences[n, 0] = float(pixels[u]) - float(pixels[u + 1])
                differences[n, 1] = neighbours[row, column, 0] - neighbours[row, column, 1]
                n += 1
    gain, total = seen / max(empty, 1.0), 0.0
    for i in range(n):
        total += min(abs(differences[i, 0] - gain * differences[i, 1]), MAX_NOISE_GREY)
    return total / max(n, 1)
