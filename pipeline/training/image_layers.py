"""The image layers that training views are composed of: bodies without a wall and walls without a body, rendered once.

Each lies on a square canvas somewhat larger than the region that a network will see, already reduced to the
network's scale by area averaging, so that thousands of them fit into memory. What is rendered for a number depends
on the seed and that number alone, so that any number of processes can share the work.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from pipeline.arrays import Directions, FloatImage, GreyImage
from pipeline.rig.design import as_built, nominal_rig
from pipeline.synthesis.background import (
    APERTURE_RADIUS_MM,
    DOT_RADIUS_MM,
    HOLE_RADIUS_MM,
    EmptyView,
    Wall,
    build_wall,
    render_backgrounds,
    wall_directions,
)
from pipeline.synthesis.bodies import Body, cube, cylinder, sphere
from pipeline.synthesis.exposure import LENS_PRESETS, LensPreset
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.renderer import Layer, RenderedRig, illuminate, view_of
from pipeline.synthesis.stones import STONE_FORMS, random_size_mm, stone

VIEW_PX = 256
"""Edge of what the network sees."""
CANVAS_PX = 320
"""Edge of a canvas: the region lies anywhere within it."""
CANVAS_SHARE = CANVAS_PX / VIEW_PX
MARGIN_SHARE = (0.05, 0.5)
"""Range of a region's margin around its body on each side, as a share of the body's extent."""
WHOLE_FRAME_SHARE = 0.12
"""Share of layers that show a whole image."""
VIEWS_PER_BODY, CROPS_PER_WALL = 8, 4
LENS_SHARES = {LensPreset.SHARP: 0.4, LensPreset.F8: 0.15, LensPreset.F4: 0.15, LensPreset.F2: 0.3}
"""Probabilities of the lenses that bodies and walls are photographed through."""
SOLID_SHARE = 0.15
"""Share of bodies that are spheres, cylinders and cubes, not stones."""
TEXTURED_SHARE, STRONG_CONTRAST = 0.35, (0.25, 0.4)
"""Share of bodies with a strong texture, and its relative sd: of a bright one, patches are as bright as the wall."""
MAX_FURTHER_DISCS = 3
"""Most apertures, holes and screws put into a field of view: the design keeps the large ones out."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BodyLayer:
    """A body on a canvas."""

    coverage: GreyImage  # (CANVAS_PX, CANVAS_PX), 255 where it covers all
    light: GreyImage  # (CANVAS_PX, CANVAS_PX) grey levels, times the coverage
    scale: float  # camera pixels along a pixel of the canvas


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WallLayer:
    """A piece of wall on a canvas."""

    grey: GreyImage  # (CANVAS_PX, CANVAS_PX)
    scale: float


def render_body(seed: int, number: int) -> list[BodyLayer]:
    """Return at most `VIEWS_PER_BODY` views of a random body: it may be out of view in some of them."""
    rng = np.random.default_rng([seed, 0, number])
    rig = as_built(nominal_rig(), int(rng.integers(2**31)))
    parameters = LENS_PRESETS[_random_lens(rng)]
    surface = illuminate(tumble(_random_body(rng), rig, rng), rng)
    layers = []
    for chosen in rng.choice(len(rig.cameras), VIEWS_PER_BODY, replace=False):
        camera = rig.cameras[int(chosen)]
        width, height = camera.image_size_px
        dark = EmptyView(radiance=np.zeros((height, width), np.float32), gain=1.0)
        alone = RenderedRig(rig=rig.subset([camera.id]), backgrounds={camera.id: dark}, parameters=parameters)
        seen = view_of([surface], camera, alone).layers
        layers += [_on_canvas(layer, camera.image_size_px, rng) for layer in seen]
    return layers


