"""Training samples: bodies before walls, spoilt in every way that segmentation should survive, with the truth.

A sample costs some milliseconds, so that no two of a training run are equal. Everything is random from the
generator that is passed in.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.segmentation.light import flash_gain
from pipeline.segmentation.network import MAX_RELATIVE
from pipeline.synthesis.background import WALL_GREY
from pipeline.synthesis.disturbance import cast_shadow, dust
from pipeline.synthesis.exposure import ExposureParameters
from pipeline.training.image_layers import CANVAS_PX, VIEW_PX, BodyLayer, WallLayer

Array = NDArray[np.float32]
T = TypeVar("T")

N_BODIES = (0.08, 0.72, 0.12, 0.08)
"""How often a view shows none, one, two or three bodies."""
FRAGMENTS_SHARE, MAX_FRAGMENTS = 0.12, 5
DUST_SHARE, SHADOW_SHARE, SLOPE_SHARE, DIM_SHARE = 0.2, 0.2, 0.3, 0.5
MOTION_SHARE, LONGEST_MOTION_PX = 0.2, 6.0
NO_BACKGROUND_SHARE = 0.3
BEFORE_TROUBLE_SHARE = 0.6
"""Of the known backgrounds: learnt before dust, shadow and slope; the others show them, too."""
STRONG_NOISE = (1.0, 4.5)
"""Read noise in grey levels, in two of five samples; the others have the design's."""
BRIGHTEST = 255.0


class Sample(NamedTuple):
    """What the network sees, and what it should say."""

    view: Array  # (2, VIEW_PX, VIEW_PX) image and expected wall, relative to the plain wall, 0..2
    coverage: Array  # (VIEW_PX, VIEW_PX) share covered by bodies


def compose(bodies: Sequence[BodyLayer], walls: Sequence[WallLayer], rng: np.random.Generator) -> Sample:
    """One sample made of randomly chosen layers."""
    wall = _cut(rng)(_chosen(walls, rng).grey) * np.float32(rng.uniform(0.9, 1.1))
    first = _chosen(bodies, rng)
    light, coverage = np.zeros((2, VIEW_PX, VIEW_PX), np.float32)
    for body_light, body_coverage in _bodies_in_view(first, bodies, rng):
        light = body_light + (1 - body_coverage) * light
        coverage = body_coverage + (1 - body_coverage) * coverage
    if rng.random() < MOTION_SHARE:
        smear = _motion(rng.uniform(1, LONGEST_MOTION_PX) / first.scale)
        light, coverage = smear(light), smear(coverage)

    known = wall
    wall_light, bodies_light, transmission, veil = _trouble(rng)
    spoilt = wall * wall_light
    if rng.random() > BEFORE_TROUBLE_SHARE:  # the background has learnt what stays
        known = spoilt * transmission + veil
    flash = rng.uniform(0.3, 1.15) if rng.random() < DIM_SHARE else rng.uniform(0.97, 1.03)
    image = flash * (light * bodies_light + (1 - coverage) * spoilt) * transmission + veil
    image = _exposed(image, first.scale, rng)
    return Sample(_relative(image, known, rng), np.clip(coverage, 0, 1))


def _bodies_in_view(
    first: BodyLayer, bodies: Sequence[BodyLayer], rng: np.random.Generator
) -> list[tuple[Array, Array]]:
    """Light (times coverage) and coverage of each body, the farthest first."""
    n_bodies = int(rng.choice(len(N_BODIES), p=N_BODIES))
    found = []
    for index in range(n_bodies):
        layer = first if index == 0 else _chosen(bodies, rng)
        factor = _look(layer, rng)
        found.append(_placed(layer, rng, factor, shrink=1.0 if index == 0 else rng.uniform(0.3, 1.0)))
    if rng.random() < FRAGMENTS_SHARE:
        layer = _chosen(bodies, rng)
        factor = _look(layer, rng)
        sizes = rng.uniform(0.06, 0.3, size=int(rng.integers(1, MAX_FRAGMENTS + 1)))
        found.extend(_placed(layer, rng, factor, shrink=size) for size in sizes)
    return found


