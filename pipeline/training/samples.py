"""Training samples: bodies before walls, disturbed in every way that segmentation should survive, with the truth.

Composing one takes some milliseconds, so every sample of a training run is new.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import cv2
import numpy as np

from pipeline.arrays import FloatImage, GreyImage, Singles
from pipeline.segmentation.light import flash_gain
from pipeline.segmentation.network import MAX_RELATIVE
from pipeline.synthesis.background import WALL_GREY
from pipeline.synthesis.disturbance import cast_shadow, dust
from pipeline.synthesis.exposure import ExposureParameters
from pipeline.synthesis.thin_lens import ThinLens
from pipeline.training.image_layers import CANVAS_PX, VIEW_PX, BodyLayer, WallLayer

T = TypeVar("T")

N_BODIES = (0.08, 0.72, 0.12, 0.08)
"""Probabilities of none, one, two and three bodies in a view."""
FRAGMENTS_SHARE, MAX_FRAGMENTS = 0.12, 5
DUST_SHARE, SHADOW_SHARE, SLOPE_SHARE, DIM_SHARE = 0.2, 0.2, 0.3, 0.5
PATCHES_SHARE, PATCHES_CONTRAST, N_PATCHES = 0.2, (0.1, 0.4), (3, 32)
"""Share of samples with larger patches on all bodies, their relative sd, and how many lie side by side in a view."""
MOTION_SHARE, LONGEST_MOTION_PX = 0.2, 9.0
BLUR_SHARE, WIDEST_BLUR_PX = 0.3, 6.0
"""Share of samples whose whole image is out of focus, and the greatest sigma of that, in image pixels."""
VIGNETTING_SHARE, MOST_VIGNETTING = 0.4, 0.08
"""Share of samples that a lens darkens around its axis, and about the greatest loss of light half a view from it."""
GLARE_SHARE, MOST_GLARE = 0.4, 0.05
"""Share of samples with glare, and the greatest part of the light that it spreads."""
NO_BACKGROUND_SHARE = 0.3
CLEAN_BACKGROUND_SHARE = 0.6
"""Share of the known backgrounds that were learnt before dust, shadow and slope; the others show them, too."""
STRONG_NOISE = (1.0, 12.0)
"""Range of the read noise (log-uniform), in grey levels, in two of five samples; the others have the design's."""
BRIGHTEST = 255.0


class TrainingSample(NamedTuple):
    """Input and target of the network."""

    view: Singles  # (2, VIEW_PX, VIEW_PX) image and expected wall, relative to the plain wall, 0..2
    coverage: FloatImage  # (VIEW_PX, VIEW_PX) share covered by bodies


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Samples:
    """All samples of a training run: each depends on the layers, the seed and its number alone."""

    bodies: Sequence[BodyLayer]
    walls: Sequence[WallLayer]
    seed: int
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, number: int) -> TrainingSample:
        if not 0 <= number < self.count:
            raise IndexError(number)
        return compose(self.bodies, self.walls, np.random.default_rng([self.seed, 2, number]))


def compose(
    bodies: Sequence[BodyLayer], walls: Sequence[WallLayer], rng: np.random.Generator
) -> TrainingSample:
    """Compose one sample of randomly chosen layers."""
    wall = _cut(rng)(_chosen(walls, rng).grey) * np.float32(rng.uniform(0.9, 1.1))
    first = _chosen(bodies, rng)
    light, coverage = np.zeros((2, VIEW_PX, VIEW_PX), np.float32)
    for body_light, body_coverage in _bodies_in_view(first, bodies, rng):
        light = body_light + (1 - body_coverage) * light
        coverage = body_coverage + (1 - body_coverage) * coverage
    if rng.random() < PATCHES_SHARE:
        light = light * _patches(rng)
    if rng.random() < MOTION_SHARE:
        smear = _motion(rng.uniform(1, LONGEST_MOTION_PX) / first.scale)
        light, coverage = smear(light), smear(coverage)
    if rng.random() < BLUR_SHARE:
        sigma = rng.uniform(1, WIDEST_BLUR_PX) / first.scale
        light, coverage, wall = (
            np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE), np.float32)
            for image in (light, coverage, wall)
        )
    if rng.random() < VIGNETTING_SHARE:
        vignetting = _vignetting(rng)
        light, wall = light * vignetting, wall * vignetting
    glare_share = rng.uniform(0, MOST_GLARE) if rng.random() < GLARE_SHARE else 0.0
    lens = ThinLens(f_number=2.0, glare_share=glare_share, glare_px=rng.uniform(20, 120) / first.scale)

    known = wall
    wall_light, bodies_light, transmission, veil = _disturbances(rng)
    spoilt = wall * wall_light
    if rng.random() > CLEAN_BACKGROUND_SHARE:  # the background has learnt what stays
        known = spoilt * transmission + veil
    flash = rng.uniform(0.3, 1.15) if rng.random() < DIM_SHARE else rng.uniform(0.97, 1.03)
    image = flash * lens.with_glare(light * bodies_light + (1 - coverage) * spoilt) * transmission + veil
    image = _exposed(image, first.scale, rng)
    return TrainingSample(_relative(image, lens.with_glare(known), rng), np.clip(coverage, 0, 1))


