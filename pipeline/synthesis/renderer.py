"""Rendered images of known bodies in a known rig.

Every random number comes from the generator that is passed in; one exposure is one call.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from pipeline.arrays import Directions, FloatImage, Indices, Matrix33, PointsMM, Values, Vector
from pipeline.frames import CameraId, Image
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.synthesis import pixel_coverage, shading
from pipeline.synthesis.background import WALL_GREY, EmptyView, WallKind, build_wall, render_backgrounds
from pipeline.synthesis.bodies import Body, SurfaceKind
from pipeline.synthesis.defocused_coverage import defocused_coverage
from pipeline.synthesis.disturbance import UNDISTURBED, Disturbance
from pipeline.synthesis.exposure import ExposureParameters, blur_kernel, blurred, expose
from pipeline.synthesis.pixel_coverage import Window
from pipeline.synthesis.rock_patterns import rock_pattern
from pipeline.synthesis.rock_textures import SPECTRUM_TRUE

if TYPE_CHECKING:
    from embreex.rtcore_scene import EmbreeScene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedBody:
    """A body and its pose in the middle of the exposure: x_world = R @ x_body + offset."""

    body: Body
    R: Matrix33
    offset_mm: Vector  # of the centre of mass

    @property
    def world_mesh(self) -> trimesh.Trimesh:
        vertices_mm = self.body.mesh.vertices @ self.R.T + self.offset_mm
        return trimesh.Trimesh(vertices_mm, self.body.mesh.faces, process=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedRig:
    """The parts of a rig that stay the same between exposures: cameras, housing, light."""

    rig: RigCalibration
    backgrounds: Mapping[CameraId, EmptyView]
    parameters: ExposureParameters = field(default_factory=ExposureParameters)
    wall_grey: float = WALL_GREY  # of the plain wall, which wet bodies mirror


def simulate_rig(
    rig: RigCalibration,
    rng: np.random.Generator,
    parameters: ExposureParameters | None = None,
    wall_kind: WallKind = WallKind.PANELS,
) -> RenderedRig:
    """Return a rig in a random housing; raise `PipelineError` without the extra [synthesis]."""
    shading.require_embree()
    parameters = parameters or ExposureParameters()
    wall = build_wall(rig, rng, wall_kind)
    backgrounds = render_backgrounds(rig, wall, rng, parameters.lens)
    return RenderedRig(rig=rig, backgrounds=backgrounds, parameters=parameters, wall_grey=wall.grey)


def photograph(
    bodies: Sequence[PlacedBody],
    simulated: RenderedRig,
    rng: np.random.Generator,
    disturbances: Mapping[CameraId, Disturbance] = MappingProxyType({}),
) -> dict[CameraId, Image]:
    """Return one exposure of all cameras; without bodies, of the empty rig."""
    surfaces = [illuminate(placed, rng) for placed in bodies]
    flash = _flash(simulated.parameters.flash_sd, rng)
    images = {}
    for camera in simulated.rig.cameras:
        disturbance = disturbances.get(camera.id, UNDISTURBED)
        view = view_of(surfaces, camera, simulated, disturbance)
        strength = flash * _flash(simulated.parameters.camera_flash_sd, rng)
        images[camera.id] = expose(view.radiance(strength), view.parameters, rng)
    return images


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LitSurface:
    """The surface of a placed body in the light of one exposure."""

    mesh: trimesh.Trimesh  # world frame
    center_mm: PointsMM  # (1, 3)
    edges: pixel_coverage.MeshEdges
    scene: "EmbreeScene"
    face_radiance: Values  # diffuse, of each face
    grain: shading.Grain | None  # what texture finer than faces adds to it
    gloss: float
    is_interreflecting: bool
    lamps: Directions  # to the lamps that a glossy surface mirrors


def illuminate(placed: PlacedBody, rng: np.random.Generator) -> LitSurface:
    """Return the body's surface in the light of one exposure."""
    body, mesh = placed.body, placed.world_mesh
    scene = shading.embree_scene(mesh)
    greys = shading.texture(body, rng)
    if body.surface is SurfaceKind.MOTTLED and not body.is_interreflecting:
        light = shading.irradiance(mesh, scene, rng)
    else:
        light = shading.even_irradiance(mesh, scene, subdivisions=_light_subdivisions(body))
    if body.is_interreflecting:
        light = shading.even_irradiance(mesh, scene, greys * light, _light_subdivisions(body))
    face_radiance = greys * light
    return LitSurface(
        mesh=mesh,
        center_mm=placed.offset_mm[None, :],
        edges=pixel_coverage.mesh_edges(mesh.faces),
        scene=scene,
        face_radiance=face_radiance,
        grain=_grain(placed, face_radiance, rng),
        gloss=body.gloss,
        is_interreflecting=body.is_interreflecting,
        # drawn for wet bodies only: the images of known seeds depend on all that is drawn
        lamps=shading.lamps(rng) if _mirrors_lamps(body) else np.empty((0, 3)),
    )