def render_wall(seed: int, number: int) -> list[WallLayer]:
    """Return `CROPS_PER_WALL` crops of the wall of a random housing."""
    rng = np.random.default_rng([seed, 1, number])
    rig = as_built(nominal_rig(), int(rng.integers(2**31)))
    camera = rig.cameras[int(rng.integers(len(rig.cameras)))]
    wall = build_wall(rig, rng)
    n_discs = int(rng.integers(MAX_FURTHER_DISCS + 1))
    discs_uv = rng.uniform(0, 1, size=(n_discs, 2)) * camera.image_size_px
    wall = _with_discs(wall, wall_directions(camera, discs_uv, wall.radius_mm), rng)
    lens = LENS_PRESETS[_random_lens(rng)].lens
    grey = render_backgrounds(rig.subset([camera.id]), wall, rng, lens)[camera.id].radiance
    crops = []
    for _ in range(CROPS_PER_WALL):
        if rng.random() < WHOLE_FRAME_SHARE:
            side_px, center_uv = 1280.0, np.array([640.0, 512.0])
        else:
            side_px = float(np.exp(rng.uniform(np.log(VIEW_PX), np.log(1200))))
            # beside an aperture, if there is one
            near = discs_uv[rng.integers(n_discs)] if n_discs and rng.random() < 0.7 else [640, 512]
            center_uv = np.clip(near + rng.normal(0, 0.25 * side_px, size=2), 200, [1080, 824])
        canvas_px = round(CANVAS_SHARE * side_px)
        left, top = (center_uv - canvas_px / 2).astype(int)
        rows = np.clip(np.arange(top, top + canvas_px), 0, grey.shape[0] - 1)
        columns = np.clip(np.arange(left, left + canvas_px), 0, grey.shape[1] - 1)
        crops.append(WallLayer(grey=_reduced(grey[rows][:, columns]), scale=canvas_px / CANVAS_PX))
    return crops


def _random_lens(rng: np.random.Generator) -> LensPreset:
    return list(LENS_SHARES)[int(rng.choice(len(LENS_SHARES), p=list(LENS_SHARES.values())))]


def _random_body(rng: np.random.Generator) -> Body:
    """Return a random stone or solid, dry or wet, of weak or strong texture."""
    size_mm = random_size_mm(rng)
    if rng.random() < SOLID_SHARE:
        edge_mm = size_mm / np.sqrt(3)  # of a cube of this greatest diameter
        solids = (sphere(size_mm), cylinder(edge_mm, edge_mm), cube(edge_mm))
        body = solids[int(rng.integers(len(solids)))]
    else:
        body = stone(str(rng.choice(list(STONE_FORMS))), size_mm, rng)
    gloss = rng.uniform(0.3, 1.0) if rng.random() < 0.35 else 0.0
    contrast = rng.uniform(*STRONG_CONTRAST) if rng.random() < TEXTURED_SHARE else body.contrast
    return replace(body, grey=rng.uniform(50, 130), contrast=contrast, gloss=gloss)


def _on_canvas(layer: Layer, image_size_px: tuple[int, int], rng: np.random.Generator) -> BodyLayer:
    height, width = layer.coverage.shape
    if rng.random() < WHOLE_FRAME_SHARE:
        side_px = float(max(image_size_px))
        center_uv = np.array(image_size_px) / 2
    else:
        side_px = max(float(VIEW_PX), max(height, width) * (1 + 2 * rng.uniform(*MARGIN_SHARE)))
        center_uv = np.array([layer.columns.start + width / 2, layer.rows.start + height / 2])
    canvas_px = round(CANVAS_SHARE * side_px)
    left, top = np.rint([layer.columns.start, layer.rows.start] - center_uv + canvas_px / 2).astype(int)
    coverage, light = (np.zeros((canvas_px, canvas_px), np.float32) for _ in range(2))
    place = slice(top, top + height), slice(left, left + width)
    coverage[place] = layer.coverage
    light[place] = layer.coverage * layer.radiance
    return BodyLayer(coverage=_reduced(255 * coverage), light=_reduced(light), scale=canvas_px / CANVAS_PX)


def _with_discs(wall: Wall, directions: Directions, rng: np.random.Generator) -> Wall:
    """Return the wall with apertures, holes or screws in these directions (N, 3)."""
    count = len(directions)
    radii_mm = rng.choice([*[APERTURE_RADIUS_MM] * 5, HOLE_RADIUS_MM, *DOT_RADIUS_MM], count)
    return replace(
        wall,
        disc_directions=np.concatenate([wall.disc_directions, directions]),
        disc_radii_mm=np.concatenate([wall.disc_radii_mm, radii_mm]),
        disc_reflectances=np.concatenate([wall.disc_reflectances, rng.uniform(0.03, 0.3, count)]),
    )


def _reduced(canvas: FloatImage) -> GreyImage:
    """Return a square canvas reduced to the network's scale."""
    small = cv2.resize(canvas, (CANVAS_PX, CANVAS_PX), interpolation=cv2.INTER_AREA)
    return np.clip(np.rint(small), 0, 255).astype(np.uint8)