def _bodies_in_view(
    first: BodyLayer, bodies: Sequence[BodyLayer], rng: np.random.Generator
) -> list[tuple[FloatImage, FloatImage]]:
    """Return light (times coverage) and coverage of each body, the farthest first."""
    n_bodies = int(rng.choice(len(N_BODIES), p=N_BODIES))
    found = []
    for index in range(n_bodies):
        layer = first if index == 0 else _chosen(bodies, rng)
        factor = _random_light_factor(layer, rng)
        found.append(_placed(layer, rng, factor, shrink=1.0 if index == 0 else rng.uniform(0.3, 1.0)))
    if rng.random() < FRAGMENTS_SHARE:
        layer = _chosen(bodies, rng)
        factor = _random_light_factor(layer, rng)
        sizes = rng.uniform(0.06, 0.3, size=int(rng.integers(1, MAX_FRAGMENTS + 1)))
        found.extend(_placed(layer, rng, factor, shrink=size) for size in sizes)
    return found


def _random_light_factor(layer: BodyLayer, rng: np.random.Generator) -> float:
    """Return a random factor on a body's light: as rendered, dark as an aperture, or bright as the wall."""
    covered = float(layer.coverage.sum(dtype=np.int64)) / 255
    mean = max(float(layer.light.sum(dtype=np.int64)) / max(covered, 1.0), 1.0)
    kind = rng.random()
    if kind < 0.45:
        return float(rng.uniform(35, 90)) / mean
    if kind < 0.7:
        return float(rng.uniform(6, 40)) / mean
    return float(rng.uniform(90, 240)) / mean


def _placed(
    layer: BodyLayer, rng: np.random.Generator, factor: float, shrink: float
) -> tuple[FloatImage, FloatImage]:
    """Return light and coverage in the view, rotated and shifted at random, scaled by `shrink`."""
    cut = _cut(rng)
    size = max(8, round(shrink * CANVAS_PX))
    top, left = rng.integers(0, CANVAS_PX - size + 1, size=2)
    found = []
    for values, unit in ((layer.light, factor), (layer.coverage, 1 / 255)):
        canvas = values
        if size < CANVAS_PX:
            canvas = np.zeros_like(values)
            canvas[top : top + size, left : left + size] = cv2.resize(
                values, (size, size), interpolation=cv2.INTER_AREA
            )
        found.append(cut(canvas) * np.float32(unit))
    return found[0], found[1]


def _patches(rng: np.random.Generator) -> FloatImage:
    """Return a factor on the light of bodies with a texture of patches."""
    n_patches = int(rng.integers(N_PATCHES[0], N_PATCHES[1] + 1))
    noise = rng.standard_normal((n_patches, n_patches), dtype=np.float32)
    coarse = np.clip(1 + np.float32(rng.uniform(*PATCHES_CONTRAST)) * noise, 0.4, 1.7)
    return np.asarray(cv2.resize(coarse, (VIEW_PX, VIEW_PX), interpolation=cv2.INTER_LINEAR))


def _disturbances(
    rng: np.random.Generator,
) -> tuple[FloatImage | float, FloatImage | float, FloatImage | float, FloatImage | float]:
    """Return random factors on the light of wall and bodies, transmission and veil."""
    size = (VIEW_PX, VIEW_PX)
    wall_light: FloatImage | float = 1.0
    body_light: FloatImage | float = 1.0
    transmission: FloatImage | float = 1.0
    veil: FloatImage | float = 0.0
    if rng.random() < DUST_SHARE:
        dusty = dust(float(rng.uniform(0.05, 0.9)), rng, size)
        transmission, veil = dusty.transmission, dusty.veil
    if rng.random() < SLOPE_SHARE:
        wall_light, body_light = _slope(rng), _slope(rng)
    if rng.random() < SHADOW_SHARE:
        wall_light = wall_light * cast_shadow(float(rng.uniform(0.1, 0.7)), rng, size).wall_light
    return wall_light, body_light, transmission, veil


