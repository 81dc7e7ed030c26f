"""Photographs of known bodies by a known rig.

Every random number comes from the generator that is passed in; one exposure is one call.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import trimesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from pipeline.frames import CameraId, Image
from pipeline.rig import CameraCalibration, RigCalibration
from pipeline.synthesis import outline, shading
from pipeline.synthesis.background import Background, build_wall, render_backgrounds
from pipeline.synthesis.bodies import Body
from pipeline.synthesis.optics import ExposureParameters, FloatImage, blur_kernel, blurred, expose
from pipeline.synthesis.outline import Window

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlacedBody:
    """A body where it is in the middle of the exposure: x_world = R @ x_body + offset."""

    body: Body
    R: Array  # (3, 3)
    offset_mm: Array  # (3,) of the centre of mass

    @property
    def world_mesh(self) -> trimesh.Trimesh:
        vertices_mm = self.body.mesh.vertices @ self.R.T + self.offset_mm
        return trimesh.Trimesh(vertices_mm, self.body.mesh.faces, process=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedRig:
    """What stays the same between exposures: cameras, housing, light."""

    rig: RigCalibration
    backgrounds: Mapping[CameraId, Background]
    parameters: ExposureParameters = field(default_factory=ExposureParameters)


def simulate_rig(
    rig: RigCalibration, rng: np.random.Generator, parameters: ExposureParameters | None = None
) -> SimulatedRig:
    """A rig in a randomly built housing."""
    backgrounds = render_backgrounds(rig, build_wall(rig, rng), rng)
    return SimulatedRig(rig=rig, backgrounds=backgrounds, parameters=parameters or ExposureParameters())


def photograph(
    bodies: Sequence[PlacedBody], simulated: SimulatedRig, rng: np.random.Generator
) -> dict[CameraId, Image]:
    """One exposure of all cameras; without bodies, of the empty rig."""
    parameters = simulated.parameters
    surfaces = [_surface(placed, rng) for placed in bodies]
    flash = _flash(parameters.flash_sd, rng)
    images = {}
    for camera in simulated.rig.cameras:
        background = simulated.backgrounds[camera.id]
        radiance = background.radiance.copy()
        for surface in sorted(surfaces, key=lambda s: -float(camera.project(s.center_mm)[1][0])):
            _compose(radiance, surface, camera, background.gain, parameters)
        radiance *= flash * _flash(parameters.camera_flash_sd, rng)
        images[camera.id] = expose(radiance, parameters, rng)
    return images


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Surface:
    """A placed body with its light on it."""

    mesh: trimesh.Trimesh  # world frame
    center_mm: Array  # (1, 3)
    edges: outline.Edges
    scene: EmbreeScene
    face_radiance: Array  # (F,)


def _surface(placed: PlacedBody, rng: np.random.Generator) -> _Surface:
    mesh = placed.world_mesh
    scene = shading.embree_scene(mesh)
    face_radiance = shading.texture(placed.body, rng) * shading.irradiance(mesh, scene, rng)
    return _Surface(
        mesh=mesh,
        center_mm=placed.offset_mm[None, :],
        edges=outline.edges_of(mesh.faces),
        scene=scene,
        face_radiance=face_radiance,
    )


def _flash(sd: float, rng: np.random.Generator) -> float:
    return 1 + sd * float(np.clip(rng.normal(), -3, 3))


def _compose(
    radiance: FloatImage,
    surface: _Surface,
    camera: CameraCalibration,
    gain: float,
    parameters: ExposureParameters,
) -> None:
    """Put a body in front of what `radiance` (H, W) shows: coverage * body + (1 - coverage) * behind."""
    fall_mm = np.array([[0, 0, -parameters.fall_speed_mm_s * parameters.exposure_us * 1e-6]])
    (start_uv, end_uv), _ = camera.project(np.concatenate([-fall_mm, fall_mm]) / 2 + surface.center_mm)
    kernel = blur_kernel(parameters.blur_px, end_uv - start_uv)

    pixels_uv, depths_mm = camera.project(surface.mesh.vertices)
    if depths_mm.min() <= 0:
        raise ValueError(f"camera {camera.id}: a body reaches behind the camera")
    margin_px = len(kernel) // 2
    width, height = camera.image_size_px
    # beyond the image's border by the reach of the blur
    seen = Window(-margin_px, -margin_px, width + 2 * margin_px, height + 2 * margin_px)
    window = outline.intersection(outline.window_around(pixels_uv, margin_px), seen)
    if window is None:
        return
    toward_camera_mm = camera.center_mm - surface.mesh.triangles[:, 0]
    is_front = np.einsum("ij,ij->i", surface.mesh.face_normals, toward_camera_mm) > 0
    border_uv = pixels_uv[outline.border(surface.edges, is_front)]
    covered = outline.coverage(border_uv[:, 0], border_uv[:, 1], window)
    shown = shading.surface_image(surface.scene, surface.face_radiance * gain, camera, window)
    covered, shown = blurred(covered, kernel), blurred(shown, kernel)

    inside = outline.intersection(window, Window(0, 0, width, height))
    if inside is None:
        return
    rows = slice(inside.top - window.top, inside.top - window.top + inside.height)
    columns = slice(inside.left - window.left, inside.left - window.left + inside.width)
    behind = radiance[inside.top : inside.top + inside.height, inside.left : inside.left + inside.width]
    behind += covered[rows, columns] * (shown[rows, columns] - behind)
