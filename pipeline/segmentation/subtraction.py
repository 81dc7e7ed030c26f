"""Background segmentation with sub-pixel edges.

A pixel at the edge mixes body and background, I = c s + (1 - c) B. With the background B known and
the body's grey level s carried outwards from just inside the edge, the coverage c follows, and the
edge is where c = 1/2: half-way between the *local* grey levels on both sides, whatever the texture,
the light or a gradient of the background. A symmetric blur does not move it.

Where the background itself is dark (screws, vents, apertures, holes) body and background cannot be
told apart: those pixels are unknown, and an unknown pixel never carves.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.frames import Frame
from pipeline.segmentation.background import COARSE, BackgroundModel, coarsen, flash_gain
from pipeline.segmentation.edge import signed_distance
from pipeline.segmentation.silhouette import INSIDE, MARGIN_PX, OUTSIDE, UNKNOWN, Silhouette, ViewStatus

Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

CORE_DEPTH_PX = 4
"""Beyond this depth behind the first trace of the body, blur no longer mixes the background in."""
REACH_PX = 13
"""Window over which the body's grey level is carried from the core outwards."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentationParameters:
    """Of background segmentation."""

    min_contrast: float = 0.12  # least difference from the background, as a share of it, that is a body
    dark_share: float = 0.5  # background below this share of the image's typical level is unknown
    min_body_px: float = 300.0  # smaller objects (below 1 mm) are dust
    second_body_share: float = 0.02  # of the largest body's area; a smaller one beside it is dust too
    hole_px: int = 400  # holes up to this area are glints on the body, larger ones are seen through

    def __post_init__(self) -> None:
        for name in ("min_contrast", "dark_share", "second_body_share"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"{name} must be between 0 and 1")
        if not self.min_body_px >= COARSE**2:
            raise ValueError(f"min_body_px must be at least {COARSE**2}")
        if self.hole_px < 0:
            raise ValueError("hole_px must not be negative")


@dataclass(frozen=True, slots=True)
class BackgroundSegmenter:
    """The `Segmenter` that compares with the empty rig."""

    parameters: SegmentationParameters = SegmentationParameters()

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """The silhouette of the one body in the frame."""
        known = background.get(frame.camera)
        if known is None or known.mean.shape != frame.image.shape:
            return _no_body(frame, ViewStatus.NO_BACKGROUND)
        coarse, coarse_background = coarsen(frame.image.astype(np.float32)), known.coarse
        gain = flash_gain(coarse, coarse_background)
        dark_below = self.parameters.dark_share * gain * known.typical
        status, region = self._locate(coarse, np.float32(gain) * coarse_background, dark_below)
        if region is None:
            return _no_body(frame, status)
        rows, columns = _full_size(region, frame.image.shape)
        image = frame.image[rows, columns].astype(np.float32)
        expected = np.float32(gain) * known.mean[rows, columns]
        body, unknown, coverage = self._delineate(image, expected, dark_below)
        seen = body & ~unknown
        if not seen.any():
            return _no_body(frame, ViewStatus.EMPTY)
        if _touches_border(seen, rows, columns, frame.image.shape):
            return _no_body(frame, ViewStatus.CLIPPED)
        distance_px, outline = signed_distance(body, coverage, unknown)
        labels = np.where(unknown, UNKNOWN, np.where(body, INSIDE, OUTSIDE))
        return Silhouette(
            camera=frame.camera,
            status=ViewStatus.OK,
            image_size_px=(frame.image.shape[1], frame.image.shape[0]),
            offset_uv=(columns.start, rows.start),
            labels=labels,
            distance_px=distance_px,
            outline_uv=outline + np.array([columns.start, rows.start]),
        )

    def _locate(
        self, coarse: Array, expected: Array, dark_below: float
    ) -> tuple[ViewStatus, tuple[int, int, int, int] | None]:
        """Box (x, y, width, height) of the body in coarse pixels, or why there is none.

        What lies on both sides of a dark dot is one body: the dot may hide the bridge.
        """
        p = self.parameters
        dark = expected < dark_below
        differs = (np.abs(expected - coarse) > p.min_contrast * expected + 4) & ~dark
        _, labels, boxes, _ = cv2.connectedComponentsWithStats((differs | dark).astype(np.uint8))
        sizes = np.bincount(labels[differs], minlength=len(boxes)) * COARSE**2
        sizes[0] = 0
        order = np.argsort(sizes)[::-1]
        if len(order) == 0 or sizes[order[0]] < p.min_body_px:
            return ViewStatus.EMPTY, None
        largest = int(order[0])
        if len(order) > 1 and sizes[order[1]] > max(p.min_body_px, p.second_body_share * sizes[largest]):
            return ViewStatus.MULTIPLE, None
        x, y, width, height = (int(size) for size in boxes[largest, :4])
        return ViewStatus.OK, (x, y, width, height)

    def _delineate(self, image: Array, expected: Array, dark_below: float) -> tuple[Mask, Mask, Array]:
        """Masks (h, w) of the body, with unknown pixels it may hide behind, and of the unknown; coverage c, 0..1."""
        difference = expected - image
        unknown: Mask = cv2.dilate((expected < dark_below).astype(np.uint8), _disc(2)).astype(bool)
        differs = (np.abs(difference) > self.parameters.min_contrast * expected + 4) & ~unknown
        core = cv2.erode(differs.astype(np.uint8), _disc(CORE_DEPTH_PX)).astype(np.float32)
        level = _carried(image, core, REACH_PX)
        if (lacking := np.isnan(level) & differs).any():
            # slivers too thin for a core, and edges beside the unknown, ask further around
            level[lacking] = _carried(image, core, 5 * REACH_PX)[lacking]
        level[np.isnan(level)] = _median(image[differs])
        contrast = expected - level
        unknown |= (np.abs(contrast) < self.parameters.min_contrast * expected) & (core == 0)
        coverage: Array = np.clip(difference / np.where(unknown, np.float32(1), contrast), 0, 1)
        coverage[core > 0] = 1  # light veins and dark stains: only the edge is judged by its surroundings
        inside = (coverage > 0.5) & ~unknown
        body = _largest_with_holes_filled(inside, unknown, self.parameters.hole_px)
        return body, unknown, coverage


