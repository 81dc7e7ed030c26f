"""The images of a simulated sensor: automatic exposure, region of interest and faults, on top of an image source."""

from collections.abc import Callable
from dataclasses import dataclass
from math import prod

import numpy as np

from drivers.gige_simulator.faults import Faults
from drivers.gige_simulator.registers import Registers
from pipeline.arrays import GreyImage
from pipeline.frames import CameraId

TARGET_GREY = 128.0
"""Mean grey level that automatic exposure and gain aim at."""
_NEAR = 0.05
"""Relative deviation from the target at which the automatic mode `Once` ends."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """One exposure of one camera, for which an image source returns the image."""

    camera: CameraId
    n: int  # exposures since power-on, from 1
    trigger_ns: int  # host's monotonic time of the edge that caused it
    exposed_ns: int  # host's monotonic time of its start
    exposure_us: float
    gain_db: float
    high_lines: tuple[str, ...] = ()  # outputs that are high while it lasts


ImageSource = Callable[[Exposure], "GreyImage | None"]
"""Returns the image (H, W) of the whole sensor, which must not be changed afterwards; None: nothing is sent."""


def reduction(registers: Registers, direction: str) -> int:
    """Return the pixels of the sensor per pixel of its image, by binning and decimation, `Horizontal` or `Vertical`."""
    binning = registers.features[f"Binning{direction}"]
    factors = (registers.number(binning.key, bank) for bank in range(registers.n_banks(binning)))
    return prod(factors) * registers.number(f"Decimation{direction}")


class Imaging:
    """Makes the images that one camera sends."""

    def __init__(
        self, registers: Registers, *, faults: Faults, source: ImageSource, note: Callable[[str], None]
    ) -> None:
        self._registers = registers
        self._faults = faults
        self._source = source
        self._note = note
        self._frozen: GreyImage | None = None

    def take(self, exposure: Exposure) -> GreyImage | None:
        """Return the region of interest of the source's image; None if there is none, or its shape or type is wrong."""
        image, registers = self._source(exposure), self._registers
        if image is None:
            return None
        shape = (registers.number("SensorHeight"), registers.number("SensorWidth"))
        if image.shape != shape or image.dtype != np.uint8:
            self._note(f"image source gave {image.dtype} {image.shape}, not uint8 {shape}: nothing sent")
            return None
        self._adapt(float(image[::8, ::8].mean()), exposure)
        image = self._as_left(image)
        top, left = registers.number("OffsetY"), registers.number("OffsetX")
        return self._spoilt(
            image[top : top + registers.number("Height"), left : left + registers.number("Width")]
        )

    def _as_left(self, image: GreyImage) -> GreyImage:
        """Return the image as features outside of region and exposure make it."""
        registers = self._registers
        if registers.choice("TestPattern") != "Off":
            image = np.broadcast_to(np.arange(image.shape[1], dtype=np.uint8), image.shape)
        image = image[:: reduction(registers, "Vertical"), :: reduction(registers, "Horizontal")]
        if registers.number("ReverseX"):
            image = image[:, ::-1]
        if registers.number("ReverseY"):
            image = image[::-1]
        levels = np.arange(256.0)
        if registers.number_or("GammaEnable", 0) or registers.choice_or("LUTMode", "Off") == "Gamma":
            levels = 255 * (levels / 255) ** registers.quantity("Gamma")
        if registers.number_or("LUTEnable", 0):
            levels = 255 - levels
        if black := registers.quantity("BlackLevel"):
            levels = levels + black
        table = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
        return image if np.array_equal(table, np.arange(256)) else table[image]

    def _spoilt(self, image: GreyImage) -> GreyImage:
        faults = self._faults
        if not faults.frozen:
            self._frozen = None
        elif self._frozen is None or self._frozen.shape != image.shape:
            self._frozen = image
        else:
            image = self._frozen
        if faults.corrupted:
            image = image.copy()
            image[::2] = 255 - image[::2]
        return image[: image.shape[0] // 2] if faults.wrong_size else image

    def _adapt(self, mean_grey: float, exposure: Exposure) -> None:
        """Move automatic exposure time or gain towards the target; `Once` ends as soon as it is near."""
        factor = min(max(TARGET_GREY / max(mean_grey, 1.0), 0.5), 2.0)
        if self._registers.choice("ExposureAuto") != "Off":
            self._put("ExposureTime", exposure.exposure_us * factor)
            self._finish_once("ExposureAuto", factor)
        elif self._registers.choice("GainAuto") != "Off":
            self._put("Gain", exposure.gain_db + 20 * float(np.log10(factor)))
            self._finish_once("GainAuto", factor)

    def _put(self, key: str, value: float) -> None:
        feature = self._registers.features[key]
        self._registers.put(key, min(max(value, feature.minimum), feature.maximum))

    def _finish_once(self, key: str, factor: float) -> None:
        if self._registers.choice(key) == "Once" and abs(factor - 1) < _NEAR:
            self._registers.put(key, self._registers.features[key].entries["Off"])
