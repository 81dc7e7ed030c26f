"""A simulated exposure: blur by lens and motion, flash, sensor noise. Grey levels are linear in light."""

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.special import ndtr

from pipeline.arrays import FloatImage, Values
from pipeline.compiled import compiled
from pipeline.frames import Image


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureParameters:
    """How an exposure is taken; the defaults are the design's."""

    exposure_us: float = 20.0
    fall_speed_mm_s: float = 2430.0
    blur_px: float = 0.7  # sigma of the lens
    flash_sd: float = 0.01  # of the strobe's energy, from flash to flash
    camera_flash_sd: float = 0.002  # of each camera's own light, on top of it
    read_noise: float = 0.8  # grey levels
    shot_noise: float = 0.016  # variance per grey level: sigma 2 at 200

    def __post_init__(self) -> None:
        if not 0 <= self.exposure_us <= 1000:
            raise ValueError(f"exposure_us must be 0..1000, not {self.exposure_us:g}")
        if not 0.3 <= self.blur_px <= 10:
            raise ValueError(f"blur_px must be 0.3..10, not {self.blur_px:g}")


def blur_kernel(sigma_px: float, motion_uv: Values) -> FloatImage:
    """Return the point spread function (K, K), K odd: a Gaussian swept evenly along `motion_uv` (2,) px.

    Along the motion of length L the profile is (ndtr((s + L/2) / sigma) - ndtr((s - L/2) / sigma)) / L,
    across it Gaussian; the kernel is centred on the middle of the motion.
    """
    length = float(np.hypot(*motion_uv))
    radius = int(np.ceil(4 * sigma_px + length / 2))
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float64)
    if length < 1e-6:
        kernel = np.exp(-(u**2 + v**2) / (2 * sigma_px**2))
    else:
        du, dv = motion_uv / length
        along, across = u * du + v * dv, u * dv - v * du
        sweep = ndtr((along + length / 2) / sigma_px) - ndtr((along - length / 2) / sigma_px)
        kernel = sweep * np.exp(-(across**2) / (2 * sigma_px**2))
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)


def blurred(image: FloatImage, kernel: FloatImage) -> FloatImage:
    """Return the image convolved with a (symmetric) kernel; its border is replicated."""
    return np.asarray(cv2.filter2D(image, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE))


def expose(radiance: FloatImage, parameters: ExposureParameters, rng: np.random.Generator) -> Image:
    """Return the sensor's 8-bit image of a radiance (H, W) in grey levels, with shot noise, read noise and rounding."""
    unit_noise: FloatImage = rng.standard_normal(radiance.shape, dtype=np.float32)
    return np.asarray(
        _noisy(radiance, unit_noise, np.float32(parameters.shot_noise), np.float32(parameters.read_noise**2))
    )


@compiled
def _noisy(radiance: FloatImage, unit_noise: FloatImage, shot: np.float32, read: np.float32) -> Image:
    image = np.empty(radiance.shape, np.uint8)
    for v in range(radiance.shape[0]):
        for u in range(radiance.shape[1]):
            grey = radiance[v, u] + unit_noise[v, u] * np.sqrt(shot * radiance[v, u] + read)
            image[v, u] = np.uint8(min(max(np.rint(grey), np.float32(0)), np.float32(255)))
    return image
