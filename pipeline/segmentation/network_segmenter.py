"""Neural segmentation: a network finds the body, grey levels place its edge.

What differs from the expected view says where to look; the network says which pixels are body, and which it
cannot tell. Its mask never decides the edge: it only bounds where `delineate` looks for it, and where the
grey levels do not decide either, or contradict the network, pixels are unknown and never carve.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.arrays import FloatImage, GreyImage
from pipeline.frames import Frame
from pipeline.segmentation.background import COARSE, BackgroundModel
from pipeline.segmentation.delineation import Delineation, delineate, no_body, silhouette_of
from pipeline.segmentation.expected_view import ExpectedView, expected_view, extrapolated
from pipeline.segmentation.lit_background import LitBackground
from pipeline.segmentation.local_threshold import trimap_of
from pipeline.segmentation.network import Network, NetworkKind
from pipeline.segmentation.network_region import Box, Region, region_around, whole_image_region
from pipeline.segmentation.network_trimap import (
    CORE,
    HALO_CONTRAST,
    POSSIBLE,
    UNKNOWN,
    find_halo,
    network_trimap,
)
from pipeline.segmentation.noise import noise_grey, smoothed
from pipeline.segmentation.pixel_comparison import sampled
from pipeline.segmentation.prediction import (
    EDGE_BLUR_PX,
    NETWORK_BLUR_PX,
    SURE,
    SURELY_NOT,
    Prediction,
    dilated,
    eroded,
    predict,
)
from pipeline.segmentation.silhouette import INSIDE, MARGIN_PX, FoundBy, Silhouette, ViewStatus
from pipeline.segmentation.subtraction import SegmentationParameters

CORE_DEPTH_PX = 4
"""Lens and motion mix body and background up to this depth inside the edge, in image pixels."""
PROFILE_PX = 5
"""Grey levels are compared with the expected ones up to this distance from a possible edge."""
MIN_ZOOM = 1.5
"""A body that can be seen at a resolution higher by this factor is looked at again."""
SUSPECT = np.float32(HALO_CONTRAST / 2)
"""Difference from the smoothed expected view, as a share of it, at which every pixel is compared."""
TRIMAP_OF_BITS = trimap_of(*(np.arange(256) & bit != 0 for bit in (CORE, POSSIBLE, UNKNOWN)))
"""Look-up table from the bits of `network_trimap` to what `delineate` takes."""
MIN_EXPECTED = np.float32(0.005)
"""Expected level, as a share of the wall, below which the light cannot be judged."""


@dataclass(frozen=True, slots=True)
class NetworkSegmenter:
    """The `Segmenter` that runs a network."""

    network: Network
    parameters: SegmentationParameters

    def __call__(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        """Return the silhouette of the one body in the frame; its `fallback` is the network's own."""
        found = self._segment(frame, background)
        fallback = self.network.fallback  # asked afterwards: a provider may have failed just now
        return found if fallback is None else replace(found, fallback=fallback, network_trouble=fallback)

    def _segment(self, frame: Frame, background: BackgroundModel) -> Silhouette:
        network, image = self.network, frame.image
        found_by = FoundBy.NETWORK if network.kind is NetworkKind.OURS else FoundBy.U2NET
        known = background.get(frame.camera)
        if known is not None and known.mean.shape != image.shape:
            known = None
        coarse = sampled(image)
        expected = expected_view(coarse, known)
        region = self._region_of_differences(coarse, expected, image.shape)
        if region is None:
            if network.kind is NetworkKind.U2NET:  # whose answer always has a greatest value
                return no_body(frame, ViewStatus.EMPTY, found_by)
            region = whole_image_region(image.shape, network.size_px, network.step_px)
        prediction = predict(network, image, expected, region, self.parameters)
        if prediction.status is ViewStatus.OK:
            closer = self._region_around(prediction.box_px, EDGE_BLUR_PX + COARSE // 2, image.shape)
            if region.scale >= MIN_ZOOM * closer.scale or prediction.lacks_margin(image.shape):
                prediction = predict(network, image, expected, closer, self.parameters)
        if prediction.status is not ViewStatus.OK:
            return no_body(frame, prediction.status, found_by)
        prediction = prediction.cropped_to_body()
        noise = noise_grey(image)
        bits, light = self._trimap_bits(prediction, noise / expected.wall)
        lit = _lit_background(prediction, expected, light, image.shape, noise)
        rows, columns = prediction.region.within(image.shape)
        seen = smoothed(image[rows, columns], noise)
        delineation = self._delineate(seen, lit, bits)
        inside = prediction.region.at_centres(delineation.labels, image.shape) == INSIDE
        suspect = np.abs(prediction.image - prediction.expected * light) > SUSPECT * prediction.expected
        halo = find_halo(lit, seen, inside.view(np.uint8), suspect.view(np.uint8), noise)
        if halo.any():
            delineation = self._delineate(seen, lit, bits | (POSSIBLE | UNKNOWN) * halo)
        return silhouette_of(frame, (columns.start, rows.start), delineation, found_by)

    def _region_of_differences(
        self, coarse: GreyImage, expected: ExpectedView, shape: tuple[int, ...]
    ) -> Region | None:
        """Return a region around all that differs from what is expected; `None` if nothing does."""
        p, block_px = self.parameters, 2 * COARSE
        seen, empty = np.ascontiguousarray(coarse[::2, ::2]), np.ascontiguousarray(expected.coarse[::2, ::2])
        lit = cv2.convertScaleAbs(empty, alpha=expected.gain)
        allowed = cv2.convertScaleAbs(empty, alpha=expected.gain * p.min_contrast, beta=4)
        differs = (cv2.absdiff(seen, lit) > allowed).view(np.uint8)
        contours, _ = cv2.findContours(differs, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        boxes = [cv2.boundingRect(contour) for contour in contours]
        areas_px = [width * height * block_px**2 for _, _, width, height in boxes]
        min_px = max(p.min_body_px, p.second_body_share * max(areas_px, default=0))
        relevant = [contour for contour, area_px in zip(contours, areas_px, strict=True) if area_px >= min_px]
        if not relevant:
            return None
        x, y, width, height = (block_px * at for at in cv2.boundingRect(np.concatenate(relevant)))
        region = self._region_around((x, y, width, height), block_px, shape)
        everything = whole_image_region(shape, self.network.size_px, self.network.step_px)
        return region if region.scale <= everything.scale else everything

    def _region_around(self, box: Box, beside_px: int, shape: tuple[int, ...]) -> Region:
        """Return the region around a box in an image (H, W) with room for a silhouette's margin and `beside_px`."""
        return region_around(box, MARGIN_PX + beside_px, shape, self.network.size_px, self.network.step_px)

    def _trimap_bits(self, prediction: Prediction, noise: float) -> tuple[GreyImage, FloatImage]:
        """Return where to look for the edge, see `network_trimap`, and the light relative to what was expected.

        `noise` is the standard deviation of a pixel as a share of the wall.
        """
        p, scale = self.parameters, prediction.region.scale
        core_depth, edge_blur = (
            max(NETWORK_BLUR_PX, round(distance_px / scale)) for distance_px in (CORE_DEPTH_PX, EDGE_BLUR_PX)
        )
        core = eroded(prediction.body & (prediction.probability > SURE), core_depth)
        possible = dilated(prediction.body, edge_blur)
        outside = (
            (dilated(possible, 1) == 0)
            & (prediction.probability < SURELY_NOT)
            & (prediction.expected >= np.float32(p.dark_share))
        )
        expected = np.maximum(prediction.expected, MIN_EXPECTED)
        relative = np.divide(prediction.image, expected, dtype=np.float32)
        light = extrapolated(relative, outside.view(np.uint8))
        return network_trimap(prediction, light, core, possible, p, noise), light

    def _delineate(self, seen: GreyImage, lit: LitBackground, bits: GreyImage) -> Delineation:
        """Delineate the body in the part (h, w) of an image that is in a region, of trimap bits (height, width)."""
        halves = lit.region.halved(bits, lit.shape)
        needed = _beside_edge(bits, lit.region)
        gain, expected = lit.uniform_gain(needed), lit.levels
        if gain is None:
            gain, expected = 1.0, lit.lit_levels(needed)
        return delineate(
            seen,
            expected,
            np.asarray(cv2.LUT(halves, TRIMAP_OF_BITS), np.uint8),
            gain=gain,
            min_contrast=self.parameters.min_contrast,
            hole_px=self.parameters.hole_px,
        )


def _lit_background(
    prediction: Prediction, expected: ExpectedView, light: FloatImage, shape: tuple[int, ...], noise: float
) -> LitBackground:
    """Return the expected background in the prediction's region of an image (H, W) with this noise."""
    if expected.levels is not None:
        rows, columns = prediction.region.within(shape)
        return LitBackground(
            region=prediction.region,
            shape=shape,
            light=light * np.float32(expected.gain),
            levels=smoothed(expected.levels[rows, columns], noise),
        )
    relative = prediction.region.enlarged(prediction.expected, shape)
    levels = np.asarray(cv2.convertScaleAbs(relative, alpha=expected.wall), np.uint8)
    return LitBackground(region=prediction.region, shape=shape, light=light, levels=levels)


def _beside_edge(bits: GreyImage, region: Region) -> GreyImage:
    """Return not 0 where the background is needed: at a possible edge, as far as the profile across it reaches."""
    square = np.ones((2 * -(-PROFILE_PX // region.scale) + 1,) * 2, np.uint8)
    return cv2.dilate(bits & POSSIBLE, square) - POSSIBLE * cv2.erode(bits & CORE, square)