def _no_body(frame: Frame, status: ViewStatus) -> Silhouette:
    height_px, width_px = frame.image.shape
    return Silhouette(camera=frame.camera, status=status, image_size_px=(width_px, height_px))


def _largest_with_holes_filled(inside: Mask, unknown: Mask, hole_px: int) -> Mask:
    """The component of *inside or unknown* with most of the inside: a connected body's silhouette is connected."""
    contours, hierarchy = cv2.findContours(
        (inside | unknown).astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE
    )
    largest, size = np.zeros_like(inside), 0
    for index, contour in enumerate(contours):
        _, _, first_hole, parent = hierarchy[0][index]
        if parent >= 0 or cv2.contourArea(contour) <= size:
            continue  # a hole, or too small to win
        part = np.zeros(inside.shape, np.uint8)
        cv2.drawContours(part, [contour], 0, 1, cv2.FILLED)
        while first_hole >= 0:
            hole = contours[first_hole]
            if cv2.contourArea(hole) > hole_px:
                cv2.drawContours(part, [hole], 0, 0, cv2.FILLED)
                cv2.drawContours(part, [hole], 0, 1, 1)  # a hole's contour runs on the body's pixels
            first_hole = hierarchy[0][first_hole][0]
        n_inside = int(np.count_nonzero(part & inside))
        if n_inside > size:
            largest, size = part.astype(bool), n_inside
    return largest


def _carried(image: Array, core: Array, window_px: int) -> Array:
    """Mean of the core's grey levels in the window around each pixel, NaN where the window holds no core."""
    window = (window_px, window_px)
    weight = cv2.blur(core, window)
    level = cv2.blur(image * core, window)
    return np.where(weight > 1e-4, level / np.maximum(weight, np.float32(1e-4)), np.float32(np.nan))


def _median(values: Array) -> np.float32:
    """Median of every sixteenth value, 0 of none: ten thousands of pixels are more than enough."""
    return np.float32(np.median(values[::16])) if values.size else np.float32(0)


def _full_size(region: tuple[int, int, int, int], shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of a coarse box in full resolution, with the margin, within the image."""
    x, y, width, height = (COARSE * size for size in region)
    margin = MARGIN_PX + COARSE
    return (
        slice(max(y - margin, 0), min(y + height + margin, shape[0])),
        slice(max(x - margin, 0), min(x + width + margin, shape[1])),
    )


def _touches_border(seen: Mask, rows: slice, columns: slice, shape: tuple[int, ...]) -> bool:
    return bool(
        (rows.start == 0 and seen[0].any())
        or (columns.start == 0 and seen[:, 0].any())
        or (rows.stop == shape[0] and seen[-1].any())
        or (columns.stop == shape[1] and seen[:, -1].any())
    )


def _disc(radius_px: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1,) * 2), np.uint8)
