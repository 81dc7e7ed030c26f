"""Neural segmentation: a network finds the body, grey levels place its edge.

What differs from the expected view says where to look; the network says what there is body, and where it
cannot tell. Its mask never decides the edge: it only bounds where `delineate` looks for it, and where the
grey levels do not decide either, or contradict the network, pixels are unknown and never carve.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.frames import Frame
from pipeline.segmentation.background import COARSE, BackgroundModel
from pipeline.segmentation.delineation import Delineation, delineate, no_body, silhouette_of
from pipeline.segmentation.expected_view import Ground, carried, ground_of
from pipeline.segmentation.lit_background import Behind
from pipeline.segmentation.local_threshold import limits_from
from pipeline.segmentation.network import Network
from pipeline.segmentation.network_region import Array, Bits, Box, Region, rectangle_around, whole
from pipeline.segmentation.network_trimap import (
    CORE,
    HALO_CONTRAST,
    POSSIBLE,
    SURE,
    SURELY_NOT,
    UNKNOWN,
    halo_of,
    limits_of,
)
from pipeline.segmentation.pixel_comparison import sampled
from pipeline.segmentation.prediction import BLUR, EDGE_PX, Answer, ask, dilated, eroded
from pipeline.segmentation.silhouette import INSIDE, MARGIN_PX, Silhouette, ViewStatus
from pipeline.segmentation.subtraction import SegmentationParameters

CORE_DEPTH_PX = 4
"""Beyond this depth in image pixels, inwards, the lens and the motion no longer mix."""
PROFILE_PX = 5
"""So far from where an edge may be grey levels are compared with what is expected."""
LOOSE = 1.5
"""A body that can be seen so many times finer is looked at again."""
SUSPECT = np.float32(HALO_CONTRAST / 2)
"""Difference from the smoothed expected view, as a share of it, at which every pixel is compared."""
OF_BITS = limits_from(*(np.arange(256) & bit != 0 for bit in (CORE, POSSIBLE, UNKNOWN)))
"""What `delineate` is told for the bits of `limits_of`."""
LEAST_RELATIVE = np.float32(0.005)
"""Of the wall: what is expected to be darker says nothing of the light."""


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
        network, image = self.network, frame.image
        found_by = "network" if network.kind == "stonefall" else network.kind
        known = background.get(frame.camera)
        if known is not None and known.mean.shape != image.shape:
            known = None
        coarse = sampled(image)
        ground = ground_of(coarse, known)
        region = self._around_differences(coarse, ground, image.shape)
        if region is None:
            if network.kind == "u2net":  # whose answer always has a greatest value
                return no_body(frame, ViewStatus.EMPTY, found_by)
            region = whole(image.shape, network.size_px, network.step_px)
        answer = ask(network, image, ground, region, self.parameters)
        if answer.status is ViewStatus.OK:
            closer = self._around(answer.box_px, EDGE_PX + COARSE // 2, image.shape)
            if region.scale >= LOOSE * closer.scale or answer.is_cut(image.shape):
                answer = ask(network, image, ground, closer, self.parameters)
        if answer.status is not ViewStatus.OK:
            return no_body(frame, answer.status, found_by)
        answer = answer.near_the_body()
        noise = _noise(image)
        limits, light = self._limits(answer, noise / ground.wall)
        behind = _behind(answer, ground, light, image.shape)
        rows, columns = answer.region.within(image.shape)
        seen = image[rows, columns].copy()
        delineation = self._delineate(seen, behind, limits)
        inside = answer.region.middles(delineation.labels, image.shape) == INSIDE
        suspect = np.abs(answer.image - answer.expected * light) > SUSPECT * answer.expected
        halo = halo_of(behind, seen, inside.view(np.uint8), suspect.view(np.uint8), noise)
        if halo.any():
            delineation = self._delineate(seen, behind, limits | (POSSIBLE | UNKNOWN) * halo)
        return silhouette_of(frame, (columns.start, rows.start), delineation, found_by)

    def _around_differences(self, coarse: Bits, ground: Ground, shape: tuple[int, ...]) -> Region | None:
        """A region around all that differs from what is expected; `None` if nothing does."""
        p, block_px = self.parameters, 2 * COARSE
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
        region = self._around((x, y, width, height), block_px, shape)
        everything = whole(shape, self.network.size_px, self.network.step_px)
        return region if region.scale <= everything.scale else everything

    def _around(self, box: Box, beside_px: int, shape: tuple[int, ...]) -> Region:
        """The region around a box in an image (H, W) that has room for a silhouette's margin, and so much more."""
        return rectangle_around(box, MARGIN_PX + beside_px, shape, self.network.size_px, self.network.step_px)

    def _limits(self, answer: Answer, noise: float) -> tuple[Bits, Array]:
        """Where to look for the edge, see `limits_of`, and the light relative to what was expected."""
        p, scale = self.parameters, answer.region.scale
        core = eroded(answer.body & (answer.probability > SURE), max(BLUR, round(CORE_DEPTH_PX / scale)))
        possible = dilated(answer.body, max(BLUR, round(EDGE_PX / scale)))
        outside = (
            (dilated(possible, 1) == 0)
            & (answer.probability < SURELY_NOT)
            & (answer.expected >= np.float32(p.dark_share))
        )
        relative = np.divide(answer.image, np.maximum(answer.expected, LEAST_RELATIVE), dtype=np.float32)
        light = carried(relative, outside.view(np.uint8))
        limits = limits_of(
            answer.image,
            answer.expected * light,
            carried(answer.image, core),
            answer.probability,
            core,
            possible,
            answer.undecided,
            p.dark_share,
            p.min_contrast,
            noise,
        )
        return limits, light

    def _delineate(self, seen: Bits, behind: Behind, limits: Bits) -> Delineation:
        """The body in the part (h, w) of an image that is in a region, between its limits (height, width)."""
        halves = behind.region.halved(limits, behind.shape)
        wanted = _beside_edge(limits, behind.region)
        gain, expected = behind.even_light(wanted), behind.empty
        if gain is None:
            gain, expected = 1.0, behind.lit(wanted)
        return delineate(
            seen,
            expected,
            np.asarray(cv2.LUT(halves, OF_BITS), np.uint8),
            gain=gain,
            min_contrast=self.parameters.min_contrast,
            hole_px=self.parameters.hole_px,
        )


