"""The views as the refinement reads them, and which of them see a node."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Annotated, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import Directions, Floats, Indices, Indices32, Mask, PointsMM, Singles, Values
from pipeline.compiled import compiled, compiled_within
from pipeline.frames import CameraId, Frame
from pipeline.geometry.bounds import bounds
from pipeline.rig.lens import region_lenses, region_pixel
from pipeline.segmentation.background import BackgroundModel
from pipeline.segmentation.noise import TYPICAL_NOISE
from pipeline.segmentation.silhouette import INSIDE, Silhouette
from pipeline.views.prepared import PreparedViews

MARGIN_PX = 12
BLUR_PX = 0.55
"""Sigma of the blur of images at half their size, against noise."""
BORDER_SIGMAS = 2.5
"""Distance to the outline, in sigmas of its blur, within which the wall shines into the stone's picture."""
SHARP_SIGMA_PX = 1.0
"""Sigma that is taken for an outline whose blur was not measured."""
COARSE = 4
"""Pixels of the image along an edge of one of the depth map."""
SPLAT = 2
"""Pixels of the depth map that a node covers to each side."""
MIN_COSINE = 0.3
"""Least cosine between normal and line of sight: 73 degrees. The bottom of a dent is often seen by few others."""
LEAST_WEIGHT = 0.1
"""Weight of a view with this cosine; it rises with the cosine."""
SLACK_MM = 0.7
"""Depth behind the depth map that still counts as seen, beside what the covered pixels tilt."""


class PhotoViews(NamedTuple):
    """Regions of V images around the stone."""

    regions: Annotated[NDArray[np.uint8], "(V, H, W)"]  # grey levels
    halves: Annotated[
        Indices32, "(V, H / 2, W / 2)"
    ]  # at half their size, blurred a little: `four_pixels` of each
    is_inner: Annotated[NDArray[np.bool_], "(V, H / COARSE + 1, W / COARSE + 1)"]  # well within the outline
    lenses: Annotated[Floats, "(V, 10)"]  # of these regions
    R: Annotated[Floats, "(V, 3, 3)"]
    t_mm: PointsMM
    centers_mm: PointsMM
    noise: Singles  # (V, 2) of their pixels: variance of reading, and per grey level
    blur_px: Values  # (V,) sigma of their outlines


def photo_views(
    frames: Mapping[CameraId, Frame],
    views: PreparedViews,
    vertices_mm: PointsMM,
    background: BackgroundModel = MappingProxyType({}),
) -> PhotoViews:
    """Cut the regions that show the vertices from the images of the views; noise is as the background has it."""
    low, high = [], []
    corners_mm = _box_corners(vertices_mm)
    for camera in views.calibrations:
        pixels_uv, _ = camera.project(corners_mm)
        size = np.array(camera.image_size_px)
        low.append(np.clip(np.floor(pixels_uv.min(axis=0)).astype(int) - MARGIN_PX, 0, size - 1))
        high.append(np.clip(np.ceil(pixels_uv.max(axis=0)).astype(int) + MARGIN_PX + 1, 1, size))
    width, height = np.max(np.array(high) - np.array(low), axis=0)
    width, height = int(width + width % 2), int(height + height % 2)
    regions = np.empty((len(views), height, width), np.uint8)
    for i, camera in enumerate(views.calibrations):
        (left, top), image = low[i], frames[camera.id].image
        part = image[top : top + height, left : left + width]
        below, right = height - part.shape[0], width - part.shape[1]
        cv2.copyMakeBorder(part, 0, below, 0, right, cv2.BORDER_REPLICATE, dst=regions[i])
    cameras = views.cameras
    return PhotoViews(
        regions,
        _halved(regions),
        np.stack([_inner(*each, (height, width)) for each in zip(views.silhouettes, low, strict=True)]),
        region_lenses(cameras.K, cameras.distortion, [tuple(each) for each in low]),
        cameras.R,
        cameras.t_mm,
        cameras.centers_mm,
        np.array(
            [
                TYPICAL_NOISE if (known := background.get(camera.id)) is None else known.noise
                for camera in views.calibrations
            ],
            np.float32,
        ),
        np.array([_blur_px(each) for each in views.silhouettes]),
    )