def _mirrors_lamps(body: Body) -> bool:
    """True for wet bodies, but for rock: its film of water mirrors the even wall alone."""
    return body.gloss > 0 and body.surface not in SPECTRUM_TRUE


def _light_subdivisions(body: Body) -> int:
    """Return the subdivisions of the directions of light; fine meshes get along with fewer directions."""
    return shading.DIRECTION_SUBDIVISIONS - (body.surface in SPECTRUM_TRUE)


def _grain(placed: PlacedBody, face_radiance: Values, rng: np.random.Generator) -> shading.Grain | None:
    body = placed.body
    pattern = rock_pattern(body, rng)
    if pattern is None:
        return None
    limits, step_px = shading.RELATIVE_GREYS, shading.STEP_PX
    if body.surface in SPECTRUM_TRUE:
        limits, step_px = shading.PHOTOGRAPHED_GREYS, 1

    def grain(faces: Indices, points_mm: PointsMM) -> Values:
        relative = 1 + body.contrast * pattern((points_mm - placed.offset_mm) @ placed.R)
        return np.asarray(face_radiance[faces] * (np.clip(relative, *limits) - 1))

    return shading.Grain(grain, step_px)


def _flash(sd: float, rng: np.random.Generator) -> float:
    return 1 + sd * float(np.clip(rng.normal(), -3, 3))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layer:
    """The part of an image that a body covers, blurred by lens and motion."""

    rows: slice
    columns: slice
    coverage: FloatImage  # (h, w) share of the pixel covered
    radiance: FloatImage  # (h, w) of the body, continued beyond its outline


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """One camera's view before flash and sensor: the wall and the bodies in front of it."""

    wall: FloatImage  # (H, W), in its light
    layers: tuple[Layer, ...]  # from the farthest to the nearest
    vignetting: FloatImage | float  # share of the light that the lens leaves
    disturbance: Disturbance
    parameters: ExposureParameters  # as disturbed

    def radiance(self, strength: float = 1.0) -> FloatImage:
        """Return the grey levels (H, W) without noise for a flash of this strength."""
        radiance = self.wall.copy()
        for layer in self.layers:  # coverage * body + (1 - coverage) * background
            background = radiance[layer.rows, layer.columns]
            background += layer.coverage * (layer.radiance - background)
        radiance *= strength
        radiance *= self.vignetting
        if self.parameters.lens is not None:
            radiance = self.parameters.lens.with_glare(radiance)
        radiance *= self.disturbance.transmission
        radiance += self.disturbance.veil
        return radiance