def _behind(answer: Answer, ground: Ground, light: Array, shape: tuple[int, ...]) -> Behind:
    """What is expected where the answer's region is in an image (H, W)."""
    if ground.levels is not None:
        rows, columns = answer.region.within(shape)
        return Behind(
            region=answer.region,
            shape=shape,
            light=light * np.float32(ground.gain),
            empty=ground.levels[rows, columns].copy(),
        )
    expected = answer.region.enlarged(answer.expected, shape)
    empty = np.asarray(cv2.convertScaleAbs(expected, alpha=ground.wall), np.uint8)
    return Behind(region=answer.region, shape=shape, light=light, empty=empty)


def _beside_edge(limits: Bits, region: Region) -> Bits:
    """Where what is behind is asked for: at a possible edge, as far as the profile across it reaches."""
    square = np.ones((2 * -(-PROFILE_PX // region.scale) + 1,) * 2, np.uint8)
    return cv2.dilate(limits & POSSIBLE, square) - POSSIBLE * cv2.erode(limits & CORE, square)


def _noise(image: Bits) -> float:
    """Standard deviation of the noise, from neighbours on every 64th row: most pixels are smooth."""
    rows = np.ascontiguousarray(image[::64])
    return float(cv2.norm(rows[:, 1:], rows[:, :-1], cv2.NORM_L1) / rows[:, 1:].size * np.sqrt(np.pi) / 2)
