"""A thin lens of finite aperture: defocus blur, and vignetting towards the corners.

A point at depth z, seen through the point a (2,) mm of the aperture, lands at the normalized coordinates
`P_xy / P_z + a (1 / focus - 1 / P_z)`: the plane in focus stays where a pinhole has it.
"""

from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np

from pipeline.arrays import FloatImage, Floats, Values
from pipeline.rig.cameras import CameraCalibration

N_APERTURE_POINTS = 128
"""With these the coverage of edges blurred over up to 12 px is within 0.001 (rms) of its limit."""
GLARE_STEP_PX = 8
"""Pixel step on which glare is computed: it is spread over many times that."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ThinLens:
    """An ideal lens but for its shading and its glare; the focal length and the focus distance are the paper's."""

    focal_length_mm: float = 25.0
    f_number: float
    focus_mm: float = 300.0  # depth of the plane in focus, along the optical axis
    corner_loss: float = 0.0  # of light in the image's corners, by the mechanical vignetting of the barrel
    glare_share: float = 0.0  # of the light, spread all over by reflections between the glasses
    glare_px: float = 60.0  # sigma of that spread

    def __post_init__(self) -> None:
        for name in ("focal_length_mm", "f_number", "focus_mm", "glare_px"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, not {getattr(self, name):g}")
        for name in ("corner_loss", "glare_share"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"{name} must be 0 or more and less than 1, not {getattr(self, name):g}")

    @property
    def aperture_mm(self) -> float:
        """Diameter of the aperture."""
        return self.focal_length_mm / self.f_number

    def disc_px(self, depths_mm: Values, focal_px: float) -> Values:
        """Return the diameters (N,) of the blur discs of points at depths (N,) in front of the lens."""
        return np.asarray(focal_px * self.aperture_mm * np.abs(1 / self.focus_mm - 1 / depths_mm))

    def aperture_points_mm(self) -> Annotated[Floats, "(N_APERTURE_POINTS, 2)"]:
        """Return points spread evenly over the aperture: a spiral (Vogel 1979), turned by each quarter of a turn.

        So the disc's centre and its width are exact in every direction, and straight edges stay where they are.
        """
        index = np.arange(N_APERTURE_POINTS // 4)
        radii_mm = self.aperture_mm / 2 * np.sqrt((index + 0.5) / len(index))
        angles = index * np.pi / 2 * (np.sqrt(5) - 1) / 2  # the golden section of a quarter of a turn
        points_mm = radii_mm[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
        quarter = np.array([[0.0, 1.0], [-1.0, 0.0]])
        return np.concatenate([points_mm, points_mm @ quarter, -points_mm, -points_mm @ quarter])

    def vignetting(self, camera: CameraCalibration) -> FloatImage:
        """Return the share of light (H, W) that reaches each pixel, 1 on the axis: cos^4 and mechanical vignetting."""
        width, height = camera.image_size_px
        x = (np.arange(width) - camera.K[0, 2]) / camera.K[0, 0]
        y = (np.arange(height) - camera.K[1, 2]) / camera.K[1, 1]
        squared = (x**2 + y[:, None] ** 2).astype(np.float32)
        corner = (width**2 / camera.K[0, 0] ** 2 + height**2 / camera.K[1, 1] ** 2) / 4
        return np.asarray((1 - self.corner_loss / corner * squared) / (1 + squared) ** 2, dtype=np.float32)

    def with_glare(self, light: FloatImage) -> FloatImage:
        """Return an image (H, W) with a share of its light spread widely; beyond its border it goes on as there."""
        if self.glare_share == 0:
            return light
        height, width = light.shape
        coarse_size = (-(-width // GLARE_STEP_PX), -(-height // GLARE_STEP_PX))
        coarse = cv2.resize(light, coarse_size, interpolation=cv2.INTER_AREA)
        sigma = self.glare_px / GLARE_STEP_PX
        spread = cv2.GaussianBlur(coarse, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        glare = cv2.resize(spread, (width, height), interpolation=cv2.INTER_LINEAR)
        return np.asarray(
            cv2.addWeighted(light, 1 - self.glare_share, glare, self.glare_share, 0), np.float32
        )


def disc_kernel(diameter_px: float) -> FloatImage:
    """Return an even disc (K, K), K odd, as a kernel of sum 1; less than a pixel wide it changes nothing."""
    radius = diameter_px / 2
    reach = int(np.ceil(radius))
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    kernel = np.clip(radius + 0.5 - np.hypot(u, v), 0, 1)
    return np.asarray(kernel / kernel.sum(), dtype=np.float32)
