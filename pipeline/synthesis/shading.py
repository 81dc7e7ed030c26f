"""The radiance of a body's surface: matte or wet stone in the even light of a dome.

A matte surface looks equally bright from everywhere, so each face's radiance is computed once an
exposure: its texture times the part of the dome that it sees. Rays (embree) find what occludes it, and
which face a pixel shows. A wet surface is darker, and mirrors the dome and its lamps. Faces light each
other if that is asked for, by light that they reflect once.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

import cv2
import numpy as np
import trimesh

from pipeline.arrays import Directions, FloatImage, Indices, PointsMM, Values
from pipeline.errors import PipelineError
from pipeline.geometry.icosphere import icosphere
from pipeline.rig.cameras import CameraCalibration
from pipeline.synthesis.background import WALL_GREY
from pipeline.synthesis.bodies import Body, SurfaceKind
from pipeline.synthesis.pixel_coverage import Window
from pipeline.synthesis.stones import wave_noise
from pipeline.synthesis.thin_lens import disc_kernel

if TYPE_CHECKING:
    from embreex.rtcore_scene import EmbreeScene

TEXTURE_WAVELENGTHS_MM = (8.0, 3.0, 1.2)
RELATIVE_GREYS = (0.4, 1.7)
"""Limits of a texture, relative to the mean grey."""
PHOTOGRAPHED_GREYS = (0.05, 4.0)
"""Limits of the textures of `rock_textures.py`."""
DOME_GRADIENT = 0.3
"""Share by which the dome is brighter above than at its horizon, and darker below."""
RAYS_PER_FACE = 12
DIRECTION_SUBDIVISIONS = 3
"""Of the sphere of directions from which even light comes: 642, each one 0.6 % of a face's light at most."""
WET_DARKENING = 0.4
"""Share by which a wet stone scatters less light (Lekner and Dorf 1988: a third to a half)."""
NORMAL_REFLECTANCE = 0.02  # of water
N_LAMPS = 8
LAMP_SHARPNESS = 150.0  # exponent of a lamp's lobe: some 5 degrees wide
LAMP_LEVEL = 40.0
"""Radiance of a lamp relative to the wall's."""
STEP_PX = 2
"""Pixel step on which texture is looked up; the lens blurs over more than that."""
CONTINUED_PX = 6.0
"""Standard deviation of the mean that continues the surface beyond its outline."""


@dataclass(frozen=True, slots=True)
class Grain:
    """A texture finer than the faces."""

    radiance: Callable[[Indices, PointsMM], Values]
    """Radiance (N,) that it adds at points (N, 3), each on a face (N,)."""
    step_px: int = STEP_PX
    """Pixel step on which it is looked up."""


def require_embree() -> None:
    """Raise `PipelineError` where embreex is missing: a plant's installation has no use for it, and arm64 has none."""
    if find_spec("embreex") is None:
        raise PipelineError(
            "to render bodies needs the extra [synthesis], which is not installed:"
            " pip install --require-hashes -r deploy/requirements-synthesis.lock (amd64 only)"
        )


def embree_scene(mesh: trimesh.Trimesh) -> "EmbreeScene":
    """Return the mesh ready for ray casting (float32: within 2e-6 mm on a body of 40 mm)."""
    from embreex.mesh_construction import TriangleMesh  # here: an extra, which only rendering needs
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, np.array(mesh.vertices, dtype=np.float32), np.array(mesh.faces, dtype=np.int32))
    return scene


def texture(body: Body, rng: np.random.Generator) -> Values:
    """Return the grey level of each face (F,) under full light; of a mottled body on three scales, with speckles."""
    matte = body.grey * (1 - WET_DARKENING * body.gloss)
    if body.surface is not SurfaceKind.MOTTLED:
        return np.full(len(body.mesh.faces), matte)
    centers_mm = body.mesh.triangles_center
    mottles = sum(wave_noise(centers_mm, wavelength, 12, rng) for wavelength in TEXTURE_WAVELENGTHS_MM)
    speckles = rng.normal(size=len(centers_mm))
    relative = body.contrast * (0.5 * mottles + 0.5 * speckles)
    return np.asarray(matte * np.clip(1 + relative, *RELATIVE_GREYS))


def irradiance(mesh: trimesh.Trimesh, scene: "EmbreeScene", rng: np.random.Generator) -> Values:
    """Return the light (F,) that each face receives, 1 for an unoccluded one that faces the horizon.

    Monte-Carlo over cosine-distributed directions: what the body itself occludes is dark.
    """
    normals = np.repeat(mesh.face_normals, RAYS_PER_FACE, axis=0)
    scatter = rng.normal(size=normals.shape)
    scatter /= np.linalg.norm(scatter, axis=1, keepdims=True)
    directions = normals + 0.999 * scatter
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.repeat(mesh.triangles_center, RAYS_PER_FACE, axis=0) + 1e-3 * normals
    is_free = scene.run(origins.astype(np.float32), directions.astype(np.float32)) < 0
    received = is_free * (1 + DOME_GRADIENT * directions[:, 2])
    return np.asarray(received.reshape(-1, RAYS_PER_FACE).mean(axis=1))


