"""Views that are hard to segment, with the truth beside them: one camera of a rig with deviations.

Everything is random from the seed: rig, camera, housing, stone, pose and the strength of the disturbance, within the
ranges below. The background is what the camera saw of the empty rig before the disturbance began.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from pipeline.arrays import FloatImage, GreyImage, Vector
from pipeline.frames import CameraId, Frame
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.background import BackgroundModel, learn_background
from pipeline.synthesis.background import APERTURE_RADIUS_MM, build_wall, render_backgrounds, wall_directions
from pipeline.synthesis.disturbance import (
    UNDISTURBED,
    Disturbance,
    cast_shadow,
    dimmed_sector,
    dust,
    flicker,
)
from pipeline.synthesis.exposure import LENS_PRESETS, ExposureParameters, LensPreset, expose
from pipeline.synthesis.placement import drop_across, tumble
from pipeline.synthesis.renderer import PlacedBody, RenderedRig, View, illuminate, view_of
from pipeline.synthesis.stones import STONE_FORMS, random_size_mm, stone

DARK_GREY = (12.0, 60.0)  # of the stone across an aperture; the aperture itself is at about 16
BRIGHT_GREY = (130.0, 230.0)
WET_GREY, WET_GLOSS = (40.0, 110.0), (0.5, 1.0)
DUST_STRENGTH = (0.15, 0.8)
DIMMED_STRENGTH = (0.3, 0.9)
FLICKER_FACTOR = (0.4, 1.2)
SHADOW_STRENGTH = (0.15, 0.6)
LONG_EXPOSURE_US = (40.0, 100.0)  # the longest: 5 px
STRONG_NOISE = (2.0, 4.0)
DEFOCUS_BLUR_PX = (3.0, 4.0)
STRONGEST_NOISE = 10.0
TEXTURED_GREY, TEXTURE_CONTRAST = (90.0, 180.0), (0.3, 0.4)
LONGEST_EXPOSURE_US = 185.0  # 9 px, across a horizontal view
N_BODIES = (2, 3)
N_FRAGMENTS = (2, 6)
FRAGMENT_MM = (1.0, 4.0)
VISIBLE_SHARE = 1e-3
"""Least coverage that counts; below is rounding."""
NEIGHBOUR_SPREAD_MM = (18.0, 18.0, 14.0)
"""Greatest offset of further bodies from the centre along each axis."""
N_EMPTY = 3
"""Exposures of the empty rig that the background is learnt from."""


class HardCase(StrEnum):
    """What makes a view hard to segment."""

    CLEAN = "clean"
    APERTURE = "aperture"
    """A dark stone whose edge runs across a camera's dark aperture in the far wall."""
    BRIGHT = "bright"
    WET = "wet"
    DUST = "dust"
    DIMMED = "dimmed"
    """A panel of the dome gives less light; it is in sight, or behind the camera."""
    FLICKER = "flicker"
    SHADOW = "shadow"
    MOTION = "motion"
    NOISE = "noise"
    SEVERAL = "several"
    FRAGMENTS = "fragments"
    F2 = "f2"
    """Through a lens wide open: edges out of focus by their depth, less light in the corners, glare."""
    DEFOCUS = "defocus"
    """The whole body is out of focus alike."""
    NOISE_10 = "noise 10"
    BRIGHT_TEXTURE = "bright texture"
    """Patches of the body are as bright as the wall."""
    MOTION_9 = "motion 9"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HardView:
    """A frame, the background known for it, and the truth."""

    case: HardCase
    frame: Frame
    background: BackgroundModel  # of this camera; empty if none is known
    coverage: FloatImage
    """(H, W) share of the pixel covered by bodies in focus, in the middle of the exposure."""
    contrast: FloatImage
    """|body - background| in grey levels, in focus, without noise; 0 far from any body. No edge is seen where it is
    low."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Scene:
    """One camera in a housing, and the bodies that fall past it."""

    rig: RigCalibration
    simulated: RenderedRig  # of that camera alone
    bodies: list[PlacedBody]
    disturbance: Disturbance = field(default=UNDISTURBED)

    @property
    def camera(self) -> CameraCalibration:
        return self.simulated.rig.cameras[0]


def hard_view(
    case: HardCase,
    seed: int,
    *,
    with_background: bool = True,
    size_mm: float | None = None,
    exposure: ExposureParameters | None = None,
) -> HardView:
    """Return view number `seed` of a case; `size_mm` is the stone's greatest diameter, else random."""
    rng = np.random.default_rng([seed, list(HardCase).index(case)])
    rig = as_built(nominal_rig(), int(rng.integers(2**31)))
    camera = rig.cameras[int(rng.integers(len(rig.cameras)))]
    form = str(rng.choice(list(STONE_FORMS)))
    drawn_mm = random_size_mm(rng)
    body = stone(form, drawn_mm if size_mm is None else size_mm, rng)
    alone = rig.subset([camera.id])
    placed = tumble(body, alone, rng)
    exposure = exposure or LENS_PRESETS[LensPreset.F2 if case is HardCase.F2 else LensPreset.SHARP]
    simulated = _simulate(rig, camera, _aperture_at_edge(placed, rig, camera, rng, case), rng, exposure)
    scene = SPOIL[case](_Scene(rig=rig, simulated=simulated, bodies=[placed]), rng)

    background: BackgroundModel = {}
    for _ in range(N_EMPTY if with_background else 0):
        empty = expose(view_of([], camera, simulated).radiance(), simulated.parameters, rng)
        background = learn_background(background, {camera.id: _frame(camera.id, empty)})
    surfaces = [illuminate(placed, rng) for placed in scene.bodies]
    view = view_of(surfaces, camera, scene.simulated, scene.disturbance)
    flash = 1 + simulated.parameters.flash_sd * float(np.clip(rng.normal(), -3, 3))
    image = expose(view.radiance(flash), view.parameters, rng)
    in_focus = replace(scene.simulated, parameters=ExposureParameters())
    at_once = replace(scene.disturbance, exposure_us=0.0)
    seen = view_of(surfaces, camera, in_focus, at_once)
    coverage, contrast = truth_of_view(replace(seen, vignetting=view.vignetting))
    return HardView(
        case=case,
        frame=_frame(camera.id, image),
        background=background,
        coverage=coverage,
        contrast=contrast,
    )


