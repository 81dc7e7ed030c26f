"""Neural segmentation: a network finds the body, grey levels place its edge.

What differs from the expected view says where to look; the network says what there is body, and where it
cannot tell. Its mask never decides the edge: it only bounds where `delineate` looks for it, and where the
grey levels do not decide either, or contradict the network, pixels are unknown and never carve.
"""

from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.frames import Frame
from pipeline.segmentation.background import COARSE, BackgroundModel
from pipeline.segmentation.delineation import delineate, no_body, silhouette_of
from pipeline.segmentation.ground import Ground, carried, ground_of
from pipeline.segmentation.limits import (
    CORE,
    HALO_PX,
    POSSIBLE,
    SURE,
    SURELY_NOT,
    UNKNOWN,
    halo_of,
    limits_of,
)
from pipeline.segmentation.network import Network
from pipeline.segmentation.region import Array, Bits, Box, Region, square_around, whole
from pipeline.segmentation.silhouette import MARGIN_PX, Silhouette, ViewStatus
from pipeline.segmentation.subtraction import SegmentationParameters, sampled

BLUR = 2
"""The network's own blur, in its pixels: so far its edge may be from the true one."""
CORE_DEPTH_PX, EDGE_PX = 4, 4
"""Beyond these depths in image pixels, inwards and outwards, the lens and the motion no longer mix."""
PROFILE_PX = 4
"""So far from where an edge may be grey levels are compared with what is expected."""
LOOSE = 1.5
"""A body that can be seen so many times finer is looked at again."""
SURE_ALONE_SHARE = 0.0115
"""Of the view: without a background a smaller body (7 mm) is not told from a vent or a screw of the housing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """What the network says of a region; arrays have its size."""

    region: Region
    image: Array
    expected: Array
    probability: Array
    undecided: Bits  # not 0 where the network does not know, over more than its own blur
    body: Bits  # 1 for the largest body, with its holes, and for the undecided pixels that touch it
    status: ViewStatus


@dataclass(frozen=True, slots=True)
class NetworkSegmenter:
    """The `Segmenter` that asks a network."""

    network: Network
    parameters: SegmentationParameters

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """The silhouette of the one body in the frame; its `fallback` is the network's own."""
        found = self._found(frame, background)
        fallback = self.network.fallback  # asked afterwards: a provider may have failed just now
        return found if fallback is None else replace(found, fallback=fallback)

    def _found(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        found_by = "network" if self.network.kind == "stonefall" else self.network.kind
        image, size = frame.image, self.network.size_px
        known = background.get(frame.camera)
        if known is not None and known.mean.shape != image.shape:
            known = None
        coarse = sampled(image)
        ground = ground_of(coarse, known)
        differing = self._around_differences(coarse, ground, image.shape)
        if differing is None and self.network.kind == "u2net":  # whose answer always has a greatest value
            return no_body(frame, ViewStatus.EMPTY, found_by)
        answer = self._ask(image, ground, differing or whole(image.shape, size))
        if answer.status is ViewStatus.OK:
            closer = square_around(_box_px(answer), MARGIN_PX + EDGE_PX + COARSE // 2, image.shape, size)
            if answer.region.scale >= LOOSE * closer.scale or _is_cut(answer, image.shape):
                answer = self._ask(image, ground, closer)
        if answer.status is not ViewStatus.OK:
            return no_body(frame, answer.status, found_by)
        answer = _near_the_body(answer)
        noise = _noise(image)
        limits, light = self._limits(answer, ground, noise)
        region, (rows, columns) = answer.region, answer.region.within(image.shape)
        expected = (
            region.lit(light * np.float32(ground.gain), _beside_edge(limits, region), ground.mean)
            if ground.mean is not None
            else np.ascontiguousarray(region.enlarged(answer.expected * light, image.shape))
        )
        cut = image[rows, columns].copy()
        limits = region.halved(limits, image.shape)
        core, possible, unknown = ((limits & bit).astype(np.bool_) for bit in (CORE, POSSIBLE, UNKNOWN))
        place = partial(delineate, min_contrast=self.parameters.min_contrast, hole_px=self.parameters.hole_px)
        delineation = place(cut, expected, core, possible, unknown)
        if (halo := halo_of(cut, expected, delineation.labels, noise).view(np.bool_)).any():
            delineation = place(cut, expected, core, possible | halo, unknown | halo)
        return silhouette_of(frame, (columns.start, rows.start), delineation, found_by)

    def _around_differences(self, coarse: Bits, ground: Ground, shape: tuple[int, ...]) -> Region | None:
        """A region around all that differs from what is expected; `None` if nothing does."""
        p, size, block_px = self.parameters, self.network.size_px, 2 * COARSE
        seen, empty = np.ascontiguousarray(coarse[::2, ::2]), np.ascontiguousarray(ground.coarse[::2, ::2])
        expected = cv2.convertScaleAbs(empty, alpha=ground.gain)
        allowed = cv2.convertScaleAbs(empty, alpha=ground.gain * p.min_contrast, beta=4)
        differs = (cv2.absdiff(seen, expected) > allowed).view(np.uint8)
        contours, _ = cv2.findContours(differs, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
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
        seen = region.reduced(image)
        expected = region.sampled(ground.coarse) * np.float32(ground.gain)
        probability = self.network.probability(seen / wall, None if ground.mean is None else expected / wall)
        is_body = (probability > 0.5).view(np.uint8)
        undecided = cv2.inRange(probability, float(SURELY_NOT), float(SURE))
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
        elif ground.mean is None and areas[0] < SURE_ALONE_SHARE * image.size / region.scale**2:
            status = ViewStatus.NO_BACKGROUND
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

    def _limits(self, answer: Answer, ground: Ground, noise: float) -> tuple[Bits, Array]:
        """Where to look for the edge, see `limits_of`, and the light relative to what was expected."""
        p, scale = self.parameters, answer.region.scale
        dark = p.dark_share * ground.wall
        core = _eroded(answer.body & (answer.probability > SURE), max(BLUR, round(CORE_DEPTH_PX / scale)))
        possible = _dilated(answer.body, max(BLUR, round(EDGE_PX / scale)))
        outside = (_dilated(possible, 1) == 0) & (answer.probability < SURELY_NOT) & (answer.expected >= dark)
        relative = np.divide(answer.image, np.maximum(answer.expected, 1), dtype=np.float32)
        light = carried(relative, outside.view(np.uint8))
        limits = limits_of(
            answer.image,
            answer.expected * light,
            carried(answer.image, core),
            answer.probability,
            core,
            possible,
            answer.undecided,
            dark,
            p.min_contrast,
            noise,
        )
        return limits, light


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
        # compiled loops are compiled again for arrays with gaps
        image=np.ascontiguousarray(answer.image[part]),
        expected=np.ascontiguousarray(answer.expected[part]),
        probability=np.ascontiguousarray(answer.probability[part]),
        undecided=np.ascontiguousarray(answer.undecided[part]),
        body=np.ascontiguousarray(answer.body[part]),
        status=answer.status,
    )


def _beside_edge(limits: Bits, region: Region) -> Bits:
    """Where the expected grey level is asked for: at a possible edge, and in the halo around it."""
    inwards, outwards = (-(-reach_px // region.scale) for reach_px in (PROFILE_PX, HALO_PX[1] + PROFILE_PX))
    square = [np.ones((2 * reach + 1,) * 2, np.uint8) for reach in (inwards, outwards)]
    return cv2.dilate(limits & POSSIBLE, square[1]) - POSSIBLE * cv2.erode(limits & CORE, square[0])


def _noise(image: Bits) -> float:
    """Standard deviation of the noise, from neighbours on every 64th row: most pixels are smooth."""
    rows = np.ascontiguousarray(image[::64])
    return float(cv2.norm(rows[:, 1:], rows[:, :-1], cv2.NORM_L1) / rows[:, 1:].size * np.sqrt(np.pi) / 2)


def _eroded(mask: NDArray[np.generic], radius_px: int) -> Bits:
    return np.asarray(cv2.erode(np.asarray(mask, np.uint8), _disc(radius_px)), np.uint8)


def _dilated(mask: Bits, radius_px: int) -> Bits:
    return np.asarray(cv2.dilate(mask, _disc(radius_px)), np.uint8)


def _disc(radius_px: int) -> Bits:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius_px + 1,) * 2), np.uint8)