def _inner(silhouette: Silhouette, corner_uv: Indices, size: tuple[int, int]) -> Mask:
    """Mask pixels of the coarse image of a region so far within what is surely body that no wall shines in."""
    canvas = np.zeros((size[0] // COARSE + 1, size[1] // COARSE + 1), np.uint8)
    own, labels = [], []
    for n, begin, offset, n_labels in zip(
        canvas.shape, corner_uv[::-1], silhouette.offset_uv[::-1], silhouette.labels.shape, strict=True
    ):
        at = COARSE // 2 + int(begin) - offset  # in the silhouette, of the first pixel of the coarse image
        first = min(max(-(at // COARSE), 0), n)
        last = min(max(first, (n_labels - 1 - at) // COARSE + 1), n)
        own.append(slice(first, last))
        labels.append(slice(at + first * COARSE, at + last * COARSE, COARSE))
    canvas[tuple(own)] = silhouette.labels[tuple(labels)] == INSIDE
    inside_px = cv2.distanceTransform(canvas, cv2.DIST_L2, 3) * COARSE
    return np.asarray(inside_px > BORDER_SIGMAS * _blur_px(silhouette))


def _blur_px(silhouette: Silhouette) -> float:
    return SHARP_SIGMA_PX if silhouette.edge_sigma_px is None else silhouette.edge_sigma_px


def _halved(regions: NDArray[np.uint8]) -> Annotated[Indices32, "(V, H / 2, W / 2)"]:
    halves = np.zeros((len(regions), regions.shape[1] // 2, regions.shape[2] // 2), np.int32)
    for region, half in zip(regions, halves, strict=True):
        small = cv2.resize(region, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
        _join(np.asarray(cv2.GaussianBlur(small, (3, 3), BLUR_PX), np.uint8), half)
    return halves


@compiled
def _join(image: NDArray[np.uint8], fours: Annotated[Indices32, "(H, W)"]) -> None:
    """Fill in four neighbouring pixels for each, but in the last row and column: patches lie further inside."""
    for row in range(image.shape[0] - 1):
        above, below = image[row], image[row + 1]
        for column in range(image.shape[1] - 1):
            right = column + 1
            fours[row, column] = four_pixels(above[column], above[right], below[column], below[right])


@compiled_within
def four_pixels(one: np.uint8, right: np.uint8, below: np.uint8, diagonal: np.uint8) -> np.int32:
    """Return four grey levels in one number, which is read at once, eight bits each, the first in the lowest."""
    first, second = (
        np.int32(one) | np.int32(right) << np.int32(8),
        np.int32(below) | np.int32(diagonal) << np.int32(8),
    )
    return np.int32(first | second << np.int32(16))


def _box_corners(vertices_mm: PointsMM) -> PointsMM:
    ends = np.stack(bounds(vertices_mm))
    return np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


@compiled_within
def project_into(
    lens: Values, R: Floats, t_mm: Values, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Return pixel (u, v) of the region and depth of a point."""
    depth = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t_mm[2]
    u, v = region_pixel(
        (lens[0], lens[1], lens[2], lens[3], lens[4], lens[5], lens[6], lens[7], lens[8], lens[9]),
        (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t_mm[0]) / depth,
        (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t_mm[1]) / depth,
    )
    return u, v, depth


def depth_maps(views: PhotoViews, points_mm: PointsMM) -> Annotated[Singles, "(V, H/4, W/4)"]:
    """Return the depth of the nearest points (N, 3) for each pixel of coarse images; infinite where none is."""
    n_views, height, width = views.regions.shape
    maps = np.full((n_views, height // COARSE + 1, width // COARSE + 1), np.inf, np.float32)
    _splat(views.lenses, views.R, views.t_mm, points_mm, maps)
    covered = np.ones((2 * SPLAT + 1, 2 * SPLAT + 1), np.uint8)
    for each in maps:
        cv2.erode(each, covered, dst=each)
    maps[~views.is_inner] = np.inf
    return maps


@compiled_within
def hidden_beyond_mm(focal_px: float, depth_mm: float, cosine: float) -> float:
    """Tolerance of the depth test: points further behind the map are hidden; `cosine` of normal and line of sight."""
    return SLACK_MM + (SPLAT + 0.5) * COARSE * depth_mm / focal_px * np.sqrt(1 - cosine * cosine) / cosine


@compiled
def _splat(lenses: Floats, R: Floats, t_mm: PointsMM, points_mm: PointsMM, maps: Singles) -> None:
    for view in range(len(maps)):
        for i in range(len(points_mm)):
            u, v, depth = project_into(
                lenses[view], R[view], t_mm[view], points_mm[i, 0], points_mm[i, 1], points_mm[i, 2]
            )
            column, row = int(u / COARSE), int(v / COARSE)
            if 0 <= row < maps.shape[1] and 0 <= column < maps.shape[2]:
                maps[view, row, column] = min(maps[view, row, column], np.float32(depth))


def sightings(
    views: PhotoViews,
    maps: Singles,
    points_mm: PointsMM,
    normals: Directions,
    reach_mm: float,
    max_views: int,
) -> tuple[Indices32, Singles]:
    """Return the views (K, max_views) that see each node's patch best, -1 beyond the last, and their weights."""
    chosen = np.full((len(points_mm), max_views), -1, np.int32)
    weights = np.zeros((len(points_mm), max_views), np.float32)
    _sight(
        views.lenses,
        views.R,
        views.t_mm,
        views.centers_mm,
        maps,
        points_mm,
        normals,
        reach_mm,
        chosen,
        weights,
    )
    return chosen, weights


def cosines_of(weights: Singles) -> Singles:
    """Return the cosines between normal and line of sight of views with these weights."""
    return weights + np.float32(MIN_COSINE - LEAST_WEIGHT)


@compiled
def _sight(
    lenses: Floats,
    R: Floats,
    t_mm: PointsMM,
    centers_mm: PointsMM,
    maps: Singles,
    points_mm: PointsMM,
    normals: Directions,
    reach_mm: float,
    chosen: Indices32,
    weights: Singles,
) -> None:
    most = chosen.shape[1]
    for i in range(len(points_mm)):
        x, y, z = points_mm[i, 0], points_mm[i, 1], points_mm[i, 2]
        n = 0
        for view in range(len(maps)):
            dx, dy, dz = centers_mm[view, 0] - x, centers_mm[view, 1] - y, centers_mm[view, 2] - z
            distance = np.sqrt(dx * dx + dy * dy + dz * dz)
            cosine = (dx * normals[i, 0] + dy * normals[i, 1] + dz * normals[i, 2]) / distance
            if cosine <= MIN_COSINE:
                continue
            if n == most and cosine - MIN_COSINE + LEAST_WEIGHT <= weights[i, n - 1]:
                continue
            u, v, depth = project_into(lenses[view], R[view], t_mm[view], x, y, z)
            patch_px = reach_mm * lenses[view, 0] / depth
            slack_mm = hidden_beyond_mm(lenses[view, 0], depth, cosine)
            is_seen = True
            for corner in range(5):
                du = 0.0 if corner == 4 else (patch_px if corner & 1 else -patch_px)
                dv = 0.0 if corner == 4 else (patch_px if corner & 2 else -patch_px)
                column, row = int((u + du) / COARSE), int((v + dv) / COARSE)
                if column < 1 or row < 1 or column >= maps.shape[2] - 1 or row >= maps.shape[1] - 1:
                    is_seen = False
                    break
                nearest = maps[view, row, column]
                if not (nearest < np.inf) or (corner == 4 and depth > nearest + slack_mm):
                    is_seen = False
                    break
            if not is_seen:
                continue
            weight = np.float32(cosine - MIN_COSINE + LEAST_WEIGHT)
            place = min(n, most - 1)
            while place > 0 and weights[i, place - 1] < weight:
                weights[i, place], chosen[i, place] = weights[i, place - 1], chosen[i, place - 1]
                place -= 1
            weights[i, place], chosen[i, place] = weight, view
            n = min(n + 1, most)