def truth_of_view(view: View) -> tuple[FloatImage, FloatImage]:
    """Return the share (H, W) covered by any body, and the contrast (H, W) of the nearest body to its background."""
    free = np.ones_like(view.wall)
    contrast = np.zeros_like(view.wall)
    background_grey = view.wall.copy()
    for layer in view.layers:
        window = layer.rows, layer.columns
        is_visible = layer.coverage > VISIBLE_SHARE
        contrast[window] = np.where(
            is_visible, np.abs(layer.radiance - background_grey[window]), contrast[window]
        )
        background_grey[window] += layer.coverage * (layer.radiance - background_grey[window])
        free[window] *= 1 - layer.coverage
    light = view.vignetting * view.disturbance.transmission
    return 1 - free, np.asarray(contrast * light, dtype=np.float32)


def _simulate(
    rig: RigCalibration,
    camera: CameraCalibration,
    aperture_direction: Vector | None,
    rng: np.random.Generator,
    exposure: ExposureParameters,
) -> RenderedRig:
    """Return the camera in a random housing of the whole rig, with one more aperture if a direction is given."""
    wall = build_wall(rig, rng)
    if aperture_direction is not None:
        wall = replace(
            wall,
            disc_directions=np.concatenate([wall.disc_directions, aperture_direction[None]]),
            disc_radii_mm=np.append(wall.disc_radii_mm, APERTURE_RADIUS_MM),
            disc_reflectances=np.append(wall.disc_reflectances, 0.08),
        )
    alone = rig.subset([camera.id])
    backgrounds = render_backgrounds(alone, wall, rng, exposure.lens)
    return RenderedRig(rig=alone, backgrounds=backgrounds, parameters=exposure)


def _aperture_at_edge(
    placed: PlacedBody,
    rig: RigCalibration,
    camera: CameraCalibration,
    rng: np.random.Generator,
    case: HardCase,
) -> Vector | None:
    """Return the direction in which an aperture lies behind the body's edge, `None` in cases without one."""
    if case is not HardCase.APERTURE:
        return None
    vertices_mm = placed.body.mesh.vertices @ placed.R.T + placed.offset_mm
    pixels_uv, _ = camera.project(vertices_mm)
    # the outermost vertex some way around
    angle = rng.uniform(0, 2 * np.pi)
    edge_uv = pixels_uv[np.argmax(pixels_uv @ [np.cos(angle), np.sin(angle)])]
    radius_mm = float(np.linalg.norm([other.center_mm for other in rig.cameras], axis=1).mean())
    return wall_directions(camera, edge_uv[None], radius_mm)[0]


def _frame(camera: CameraId, image: GreyImage) -> Frame:
    return Frame(camera=camera, image=image, frame_id=1, device_ns=0, received_ns=0)


def _with_appearance(scene: _Scene, grey: float, contrast: float | None = None, gloss: float = 0.0) -> _Scene:
    """Return the scene with another appearance of the first body."""
    first, *others = scene.bodies
    kept = first.body.contrast if contrast is None else contrast
    body = replace(first.body, grey=grey, contrast=kept, gloss=gloss)
    return replace(scene, bodies=[replace(first, body=body), *others])


