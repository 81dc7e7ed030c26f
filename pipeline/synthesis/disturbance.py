"""Disturbances of one camera's view: dust on the lens, failing light, shadows, noise, a long exposure.

Grey levels are linear in light, so each disturbance is a factor or a summand, and several of them multiply.
All are fixed to the camera and out of focus; none moves with the wall or with the body.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import brentq

from pipeline.arrays import FloatImage, Floats, Vector
from pipeline.rig.cameras import CameraCalibration, RigCalibration
from pipeline.synthesis.background import WALL_GREY, wall_directions

DENSEST_DUST = 0.6
"""Share of the light that dust of strength 1 absorbs, on average over the image."""
VEIL_SHARE = 0.3
"""Part of the absorbed light that returns as stray light from everywhere: a veil."""
CLOUD_PX, SPECK_PX = (140.0, 320.0), (12.0, 30.0)
"""Standard deviations of patches of dust on the lens, and of single specks nearer to the sensor."""
PANEL_DEG, PANEL_SOFTNESS_DEG = 40.0, 12.0
"""Half the width of a panel of the dome as seen from the centre, and of its border."""
PANEL_SHARE = 0.5
"""Part of its light that a matte surface facing a panel receives from it."""
COARSE_PX = 8
"""Pixel step on which light and dust are computed: they vary slowly."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Disturbance:
    """Disturbances of one camera's view in one exposure; arrays are (H, W), the defaults change nothing."""

    wall_light: FloatImage | float = 1.0  # factor on the light of the wall
    body_light: FloatImage | float = 1.0  # factor on the light of bodies, where they are seen
    transmission: FloatImage | float = 1.0  # of lens and window
    veil: FloatImage | float = 0.0  # grey levels of stray light
    read_noise: float | None = None  # grey levels, instead of the exposure's
    exposure_us: float | None = None  # instead of the exposure's


UNDISTURBED = Disturbance()


def dust(strength: float, rng: np.random.Generator, image_size_px: tuple[int, int]) -> Disturbance:
    """Return patchy dust on the lens, of mean transmission `1 - DENSEST_DUST * strength`, with a veil of stray light.

    Raises
    ------
    ValueError
        `strength` is not within 0..1.
    """
    _require_share("strength", strength)
    width, height = image_size_px
    clouds = _blobs(12, CLOUD_PX, rng, image_size_px)
    specks = _blobs(int(rng.integers(0, 8)), SPECK_PX, rng, image_size_px)
    density = 0.2 + clouds / max(float(clouds.mean()), 1e-6) + specks
    absorbed = DENSEST_DUST * strength

    def excess(depth: float) -> float:
        return float(np.exp(-depth * density).mean()) - (1 - absorbed)

    depth = brentq(excess, 0.0, 50.0) if absorbed > 0 else 0.0
    transmission = _fine(np.exp(-depth * density), width, height)
    return Disturbance(
        transmission=transmission, veil=np.float32(VEIL_SHARE * WALL_GREY) * (1 - transmission)
    )


def dimmed_sector(
    rig: RigCalibration, camera: CameraCalibration, strength: float, direction: Vector
) -> Disturbance:
    """Return the change of a camera's view when the panel of the dome in a `direction` from the centre is dimmed.

    The wall is dark where the panel itself is in sight; a body is dark on the side that faces the panel.
    """
    _require_share("strength", strength)
    toward_panel = direction / np.linalg.norm(direction)
    radius_mm = float(np.linalg.norm([other.center_mm for other in rig.cameras], axis=1).mean())
    width, height = camera.image_size_px
    pixels_uv = _coarse_grid(width, height)
    shape = pixels_uv.shape[:2]
    on_wall = wall_directions(camera, pixels_uv.reshape(-1, 2), radius_mm)
    from_panel_deg = np.rad2deg(np.arccos(np.clip(on_wall @ toward_panel, -1, 1)))
    is_panel = 1 / (1 + np.exp((from_panel_deg - PANEL_DEG) / (PANEL_SOFTNESS_DEG / 2)))
    # normals of a body in the middle, taken for a ball that fills half of the image
    toward_camera = camera.center_mm / np.linalg.norm(camera.center_mm)
    across = (pixels_uv - camera.K[:2, 2]) / (height / 2)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1)
    facing = np.sqrt(np.maximum(1 - (across**2).sum(axis=-1), 0))
    normals = across @ camera.R[:2] + facing[..., None] * toward_camera
    sees_panel = np.clip(normals @ toward_panel, 0, 1)
    return Disturbance(
        wall_light=_fine(1 - strength * is_panel.reshape(shape), width, height),
        body_light=_fine(1 - strength * PANEL_SHARE * sees_panel, width, height),
    )


def flicker(factor: float) -> Disturbance:
    """Return a flash of `factor` times the usual energy, for wall and body alike."""
    if not factor > 0:
        raise ValueError(f"factor must be positive, not {factor:g}")
    return Disturbance(wall_light=factor, body_light=factor)


def cast_shadow(strength: float, rng: np.random.Generator, image_size_px: tuple[int, int]) -> Disturbance:
    """Return a soft shadow on the wall, somewhere near the middle, that takes up to `strength` of its light."""
    _require_share("strength", strength)
    width, height = image_size_px
    pixels_uv = _coarse_grid(width, height)
    center = np.array([width, height]) * rng.uniform(0.3, 0.7, size=2)
    radii_px = rng.uniform(0.12, 0.35, size=2) * height
    angle = rng.uniform(0, np.pi)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    beyond_px = (np.linalg.norm((pixels_uv - center) @ turn / radii_px, axis=-1) - 1) * radii_px.min()
    softness_px = rng.uniform(0.01, 0.06) * height
    return Disturbance(wall_light=_fine(1 - strength / (1 + np.exp(beyond_px / softness_px)), width, height))


def _blobs(
    count: int,
    sigma_px: tuple[float, float],
    rng: np.random.Generator,
    image_size_px: tuple[int, int],
) -> Floats:
    """Return the sum of `count` Gaussian patches of random place, width and weight, on the coarse grid."""
    width, height = image_size_px
    pixels_uv = _coarse_grid(width, height)
    # patches are as large relative to any image as they are to the design's
    scale = height / 1024
    total = np.zeros(pixels_uv.shape[:2])
    for _ in range(count):
        center = rng.uniform(0, 1, size=2) * [width, height]
        sigma = scale * rng.uniform(*sigma_px)
        weight = rng.uniform(0.2, 1.0)
        total += weight * np.exp(-((pixels_uv - center) ** 2).sum(axis=-1) / (2 * sigma**2))
    return total


def _coarse_grid(width: int, height: int) -> Floats:
    """Return the pixel coordinates (rows, columns, 2) of the centres of blocks of `COARSE_PX`."""
    u = (np.arange(-(-width // COARSE_PX)) + 0.5) * COARSE_PX - 0.5
    v = (np.arange(-(-height // COARSE_PX)) + 0.5) * COARSE_PX - 0.5
    return np.stack(np.meshgrid(u, v), axis=-1)


def _fine(coarse: Floats, width: int, height: int) -> FloatImage:
    """Interpolate a coarse image to full size (H, W)."""
    rows, columns = coarse.shape
    fine = cv2.resize(
        coarse.astype(np.float32), (columns * COARSE_PX, rows * COARSE_PX), interpolation=cv2.INTER_LINEAR
    )
    return np.asarray(fine[:height, :width])


def _require_share(name: str, value: float) -> None:
    if not 0 <= value <= 1:
        raise ValueError(f"{name} must be 0..1, not {value:g}")
