"""A simulated exposure: blur by lens and motion, flash, sensor noise. Grey levels are linear in light."""

from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np
from scipy.special import ndtr

from pipeline.arrays import FloatImage, Values
from pipeline.compiled import compiled
from pipeline.frames import Image
from pipeline.synthesis.thin_lens import ThinLens

FULL_SCALE_GREY = 255.0
"""Grey level of a full well."""
BLUR_PX = (0.3, 10.0)
"""Range of the blur in focus."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExposureParameters:
    """Parameters of an exposure; the defaults are the design's."""

    exposure_us: float = 20.0
    fall_speed_mm_s: float = 2430.0
    lens: ThinLens | None = None  # None: everything is blurred alike, the wall as at about F8
    blur_px: float = 0.7  # sigma of what the lens does to a point in focus
    flash_sd: float = 0.01  # of the strobe's energy, from flash to flash
    camera_flash_sd: float = 0.002  # of each camera's own light, on top of it
    read_noise: float = 0.8  # grey levels: 50 electrons
    shot_noise: float = 0.016  # variance per grey level, sigma 2 at 200: a full well of 15 900 electrons

    def __post_init__(self) -> None:
        if not 0 <= self.exposure_us <= 1000:
            raise ValueError(f"exposure_us must be 0..1000, not {self.exposure_us:g}")
        if not BLUR_PX[0] <= self.blur_px <= BLUR_PX[1]:
            raise ValueError(f"blur_px must be {BLUR_PX[0]:g}..{BLUR_PX[1]:g}, not {self.blur_px:g}")

    def with_sensor(self, *, full_well_e: float, read_noise_e: float) -> "ExposureParameters":
        """Return the same exposure on a sensor whose wells hold `full_well_e` electrons, at grey level 255.

        The number of photons is Poisson distributed: its variance in electrons is its mean.
        """
        grey_per_electron = FULL_SCALE_GREY / full_well_e
        return replace(self, shot_noise=grey_per_electron, read_noise=read_noise_e * grey_per_electron)


class LensPreset(StrEnum):
    """A lens at one of its f-numbers; `sharp` is the uniform blur of the defaults."""

    SHARP = "sharp"
    F8 = "f8"
    F4 = "f4"
    F2 = "f2"


LENS_PRESETS = {
    LensPreset.SHARP: ExposureParameters(),
    LensPreset.F8: ExposureParameters(lens=ThinLens(f_number=8.0, corner_loss=0.0, glare_share=0.010)),
    LensPreset.F4: ExposureParameters(lens=ThinLens(f_number=4.0, corner_loss=0.04, glare_share=0.015)),
    LensPreset.F2: ExposureParameters(
        lens=ThinLens(f_number=2.0, corner_loss=0.15, glare_share=0.020), blur_px=0.9
    ),
}
"""A plain lens of 25 mm: wide open it is softer, darkens the corners and spreads more light."""
QUIET_F2 = LENS_PRESETS[LensPreset.F2].with_sensor(full_well_e=26_500, read_noise_e=42)
"""F2.0 on a sensor with a sigma of 0.6 at grey level 12 and of 1.3 at 150, the rounding to levels included."""


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
