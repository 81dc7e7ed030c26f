"""Neural segmentation: a network finds the body, grey levels place its edge.

What differs from the expected view says where to look; the network says what there is body, and where it
cannot tell. Its mask never decides the edge: it only bounds where `delineate` looks for it, and where the
grey levels do not decide either, or contradict the network, pixels are unknown and never carve.
"""

from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.frames import Frame
from pipeline.segmentation.background import COARSE, BackgroundModel
from pipeline.segmentation.delineation import delineate, no_body, silhouette_of
from pipeline.segmentation.ground import Ground, carried, ground_of
from pipeline.segmentation.network import Network
from pipeline.segmentation.region import Array, Bits, Box, Region, square_around, whole
from pipeline.segmentation.silhouette import MARGIN_PX, Silhouette, ViewStatus
from pipeline.segmentation.subtraction import SegmentationParameters

Mask = NDArray[np.bool_]

SURE, POSSIBLE = 0.9, 0.1
"""P(body) from which on a pixel is body, and up to which it is not; between, the network does not know."""
BLUR = 2
"""The network's own blur, in its pixels: so far its edge may be from the true one."""
CORE_DEPTH_PX, EDGE_PX = 4, 4
"""Beyond these depths in image pixels, inwards and outwards, the lens and the motion no longer mix."""
LOOSE = 1.5
"""A body that can be seen so many times finer is looked at again."""
AGREED = 0.7
"""Coverage by grey levels of a pixel that the network is sure of; below, the two contradict each other."""
HALO_PX = (4, 16)
"""Beyond the first distance from its edge neither lens nor motion show a body; up to the second it is looked for."""
HALO_CONTRAST = 0.06
"""Difference from the expected, as a share of it, that shows a body there all the same."""
NOISE_SIGMAS = 4.0
"""Contrast below so many standard deviations of the noise decides nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """What the network says of a region; arrays have its size."""

    region: Region
    image: Array
    expected: Array
    probability: Array
    undecided: Bits  # 1 where the network does not know, over more than its own blur
    body: Bits  # 1 for the largest body, with its holes, and for the undecided pixels that touch it
    status: ViewStatus


@dataclass(frozen=True, slots=True)
class NetworkSegmenter:
    """The `Segmenter` that asks a network."""

    network: Network
    parameters: SegmentationParameters

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """The silhouette of the one body in the frame."""
        found_by = "network" if self.network.kind == "stonefall" else self.network.kind
        image, size = frame.image, self.network.size_px
        known = background.get(frame.camera)
        if known is not None and known.mean.shape != image.shape:
            known = None
        height, width = (side // COARSE for side in image.shape)
        middle = slice(COARSE // 2, None, COARSE)
        coarse = image[middle, middle][:height, :width].astype(np.float32)
        ground = ground_of(coarse, known)
        differing = self._around_differences(coarse, ground, image.shape)
        if differing is None and self.network.kind == "u2net":  # whose answer always has a greatest value
            return no_body(frame, ViewStatus.EMPTY, found_by)
        answer = self._ask(image, ground, differing or whole(image.shape, size))
        if answer.status is ViewStatus.OK:
            closer = square_around(_box_px(answer), MARGIN_PX + EDGE_PX, image.shape, size)
            if answer.region.scale >= LOOSE * closer.scale or _is_cut(answer, image.shape):
                answer = self._ask(image, ground, closer)
        if answer.status is not ViewStatus.OK:
            return no_body(frame, answer.status, found_by)
        answer = _near_the_body(answer)
        noise = _noise(image)
        core, possible, unknown, light = self._limits(answer, ground, noise)
        region, (rows, columns) = answer.region, answer.region.within(image.shape)
        expected = (
            region.enlarged(answer.expected * light, image.shape)
            if ground.mean is None
            else region.enlarged(light * np.float32(ground.gain), image.shape) * ground.mean[rows, columns]
        )
        cut = image[rows, columns]
        core, possible, unknown = (region.halved(mask, image.shape) for mask in (core, possible, unknown))
        place = partial(delineate, min_contrast=self.parameters.min_contrast, hole_px=self.parameters.hole_px)
        delineation = place(cut, expected, core, possible, unknown)
        if (halo := _halo(cut, expected, delineation.labels, noise)).any():
            delineation = place(cut, expected, core, possible | halo, unknown | halo)
        return silhouette_of(frame, (columns.start, rows.start), delineation, found_by)

    def _around_differences(self, coarse: Array, ground: Ground, shape: tuple[int, ...]) -> Region | None:
        """A region around all that differs from what is expected; `None` if nothing does."""
        p, size, block_px = self.parameters, self.network.size_px, 2 * COARSE
        seen, expected = coarse[::2, ::2], ground.coarse[::2, ::2]
        differs = np.abs(expected - seen) > p.min_contrast * expected + 4
        contours, _ = cv2.findContours(differs.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        boxes = [cv2.boundingRect(contour) for contour in contours]
        areas_px = [width * height * block_px**2 for _, _, width, height in boxes]
        least_px = max(p.min_body_px, p.second_body_share * max(areas_px, default=0))
        relevant = [
            contour for contour, area_px in zip(contours, areas_px, strict=True) if area_px >= least_px
        ]
        if not relevant:
            return None
        x, y, width, height = (block_px * at for at in cv2.boundingRect(np.concatenate(relevant)))
        square = square_around((x, y, width, height), MARGIN_PX + block_px, shape, size)
        return square if square.scale * size <= max(shape) else whole(shape, size)

    def _ask(self, image: Bits, ground: Ground, region: Region) -> Answer:
        """What the network finds in a region."""
        p, wall = self.parameters, np.float32(ground.wall)
        seen, expected = region.reduced(image), region.sampled(ground.coarse)
        probability = self.network.probability(seen / wall, None if ground.mean is None else expected / wall)
        is_body = (probability > 0.5).astype(np.uint8)
        undecided = ((probability > POSSIBLE) & (probability < SURE)).astype(np.uint8)
        undecided = _dilated(_eroded(undecided, BLUR), BLUR)
        contours, _ = cv2.findContours(is_body | undecided, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        least = p.min_body_px / region.scale**2
        parts = []
        for contour in contours:
            if cv2.contourArea(contour) + len(contour) < least:
                continue
            part = np.zeros_like(is_body)
            cv2.drawContours(part, [contour], 0, 1, cv2.FILLED)
            parts.append((cv2.countNonZero(part & is_body), part))
        parts.sort(key=lambda sized: -sized[0])
        areas = [area for area, _ in parts] + [0, 0]
        status = ViewStatus.OK
        if areas[0] < least:
            status = ViewStatus.EMPTY
        elif areas[1] > max(least, p.second_body_share * areas[0]):
            status = ViewStatus.MULTIPLE
        return Answer(
            region=region,
            image=seen,
            expected=expected,
            probability=probability,
            undecided=undecided,
            body=parts[0][1] if parts else is_body,
            status=status,
        )

    def _limits(self, answer: Answer, ground: Ground, noise: float) -> tuple[Mask, Mask, Mask, Array]:
        """Where to look for the edge: core, possible, unknown, and the light relative to what was expected."""
        p, scale = self.parameters, answer.region.scale
        sure, surely_not = answer.probability > SURE, answer.probability < POSSIBLE
        core = _eroded(answer.body & sure, max(BLUR, round(CORE_DEPTH_PX / scale)))
        possible = _dilated(answer.body, max(BLUR, round(EDGE_PX / scale)))
        is_dark = answer.expected < p.dark_share * ground.wall
        outside = (_dilated(possible, 1) == 0) & surely_not & ~is_dark
        relative = np.asarray(answer.image / np.maximum(answer.expected, 1), np.float32)
        light, level = carried((relative, outside), (answer.image, core != 0))
        expected = answer.expected * light
        difference, contrast = expected - answer.image, expected - level
        covered, contrast = difference * np.sign(contrast), np.abs(contrast)
        least = np.maximum(p.min_contrast * expected, NOISE_SIGMAS * noise)
        at_edge = possible > core
        unknown = (
            (at_edge & (contrast < least))
            # grey levels and network contradict each other
            | (at_edge & sure & (covered < AGREED * contrast))
            | (at_edge & surely_not & (covered > (1 - AGREED) * contrast))
            # a dark body before a dark aperture looks as the aperture alone
            | (is_dark & (np.abs(difference) < least))
            | (answer.undecided != 0)
        )
        return core != 0, possible != 0, unknown & (possible != 0), light


def _box(body: Bits) -> Box:
    x, y, width, height = cv2.boundingRect(body)
    return x, y, width, height


def _box_px(answer: Answer) -> Box:
    """Of the body, in image pixels."""
    region = answer.region
    x, y, width, height = (region.scale * at for at in _box(answer.body))
    return x + region.left, y + region.top, width, height


def _margin(region: Region) -> int:
    """A silhouette's margin, in the network's pixels."""
    return -(-(MARGIN_PX + EDGE_PX) // region.scale)


def _is_cut(answer: Answer, shape: tuple[int, ...]) -> bool:
    """Whether the image has more of the body's margin than the region does."""
    x, y, width, height = _box(answer.body)
    (rows, columns), margin = answer.region.within(shape), _margin(answer.region)
    return (
        (x < margin and columns.start > 0)
        or (y < margin and rows.start > 0)
        or (x + width + margin > answer.region.width and columns.stop < shape[1])
        or (y + height + margin > answer.region.height and rows.stop < shape[0])
    )