def _look(layer: BodyLayer, rng: np.random.Generator) -> float:
    """Factor on a body's light: as rendered, dark as an aperture, or as bright as the wall."""
    covered = float(layer.coverage.sum(dtype=np.int64)) / 255
    mean = max(float(layer.light.sum(dtype=np.int64)) / max(covered, 1.0), 1.0)
    kind = rng.random()
    if kind < 0.45:
        return float(rng.uniform(35, 90)) / mean
    if kind < 0.7:
        return float(rng.uniform(6, 40)) / mean
    return float(rng.uniform(90, 240)) / mean


def _placed(layer: BodyLayer, rng: np.random.Generator, factor: float, shrink: float) -> tuple[Array, Array]:
    """Light and coverage in the view, turned and shifted, made smaller by `shrink`."""
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


def _trouble(rng: np.random.Generator) -> tuple[Array | float, Array | float, Array | float, Array | float]:
    """Factors on the light of wall and bodies, transmission and veil."""
    size = (VIEW_PX, VIEW_PX)
    wall_light: Array | float = 1.0
    body_light: Array | float = 1.0
    transmission: Array | float = 1.0
    veil: Array | float = 0.0
    if rng.random() < DUST_SHARE:
        dusty = dust(float(rng.uniform(0.05, 0.9)), rng, size)
        transmission, veil = dusty.transmission, dusty.veil
    if rng.random() < SLOPE_SHARE:
        wall_light, body_light = _slope(rng), _slope(rng)
    if rng.random() < SHADOW_SHARE:
        wall_light = wall_light * cast_shadow(float(rng.uniform(0.1, 0.7)), rng, size).wall_light
    return wall_light, body_light, transmission, veil


def _slope(rng: np.random.Generator) -> Array:
    """Light that falls off across the view: beside a panel that is out, or gently."""
    v, u = np.mgrid[-1:1:32j, -1:1:32j]
    angle = rng.uniform(0, 2 * np.pi)
    along = u * np.cos(angle) + v * np.sin(angle) - rng.uniform(-1, 1)
    coarse = 1 - rng.uniform(0.1, 0.8) / (1 + np.exp(-along * rng.uniform(0.5, 4)))
    return np.asarray(cv2.resize(coarse.astype(np.float32), (VIEW_PX, VIEW_PX)))


def _motion(length_px: float) -> Callable[[Array], Array]:
    """Smear by a fall of `length_px` on the canvas, up and down or across (views are turned at random)."""
    count = max(3, 2 * int(np.ceil(length_px / 2)) + 1)
    middle = count // 2
    weights = np.clip(length_px / 2 + 0.5 - np.abs(np.arange(count) - middle), 0, 1)
    kernel = (weights / weights.sum()).astype(np.float32)[:, None]

    def smear(image: Array) -> Array:
        return np.asarray(cv2.filter2D(image, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE))

    return smear


def _exposed(image: Array, scale: float, rng: np.random.Generator) -> Array:
    """With the noise that averaging over `scale` squared pixels leaves."""
    design = ExposureParameters()
    read_noise = rng.uniform(*STRONG_NOISE) if rng.random() < 0.4 else design.read_noise
    sigma = np.sqrt(
        design.shot_noise * np.maximum(image, 0) + np.float32(read_noise**2 + 1 / 12)
    ) / np.float32(scale)
    noise = rng.standard_normal(image.shape, dtype=np.float32)
    return np.asarray(np.clip(image + sigma * noise, 0, BRIGHTEST))


def _relative(image: Array, known: Array, rng: np.random.Generator) -> Array:
    """Both channels: image and expected wall, as a share of the plain wall's grey level in this image."""
    view = np.zeros((2, VIEW_PX, VIEW_PX), np.float32)
    if rng.random() < NO_BACKGROUND_SHARE:
        # a bright quantile is the wall, or what is taken for it
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


def _cut(rng: np.random.Generator) -> Callable[[NDArray[np.uint8]], Array]:
    """What takes the view out of a canvas: a region of it, in one of the eight ways a square lies."""
    top, left = rng.integers(0, CANVAS_PX - VIEW_PX + 1, size=2)
    n_turns, is_mirrored = int(rng.integers(4)), rng.random() < 0.5

    def cut(canvas: NDArray[np.uint8]) -> Array:
        region = np.rot90(canvas[top : top + VIEW_PX, left : left + VIEW_PX], n_turns)
        return np.ascontiguousarray(region[:, ::-1] if is_mirrored else region, dtype=np.float32)

    return cut