def _spoil_aperture(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return _with_appearance(scene, rng.uniform(*DARK_GREY))


def _spoil_bright(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return _with_appearance(scene, rng.uniform(*BRIGHT_GREY), contrast=rng.uniform(0.05, 0.25))


def _spoil_wet(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return _with_appearance(scene, rng.uniform(*WET_GREY), gloss=rng.uniform(*WET_GLOSS))


def _spoil_dust(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return replace(scene, disturbance=dust(rng.uniform(*DUST_STRENGTH), rng, scene.camera.image_size_px))


def _spoil_dimmed(scene: _Scene, rng: np.random.Generator) -> _Scene:
    axis = scene.camera.center_mm / np.linalg.norm(scene.camera.center_mm)
    side = 1 if rng.random() < 0.3 else -1  # -1: in sight
    direction = side * axis + rng.normal(0, 0.45, size=3)
    strength = rng.uniform(*DIMMED_STRENGTH)
    return replace(scene, disturbance=dimmed_sector(scene.rig, scene.camera, strength, direction))


def _spoil_flicker(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return replace(scene, disturbance=flicker(rng.uniform(*FLICKER_FACTOR)))


def _spoil_shadow(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return replace(
        scene,
        disturbance=cast_shadow(rng.uniform(*SHADOW_STRENGTH), rng, scene.camera.image_size_px),
    )


def _spoil_motion(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return replace(scene, disturbance=Disturbance(exposure_us=rng.uniform(*LONG_EXPOSURE_US)))


def _spoil_noise(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return replace(scene, disturbance=Disturbance(read_noise=rng.uniform(*STRONG_NOISE)))


def _spoil_defocus(scene: _Scene, rng: np.random.Generator) -> _Scene:
    blurred = replace(scene.simulated.parameters, blur_px=rng.uniform(*DEFOCUS_BLUR_PX))
    return replace(scene, simulated=replace(scene.simulated, parameters=blurred))


def _spoil_noise_10(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return replace(scene, disturbance=Disturbance(read_noise=STRONGEST_NOISE))


def _spoil_bright_texture(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return _with_appearance(scene, rng.uniform(*TEXTURED_GREY), contrast=rng.uniform(*TEXTURE_CONTRAST))


def _spoil_motion_9(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return replace(scene, disturbance=Disturbance(exposure_us=LONGEST_EXPOSURE_US))


def _spoil_several(scene: _Scene, rng: np.random.Generator) -> _Scene:
    n_more = int(rng.integers(N_BODIES[0] - 1, N_BODIES[1]))
    return _with_stones(scene, [float(rng.uniform(5, 15)) for _ in range(n_more)], rng)


def _spoil_fragments(scene: _Scene, rng: np.random.Generator) -> _Scene:
    n_more = int(rng.integers(N_FRAGMENTS[0], N_FRAGMENTS[1] + 1))
    return _with_stones(scene, [float(rng.uniform(*FRAGMENT_MM)) for _ in range(n_more)], rng)


def _with_stones(scene: _Scene, sizes_mm: list[float], rng: np.random.Generator) -> _Scene:
    """Return the scene with further stones of these sizes, as far from the others as the best of a few draws."""
    bodies = list(scene.bodies)
    for size_mm in sizes_mm:
        body = stone(str(rng.choice(list(STONE_FORMS))), size_mm, rng)
        candidates = [drop_across(body, scene.simulated.rig, rng, NEIGHBOUR_SPREAD_MM) for _ in range(6)]
        bodies.append(max(candidates, key=lambda candidate: _clearance_mm(candidate, bodies)))
    return replace(scene, bodies=bodies)


def _clearance_mm(candidate: PlacedBody, others: list[PlacedBody]) -> float:
    """Return the least distance between the spheres around the bodies; negative where they overlap."""
    return min(
        float(np.linalg.norm(candidate.offset_mm - other.offset_mm))
        - candidate.body.radius_mm
        - other.body.radius_mm
        for other in others
    )


def _spoil_nothing(scene: _Scene, rng: np.random.Generator) -> _Scene:
    return scene


SPOIL: dict[HardCase, Callable[[_Scene, np.random.Generator], _Scene]] = {
    HardCase.CLEAN: _spoil_nothing,
    HardCase.APERTURE: _spoil_aperture,
    HardCase.BRIGHT: _spoil_bright,
    HardCase.WET: _spoil_wet,
    HardCase.DUST: _spoil_dust,
    HardCase.DIMMED: _spoil_dimmed,
    HardCase.FLICKER: _spoil_flicker,
    HardCase.SHADOW: _spoil_shadow,
    HardCase.MOTION: _spoil_motion,
    HardCase.NOISE: _spoil_noise,
    HardCase.SEVERAL: _spoil_several,
    HardCase.FRAGMENTS: _spoil_fragments,
    HardCase.F2: _spoil_nothing,
    HardCase.DEFOCUS: _spoil_defocus,
    HardCase.NOISE_10: _spoil_noise_10,
    HardCase.BRIGHT_TEXTURE: _spoil_bright_texture,
    HardCase.MOTION_9: _spoil_motion_9,
}