def view_of(
    surfaces: Sequence[LitSurface],
    camera: CameraCalibration,
    simulated: RenderedRig,
    disturbance: Disturbance = UNDISTURBED,
) -> View:
    """Return the view of one camera."""
    background = simulated.backgrounds[camera.id]
    parameters = simulated.parameters
    if disturbance.exposure_us is not None:
        parameters = replace(parameters, exposure_us=disturbance.exposure_us)
    if disturbance.read_noise is not None:
        parameters = replace(parameters, read_noise=disturbance.read_noise)
    ordered = sorted(surfaces, key=lambda s: -float(camera.project(s.center_mm)[1][0]))
    layers = (
        _layer(surface, camera, background.gain, disturbance.body_light, parameters, simulated.wall_grey)
        for surface in ordered
    )
    return View(
        wall=background.radiance * disturbance.wall_light,
        layers=tuple(layer for layer in layers if layer is not None),
        vignetting=1.0 if parameters.lens is None else parameters.lens.vignetting(camera),
        disturbance=disturbance,
        parameters=parameters,
    )


def _layer(
    surface: LitSurface,
    camera: CameraCalibration,
    gain: float,
    light: FloatImage | float,
    parameters: ExposureParameters,
    wall_grey: float,
) -> Layer | None:
    """Return the layer of a body in an image, `None` if it is out of view."""
    fall_mm = np.array([[0, 0, -parameters.fall_speed_mm_s * parameters.exposure_us * 1e-6]])
    (start_uv, end_uv), _ = camera.project(np.concatenate([-fall_mm, fall_mm]) / 2 + surface.center_mm)
    kernel = blur_kernel(parameters.blur_px, end_uv - start_uv)

    pixels_uv, depths_mm = camera.project(surface.mesh.vertices)
    if depths_mm.min() <= 0:
        raise ValueError(f"camera {camera.id}: a body reaches behind the camera")
    lens = parameters.lens
    disc_px = np.zeros_like(depths_mm) if lens is None else lens.disc_px(depths_mm, camera.focal_px)
    margin_px = len(kernel) // 2 + int(np.ceil(disc_px.max() / 2))
    width, height = camera.image_size_px
    # beyond the image's border by the reach of the blur
    seen = Window(-margin_px, -margin_px, width + 2 * margin_px, height + 2 * margin_px)
    window = pixel_coverage.intersection(pixel_coverage.window_around(pixels_uv, margin_px), seen)
    if window is None:
        return None
    if lens is None:
        toward_camera_mm = camera.center_mm - surface.mesh.triangles[:, 0]
        is_front = np.einsum("ij,ij->i", surface.mesh.face_normals, toward_camera_mm) > 0
        border_uv = pixels_uv[pixel_coverage.silhouette_edges(surface.edges, is_front)]
        covered = pixel_coverage.coverage(border_uv[:, 0], border_uv[:, 1], window)
    else:
        points_mm = surface.mesh.vertices @ camera.R.T + camera.t_mm
        covered = defocused_coverage(points_mm, surface.mesh.faces, surface.edges, camera, lens, window)
    face_radiance = surface.face_radiance
    if surface.gloss > 0:
        face_radiance = face_radiance + surface.gloss * shading.reflection(
            surface.mesh,
            surface.scene,
            surface.lamps,
            camera,
            surface.face_radiance if surface.is_interreflecting else None,
            wall_grey,
        )
    face_disc_px = None if lens is None else disc_px[surface.mesh.faces].mean(axis=1)
    shown = shading.surface_image(
        surface.scene, face_radiance, camera, window, face_disc_px, surface.grain, gain
    )
    covered, shown = blurred(covered, kernel), blurred(shown, kernel)

    inside = pixel_coverage.intersection(window, Window(0, 0, width, height))
    if inside is None:
        return None
    rows = slice(inside.top, inside.top + inside.height)
    columns = slice(inside.left, inside.left + inside.width)
    within = (
        slice(inside.top - window.top, inside.top - window.top + inside.height),
        slice(inside.left - window.left, inside.left - window.left + inside.width),
    )
    light_there = light if isinstance(light, float) else light[rows, columns]
    return Layer(rows=rows, columns=columns, coverage=covered[within], radiance=shown[within] * light_there)