def even_irradiance(
    mesh: trimesh.Trimesh,
    scene: "EmbreeScene",
    face_radiance: Values | float = 0.0,
    subdivisions: int = DIRECTION_SUBDIVISIONS,
) -> Values:
    """Return the light (F,) as `irradiance` does, from the same directions for all faces: without any noise of its own.

    What occludes the dome sends the radiance of its faces (F,) instead, in grey levels. The directions are the
    vertices of an icosahedron subdivided so often.
    """
    radiance = np.broadcast_to(face_radiance, len(mesh.faces)) / WALL_GREY
    origins_mm = mesh.triangles_center + 1e-3 * mesh.face_normals
    received, weights = np.zeros((2, len(mesh.faces)))
    for direction in icosphere(subdivisions)[0]:
        cosines = mesh.face_normals @ direction
        lit = np.flatnonzero(cosines > 0)
        rays = np.tile(direction.astype(np.float32), (len(lit), 1))
        hits = scene.run(origins_mm[lit].astype(np.float32), rays)
        received[lit] += cosines[lit] * np.where(hits < 0, 1 + DOME_GRADIENT * direction[2], radiance[hits])
        weights[lit] += cosines[lit]
    return received / np.maximum(weights, 1e-12)  # a face without area has no normal


def lamps(rng: np.random.Generator) -> Directions:
    """Return random directions (N_LAMPS, 3) to the dome's lamps."""
    directions = rng.normal(size=(N_LAMPS, 3))
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


def reflection(
    mesh: trimesh.Trimesh,
    scene: "EmbreeScene",
    lamps: Directions,
    camera: CameraCalibration,
    face_radiance: Values | None = None,
    wall_grey: float = WALL_GREY,
) -> Values:
    """Return the radiance (F,) that wet faces mirror to the camera, all of the wall's at grazing angles (Schlick 1994).

    Where faces of the body hide the wall, their radiance (F,) is mirrored, if it is given.
    """
    toward_camera = camera.center_mm - mesh.triangles_center
    toward_camera /= np.linalg.norm(toward_camera, axis=1, keepdims=True)
    cosines = np.clip((mesh.face_normals * toward_camera).sum(axis=1), 0, 1)
    mirrored = 2 * cosines[:, None] * mesh.face_normals - toward_camera
    lobes = np.exp(LAMP_SHARPNESS * (mirrored @ lamps.T - 1)).sum(axis=1)
    reflectance = NORMAL_REFLECTANCE + (1 - NORMAL_REFLECTANCE) * (1 - cosines) ** 5
    mirrored_radiance = wall_grey * (1 + LAMP_LEVEL * lobes)
    if face_radiance is not None:
        origins_mm = mesh.triangles_center + 1e-3 * mesh.face_normals
        hits = scene.run(origins_mm.astype(np.float32), mirrored.astype(np.float32))
        mirrored_radiance = np.where(hits < 0, mirrored_radiance, face_radiance[hits])
    return np.asarray(reflectance * mirrored_radiance)


def surface_image(
    scene: "EmbreeScene",
    face_radiance: Values,
    camera: CameraCalibration,
    window: Window,
    face_disc_px: Values | None = None,
    grain: Grain | None = None,
    gain: float = 1.0,
) -> FloatImage:
    """Return the radiance (height, width) of the surface in a window, extrapolated smoothly beyond the outline.

    Each face (F,) is blurred by its disc, where their diameters are given. `grain` adds to what the faces radiate,
    and the camera's gain multiplies both.
    """
    step_px = STEP_PX if grain is None else grain.step_px
    u = window.left + (np.arange(-(-window.width // step_px)) + 0.5) * step_px - 0.5
    v = window.top + (np.arange(-(-window.height // step_px)) + 0.5) * step_px - 0.5
    grid_uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    rays = camera.rays(grid_uv).astype(np.float32)
    origins = np.broadcast_to(camera.center_mm.astype(np.float32), rays.shape)
    hits = scene.run(np.ascontiguousarray(origins), rays, output=True)
    faces = hits["primID"].reshape(len(v), len(u))
    is_hit = (faces >= 0).astype(np.float32)
    sigma = CONTINUED_PX / step_px
    near = cv2.GaussianBlur(is_hit, (0, 0), sigma)

    def on_grid(face_values: Values) -> FloatImage:
        values = np.where(faces >= 0, face_values[faces], 0).astype(np.float32)
        # beyond the outline: the mean of the surface nearby, so that edge pixels show its grey
        smooth = cv2.GaussianBlur(values, (0, 0), sigma)
        mean = float(face_values.mean())
        continued = (smooth + 1e-4 * mean) / (near + 1e-4)
        return np.where(faces >= 0, values, continued).astype(np.float32)

    radiance = on_grid(face_radiance * gain)
    if grain is not None:
        hit = np.flatnonzero(faces >= 0)
        points_mm = camera.center_mm + hits["tfar"][hit, None] * rays[hit]
        radiance.flat[hit] += gain * grain.radiance(faces.flat[hit], points_mm)
    if face_disc_px is not None:
        radiance = _blurred_by_own_disc(radiance, on_grid(face_disc_px / step_px))
    fine = cv2.resize(radiance, (len(u) * step_px, len(v) * step_px), interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine[: window.height, : window.width])


def _blurred_by_own_disc(image: FloatImage, diameters: FloatImage) -> FloatImage:
    """Return an image (H, W), each pixel spread over a disc of its own diameter: interpolated between a few discs.

    Spread, as a lens does it, not gathered: gathered, points would move towards where the discs are larger.
    """
    low = float(diameters.min())
    high = max(float(diameters.max()), low + 1e-3)
    levels, step = np.linspace(low, high, 2 + int(high - low), retstep=True)
    light, weights = np.zeros_like(image), np.zeros_like(image)
    for level in levels:
        weight = np.clip(1 - np.abs(diameters - np.float32(level)) / np.float32(step), 0, 1)
        kernel = disc_kernel(level)
        light += cv2.filter2D(weight * image, -1, kernel, borderType=cv2.BORDER_REPLICATE)
        weights += cv2.filter2D(weight, -1, kernel, borderType=cv2.BORDER_REPLICATE)
    return light / weights