def _slope(rng: np.random.Generator) -> FloatImage:
    """Return light that falls off across the view: gently, or as beside a failed panel."""
    v, u = np.mgrid[-1:1:32j, -1:1:32j]
    angle = rng.uniform(0, 2 * np.pi)
    along = u * np.cos(angle) + v * np.sin(angle) - rng.uniform(-1, 1)
    coarse = 1 - rng.uniform(0.1, 0.8) / (1 + np.exp(-along * rng.uniform(0.5, 4)))
    return np.asarray(cv2.resize(coarse.astype(np.float32), (VIEW_PX, VIEW_PX)))


def _vignetting(rng: np.random.Generator) -> FloatImage:
    """Return the share of the light that a lens leaves around its axis, which is anywhere in the view."""
    v, u = np.mgrid[-1:1:32j, -1:1:32j]
    center_u, center_v = rng.uniform(-1, 1, size=2)
    squared = (u - center_u) ** 2 + (v - center_v) ** 2
    coarse = 1 / (1 + rng.uniform(0, MOST_VIGNETTING) * squared)
    return np.asarray(cv2.resize(coarse.astype(np.float32), (VIEW_PX, VIEW_PX)))


def _motion(length_px: float) -> Callable[[FloatImage], FloatImage]:
    """Return a vertical motion blur of `length_px` on the canvas; views are rotated at random."""
    count = max(3, 2 * int(np.ceil(length_px / 2)) + 1)
    middle = count // 2
    weights = np.clip(length_px / 2 + 0.5 - np.abs(np.arange(count) - middle), 0, 1)
    kernel = (weights / weights.sum()).astype(np.float32)[:, None]

    def smear(image: FloatImage) -> FloatImage:
        return np.asarray(cv2.filter2D(image, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE))

    return smear


def _exposed(image: FloatImage, scale: float, rng: np.random.Generator) -> FloatImage:
    """Return the image with the noise that remains after averaging over `scale` squared pixels."""
    design = ExposureParameters()
    read_noise = np.exp(rng.uniform(*np.log(STRONG_NOISE))) if rng.random() < 0.4 else design.read_noise
    sigma = np.sqrt(
        design.shot_noise * np.maximum(image, 0) + np.float32(read_noise**2 + 1 / 12)
    ) / np.float32(scale)
    noise = rng.standard_normal(image.shape, dtype=np.float32)
    return np.asarray(np.clip(image + sigma * noise, 0, BRIGHTEST))


def _relative(image: FloatImage, known: FloatImage, rng: np.random.Generator) -> Singles:
    """Return both channels, image and expected wall, as shares of the plain wall's grey level in this image."""
    view = np.zeros((2, VIEW_PX, VIEW_PX), np.float32)
    if rng.random() < NO_BACKGROUND_SHARE:
        # a bright quantile stands for the wall
        wall = max(float(np.quantile(image[::8, ::8], rng.uniform(0.6, 0.95))), 0.05 * WALL_GREY)
        view[0] = image / np.float32(wall * rng.uniform(0.9, 1.1))
    else:
        gain = flash_gain(image, known) * rng.uniform(0.97, 1.03)
        wall = gain * float(np.quantile(known[::8, ::8], 0.8)) * rng.uniform(0.9, 1.1)
        wall = max(wall, 0.05 * WALL_GREY)
        view[0] = image / np.float32(wall)
        view[1] = known * np.float32(gain / wall)
    return np.clip(view, 0, MAX_RELATIVE)


def _chosen(layers: Sequence[T], rng: np.random.Generator) -> T:
    return layers[int(rng.integers(len(layers)))]


def _cut(rng: np.random.Generator) -> Callable[[GreyImage], FloatImage]:
    """Return a function that crops the view from a canvas, at a random place and in one of a square's symmetries."""
    top, left = rng.integers(0, CANVAS_PX - VIEW_PX + 1, size=2)
    n_turns, is_mirrored = int(rng.integers(4)), rng.random() < 0.5

    def cut(canvas: GreyImage) -> FloatImage:
        region = np.rot90(canvas[top : top + VIEW_PX, left : left + VIEW_PX], n_turns)
        return np.ascontiguousarray(region[:, ::-1] if is_mirrored else region, dtype=np.float32)

    return cut
