"""What differs from the empty rig in one view, part by part, and a view with some of it painted over.

A part is a connected region of blocks of `COARSE` pixels: a body, a piece of one, or several bodies that touch or
cover each other there.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.arrays import Flags, Indices32, Mask, PointsUV
from pipeline.frames import Frame
from pipeline.segmentation.background import COARSE, CameraBackground
from pipeline.segmentation.noise import noise_grey
from pipeline.segmentation.pixel_comparison import DIFFERS, sampled
from pipeline.segmentation.subtraction import (
    BackgroundSegmenter,
    ComparedView,
    SegmentationParameters,
    compare_view,
    lit_as,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewParts:
    """The N parts of one view, numbered from 1 in arrays (H/4, W/4) of blocks."""

    numbers: Indices32  # 0 where there is none, or only dust
    joined: Indices32  # the same with all that is too dark to tell: what lies on both sides of it may be connected
    centers_uv: PointsUV  # (N, 2) px
    is_cut: Flags  # (N,) by the border of the image
    compared: ComparedView | None = None


def parts_of(marks: Mask, is_dark: Mask, min_px: float, compared: ComparedView | None = None) -> ViewParts:
    """Return the parts of what differs and what is too dark to tell, both (H/4, W/4); smaller than `min_px` is dust."""
    _, found, boxes, centers = cv2.connectedComponentsWithStats(marks.view(np.uint8))
    _, joined = cv2.connectedComponents((marks | is_dark).view(np.uint8))
    height, width = marks.shape
    kept = [n for n in range(1, len(boxes)) if boxes[n, cv2.CC_STAT_AREA] * COARSE**2 >= min_px]
    numbers = np.zeros(len(boxes), np.int32)
    numbers[kept] = np.arange(1, len(kept) + 1)
    left, top, wide, high = boxes[kept, : cv2.CC_STAT_AREA].T
    return ViewParts(
        numbers=numbers[found],
        joined=np.asarray(joined, np.int32),
        centers_uv=np.asarray(COARSE * centers[kept] + (COARSE - 1) / 2, np.float64),
        is_cut=np.asarray((left == 0) | (top == 0) | (left + wide == width) | (top + high == height)),
        compared=compared,
    )


def view_parts(
    frame: Frame, known: CameraBackground | None, parameters: SegmentationParameters
) -> ViewParts | None:
    """Return the parts of a view that differ from the empty rig, `None` if that is not known."""
    if known is None or known.mean.shape != frame.image.shape:
        return None
    seen = sampled(frame.image)
    thresholds = BackgroundSegmenter(parameters).thresholds(seen, known)
    compared = compare_view(seen, known, thresholds, noise_grey(frame.image))
    differs = compared.marks == DIFFERS
    is_dark = compared.marks > DIFFERS
    return parts_of(differs, is_dark, parameters.min_body_px, compared)


def painted_over(frame: Frame, known: CameraBackground, compared: ComparedView, blocks: Mask) -> Frame:
    """Return the frame with the empty rig in these blocks (H/4, W/4), in the light and with the noise of this image."""
    image = frame.image.copy()
    whole = blocks.view(np.uint8).repeat(COARSE, axis=0).repeat(COARSE, axis=1)
    missing = [(0, size - covered) for size, covered in zip(image.shape, whole.shape, strict=True)]
    wide = np.pad(whole, missing, mode="edge")
    left, top, box_width, box_height = cv2.boundingRect(wide)
    region = slice(top, top + box_height), slice(left, left + box_width)
    levels = compared.gain * lit_as(compared, known.levels[region], region).astype(np.float32)
    noise = np.random.default_rng(0).standard_normal(levels.shape, np.float32)
    levels += noise * np.sqrt(known.noise.variance_grey2(levels))
    painted = np.rint(levels).clip(0, 255).astype(np.uint8)
    is_painted = wide[region] != 0
    image[region][is_painted] = painted[is_painted]
    return replace(frame, image=image)
