"""Background segmentation: the body is what differs from the empty rig; `delineation` places its edge.

Where the background itself is dark (screws, vents, apertures, holes) body and background cannot be
told apart: those pixels are unknown, and an unknown pixel never carves.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.frames import CameraId, Frame
from pipeline.segmentation.background import (
    COARSE,
    BackgroundModel,
    CameraBackground,
    flash_gain,
    uneven_light,
)
from pipeline.segmentation.delineation import delineate, no_body, silhouette_of
from pipeline.segmentation.silhouette import MARGIN_PX, Silhouette, ViewStatus

Grey = NDArray[np.uint8]
Array = NDArray[np.float32]
Level = TypeVar("Level", np.uint8, np.float32)
Box = tuple[int, int, int, int]  # x, y, width, height

FINE = 2
"""Within the region of the body every so many-th pixel of every so many-th row is compared."""
CORE_DEPTH = 2
"""Beyond this depth, in fine steps, behind the first trace of the body, blur no longer mixes the background in."""


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EmptyView:
    """What a view shows without a body, in the light of one flash; arrays (h, w)."""

    expected: Grey  # grey level
    allowed: Grey  # deviation from it that is no body
    dark: Grey  # 1 where no deviation tells anything
    gain: float  # strength of the flash, relative to the background's
    light: Array | None  # strength of the light at each place on top of that, `None` where it is even

    def differs(self, seen: Grey) -> Grey:
        """1 where an image is not the empty view."""
        deviation = np.asarray(cv2.absdiff(seen, self.expected), np.uint8)
        return (deviation > self.allowed).view(np.uint8) & ~self.dark


@dataclass(frozen=True, slots=True)
class BackgroundSegmenter:
    """The `Segmenter` that compares with the empty rig."""

    parameters: SegmentationParameters = SegmentationParameters()

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """The silhouette of the one body in the frame."""
        return self.compared(frame, background)[0]

    def compared(self, frame: Frame, background: BackgroundModel) -> tuple[Silhouette, EmptyView | None]:
        """The silhouette, and the empty view in coarse pixels that it was told from."""
        known = background.get(frame.camera)
        if known is None or known.mean.shape != frame.image.shape:
            return no_body(frame, ViewStatus.NO_BACKGROUND), None
        status, empty, box = self.locate(frame, known)
        if box is None:
            return no_body(frame, status), empty
        rows, columns = _full_size(box, frame.image.shape)
        image = frame.image[rows, columns].copy()
        expected = known.mean[rows, columns]
        if empty.light is not None:
            expected = expected * _magnified(empty.light, rows, columns, image.shape)

        seen = image[::FINE, ::FINE].copy()
        nearby = replace(
            empty,
            expected=_magnified(empty.expected, rows, columns, seen.shape),
            allowed=_magnified(empty.allowed, rows, columns, seen.shape),
            dark=_magnified(empty.dark, rows, columns, seen.shape),
        )
        unknown = np.asarray(cv2.dilate(nearby.dark, _disc(1)), np.uint8)
        differs = nearby.differs(seen) & (1 - unknown)
        delineation = delineate(
            image,
            expected,
            cv2.erode(differs, _disc(CORE_DEPTH)).view(np.bool_),
            cv2.dilate(differs, _disc(1)).view(np.bool_),
            unknown.view(np.bool_),
            gain=empty.gain,
            min_contrast=self.parameters.min_contrast,
            hole_px=self.parameters.hole_px,
        )
        return silhouette_of(frame, (columns.start, rows.start), delineation), empty

    def locate(self, frame: Frame, known: CameraBackground) -> tuple[ViewStatus, EmptyView, Box | None]:
        """Box of the body in coarse pixels, or why there is none, and the empty view in coarse pixels.

        What lies on both sides of a dark dot is one body: the dot may hide the bridge.
        """
        p = self.parameters
        seen = sampled(frame.image)  # noise is far below the least contrast
        gain = flash_gain(seen, known.coarse)
        light = uneven_light(seen, known, gain)
        wall = known.coarse if light is None else known.coarse * light
        empty = EmptyView(
            expected=_grey(wall, gain),
            allowed=_grey(wall, gain * p.min_contrast, 4),
            dark=(known.coarse < p.dark_share * known.typical).view(np.uint8),
            gain=gain,
            light=light,
        )
        # beside a dark dot a pixel differs from the mean of its block however still it stands
        dark = np.asarray(cv2.dilate(empty.dark, np.ones((3, 3), np.uint8)), np.uint8)
        differs = empty.differs(seen) & ~dark
        contours, _ = cv2.findContours(differs | dark, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        found = []
        for contour in contours:
            u, v, width, height = cv2.boundingRect(contour)
            if not differs[v : v + height, u : u + width].any():
                continue  # a dark dot
            part = np.zeros((height, width), np.uint8)
            cv2.drawContours(part, [contour], 0, 1, cv2.FILLED, offset=(-u, -v))
            n_pixels = cv2.countNonZero(part & differs[v : v + height, u : u + width])
            found.append((n_pixels * COARSE**2, (u, v, width, height)))
        found.sort(reverse=True)
        if not found or found[0][0] < p.min_body_px:
            return ViewStatus.EMPTY, empty, None
        if len(found) > 1 and found[1][0] > max(p.min_body_px, p.second_body_share * found[0][0]):
            return ViewStatus.MULTIPLE, empty, None
        return ViewStatus.OK, empty, found[0][1]


def sampled(image: Grey) -> Grey:
    """A pixel (H/4, W/4) from the middle of each block."""
    height, width = (size // COARSE for size in image.shape)
    middle = image[COARSE // 2 :: COARSE, COARSE // 2 :: COARSE]
    return np.ascontiguousarray(middle[:height, :width])


def warm_up() -> None:
    """Compile what segmentation needs, by segmenting views made up for it: seconds that the first stone has not.

    For regions within an image and as large as it: arrays with gaps between their rows and without.
    """
    camera = CameraId("warm-up")
    for size_px in (3 * MARGIN_PX, 6 * MARGIN_PX):
        image = np.full((size_px, size_px), 200, np.uint8)
        body = slice(size_px // 2 - 20, size_px // 2 + 20)
        image[body, body] = 60
        empty = CameraBackground(mean=np.full(image.shape, 200, np.float32), n_frames=1)
        frame = Frame(camera=camera, image=image, frame_id=0, device_ns=0, received_ns=0)
        silhouette = BackgroundSegmenter()(frame, {camera: empty})
        silhouette.measure_distance()


def _grey(levels: Array, factor: float, offset: float = 0.0) -> Grey:
    return np.asarray(cv2.convertScaleAbs(levels, alpha=factor, beta=offset), np.uint8)


def _full_size(box: Box, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of a coarse box in full resolution, with the margin, within the image."""
    x, y, width, height = (COARSE * size for size in box)
    margin = MARGIN_PX + COARSE
    return (
        slice(max(y - margin, 0), min(y + height + margin, shape[0])),
        slice(max(x - margin, 0), min(x + width + margin, shape[1])),
    )


def _magnified(coarse: NDArray[Level], rows: slice, columns: slice, shape: tuple[int, ...]) -> NDArray[Level]:
    """Values (H/4, W/4) of the blocks of an image in a region that begins with a block, brought to a shape (h, w)."""
    height, width = shape
    last_row, last_column = (-(-at.stop // COARSE) for at in (rows, columns))
    blocks = coarse[rows.start // COARSE : last_row, columns.start // COARSE : last_column]
    return np.asarray(cv2.resize(blocks, (width, height), interpolation=cv2.INTER_LINEAR), coarse.dtype)


def _disc(radius_px: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1,) * 2), np.uint8)
