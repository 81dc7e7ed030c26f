"""Background segmentation: the body is what differs from the empty rig; `delineation` places its edge.

Where the background itself is dark (screws, vents, apertures, holes) body and background cannot be
told apart: those pixels are unknown, and an unknown pixel never carves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.arrays import FloatImage, GreyImage
from pipeline.frames import Frame
from pipeline.segmentation.background import COARSE, BackgroundModel, CameraBackground
from pipeline.segmentation.delineation import delineate, no_body, silhouette_of
from pipeline.segmentation.detail import told_by_detail
from pipeline.segmentation.light import EVEN_SHARE, uneven_light
from pipeline.segmentation.noise import SensorNoise, noise_grey, smoothed
from pipeline.segmentation.pixel_comparison import DIFFERS, Thresholds, background_trimap, compare, sampled
from pipeline.segmentation.silhouette import MARGIN_PX, Silhouette, ViewStatus

Slices = tuple[slice, slice]  # rows, columns
Box = tuple[int, int, int, int]  # x, y, width, height


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentationParameters:
    """Limits that define a body in the comparison with the background."""

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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedView:
    """A view compared with the empty rig in the light of its flash; arrays (H/4, W/4)."""

    seen: GreyImage  # one pixel of each block
    levels: GreyImage  # grey level without a body, `gain` not applied
    gain: float  # strength of the flash, relative to the background's
    noise: float  # standard deviation of a pixel, grey levels
    light: FloatImage | None  # further factor on the light at each place, `None` where it is even
    marks: GreyImage  # DIFFERS, DARK, or neither
    differing: Slices  # rows and columns of what differs


@dataclass(frozen=True, slots=True)
class BackgroundSegmenter:
    """The `Segmenter` that compares with the empty rig."""

    parameters: SegmentationParameters = SegmentationParameters()

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """Return the silhouette of the one body in the frame."""
        return self.segment(frame, background)[0]

    def segment(self, frame: Frame, background: BackgroundModel) -> tuple[Silhouette, ComparedView | None]:
        """Return the silhouette, and the comparison with the empty rig that it was found by."""
        known = background.get(frame.camera)
        if known is None or known.mean.shape != frame.image.shape:
            return no_body(frame, ViewStatus.NO_BACKGROUND), None
        seen = sampled(frame.image)
        thresholds = self.thresholds(seen, known)
        compared = compare_view(seen, known, thresholds, noise_grey(frame.image))
        status, box = self.locate(compared)
        if status is ViewStatus.MULTIPLE:  # or one that is in places as grey as the wall behind it
            status, box = self.locate(_with_detail(compared, known.noise))
        if box is None:
            return no_body(frame, status), compared
        region = _full_size(box, frame.image.shape)
        image, empty = (smoothed(levels[region], compared.noise) for levels in (frame.image, known.levels))
        expected = lit_as(compared, empty, region)
        delineation = delineate(
            image,
            expected,
            background_trimap(image, expected, empty, thresholds),
            gain=compared.gain,
            noise=known.noise,
            min_contrast=self.parameters.min_contrast,
            hole_px=self.parameters.hole_px,
        )
        return silhouette_of(frame, (region[1].start, region[0].start), delineation), compared

    def locate(self, compared: ComparedView) -> tuple[ViewStatus, Box | None]:
        """Return the box of the body in coarse pixels, or why there is none.

        What lies on both sides of a dark dot is one body: the dot may hide what connects it.
        """
        p = self.parameters
        if not compared.differing[0].stop:
            return ViewStatus.EMPTY, None
        (top, left), marks, contours, boxes = _marked_components(compared)
        largest_px, second_px, largest = 0, 0, (0, 0, 0, 0)
        for number in sorted(range(len(boxes)), key=lambda i: -boxes[i][2] * boxes[i][3]):
            u, v, width, height = boxes[number]
            if width * height * COARSE**2 < max(p.min_body_px, p.second_body_share * largest_px):
                break  # this one and the smaller ones are dust
            differs = marks[v : v + height, u : u + width] & DIFFERS
            if len(contours) > 1:
                filled = np.zeros((height, width), np.uint8)
                cv2.drawContours(filled, [contours[number]], 0, 1, cv2.FILLED, offset=(-u, -v))
                differs &= filled
            n_px = COARSE**2 * cv2.countNonZero(differs)
            if n_px > largest_px:
                largest_px, second_px, largest = n_px, largest_px, (u, v, width, height)
            else:
                second_px = max(second_px, n_px)
        if largest_px < p.min_body_px:
            return ViewStatus.EMPTY, None
        if second_px > max(p.min_body_px, p.second_body_share * largest_px):
            return ViewStatus.MULTIPLE, None
        u, v, width, height = largest
        return ViewStatus.OK, (left + u, top + v, width, height)

    def thresholds(self, seen: GreyImage, known: CameraBackground) -> Thresholds:
        """Return the limits beyond which blocks (H/4, W/4) deviate from the empty view."""
        return Thresholds(
            gain=np.float32(known.gain(seen)),
            min_contrast=np.float32(self.parameters.min_contrast),
            dark=np.uint8(ceil(self.parameters.dark_share * known.typical)),
        )


def compare_view(
    seen: GreyImage, known: CameraBackground, thresholds: Thresholds, noise: float
) -> ComparedView:
    """Compare blocks (H/4, W/4) with the empty rig, in uneven light where the flash alone does not explain it.

    `noise` is the standard deviation of the image's pixels, in grey levels.
    """
    wall, levels, light = known.plain_wall, known.coarse_levels, None
    marks, ratio = np.empty_like(levels), np.empty_like(wall.levels)
    arrays = known.coarse_darkest, wall.levels, wall.is_plain, thresholds, marks, ratio
    *box, n_uneven = compare(seen, levels, *arrays)
    if n_uneven >= EVEN_SHARE * ratio.size:
        light = uneven_light(ratio, wall, levels.shape)
        levels = _lit(levels, light)
        *box, _ = compare(seen, levels, *arrays)
    left, top, right, bottom = box
    return ComparedView(
        seen=seen,
        levels=levels,
        gain=float(thresholds.gain),
        noise=noise,
        light=light,
        marks=marks,
        differing=(slice(top, bottom), slice(left, right)),
    )


def _with_detail(compared: ComparedView, noise: SensorNoise) -> ComparedView:
    """Return the comparison in which all that has detail differs; what lies between two bodies has none."""
    is_body, _ = told_by_detail(compared.seen, compared.levels, compared.gain, noise, even=1)
    return replace(compared, marks=np.where(is_body, DIFFERS, compared.marks))


def _marked_components(
    compared: ComparedView,
) -> tuple[tuple[int, int], GreyImage, Sequence[NDArray[np.int32]], list[Box]]:
    """Return the part of a view that differs: its row and column, the marks, their outer contours, and their boxes.

    It is the whole view if something marked leads out of that part.
    """
    rows, columns = (slice(max(at.start - 1, 0), at.stop + 1) for at in compared.differing)
    marks = compared.marks[rows, columns]
    height, width = marks.shape
    contours, boxes = _outer_contours(marks)
    if any(u == 0 or v == 0 or u + w == width or v + h == height for u, v, w, h in boxes):
        return (0, 0), compared.marks, *_outer_contours(compared.marks)
    return (rows.start, columns.start), marks, contours, boxes


def _outer_contours(marks: GreyImage) -> tuple[Sequence[NDArray[np.int32]], list[Box]]:
    """Return the outer contours of what is marked (h, w), and their boxes."""
    found, _ = cv2.findContours(marks, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    contours = [np.asarray(contour, np.int32) for contour in found]
    return contours, [(u, v, width, height) for u, v, width, height in map(cv2.boundingRect, contours)]


def _full_size(box: Box, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Return rows and columns of a coarse box in full resolution, with the margin, within the image."""
    x, y, width, height = (COARSE * size for size in box)
    margin = MARGIN_PX + COARSE
    return (
        slice(max(y - margin, 0), min(y + height + margin, shape[0])),
        slice(max(x - margin, 0), min(x + width + margin, shape[1])),
    )


def _block_slices(region: tuple[slice, slice]) -> tuple[slice, slice]:
    """Return rows and columns of the blocks of a region, which begins with one."""
    rows, columns = (slice(at.start // COARSE, -(-at.stop // COARSE)) for at in region)
    return rows, columns


def lit_as(compared: ComparedView, levels: GreyImage, region: Slices) -> GreyImage:
    """Return grey levels (h, w) of a region, which begins with a block, in the uneven light of a view, gain aside."""
    return levels if compared.light is None else _lit(levels, compared.light[_block_slices(region)])


def _lit(levels: GreyImage, light: FloatImage) -> GreyImage:
    """Return grey levels (h, w) in a light that is given at lower resolution for the same region."""
    height, width = levels.shape
    fine = cv2.resize(light, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.multiply(levels, fine, dtype=cv2.CV_8U), np.uint8)