def _near_the_body(answer: Answer) -> Answer:
    """The answer for the body and a silhouette's margin around it."""
    region, part = answer.region.part(_box(answer.body), _margin(answer.region))
    return Answer(
        region=region,
        image=answer.image[part],
        expected=answer.expected[part],
        probability=answer.probability[part],
        undecided=answer.undecided[part],
        body=answer.body[part],
        status=answer.status,
    )


def _noise(image: Bits) -> float:
    """Standard deviation of the noise, from neighbours on every 64th row: most pixels are smooth."""
    rows = np.ascontiguousarray(image[::64])
    return float(cv2.absdiff(rows[:, 1:], rows[:, :-1]).mean() * np.sqrt(np.pi) / 2)


def _halo(image: Bits, expected: Array, labels: Bits, noise: float) -> Mask:
    """Around what differs from the expected just outside of the body found: a rim, a highlight, a sharp shadow.

    As all masks for `delineate`, it is given for every second row and column.
    """
    every_second = (slice(None, None, 2),) * 2
    body, behind = np.minimum(labels[every_second], 1), expected[every_second]
    difference = np.abs(cv2.blur(behind - image[every_second], (3, 3)))
    differs = difference > np.maximum(HALO_CONTRAST * behind, NOISE_SIGMAS / 3 * noise)
    near = _dilated(body, HALO_PX[0] // 2)
    around = cv2.dilate(
        body, np.ones((HALO_PX[1] + 1,) * 2, np.uint8)
    )  # a disc of this size costs ten times more
    beyond = (differs & (around > near)).astype(np.uint8)
    return cv2.dilate(beyond, np.ones((HALO_PX[0] * 2 + 1,) * 2, np.uint8)) != 0


def _eroded(mask: NDArray[np.generic], radius_px: int) -> Bits:
    return np.asarray(cv2.erode(np.asarray(mask, np.uint8), _disc(radius_px)), np.uint8)


def _dilated(mask: Bits, radius_px: int) -> Bits:
    return np.asarray(cv2.dilate(mask, _disc(radius_px)), np.uint8)


def _disc(radius_px: int) -> Bits:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1,) * 2), np.uint8)
