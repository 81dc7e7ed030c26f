"""What a sensor makes of the light: asks the image source, adapts, cuts the region of interest, errs on request."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.gige_simulator.faults import Faults
from drivers.gige_simulator.registers import Registers
from pipeline.frames import CameraId

TARGET_GREY = 128.0
"""Mean grey level automatic exposure and gain aim at."""
_NEAR = 0.05
"""Relative deviation from it at which `Once` is done."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Exposure:
    """What an image source is asked for: what this camera saw."""

    camera: CameraId
    n: int  # exposures since power-on, from 1
    trigger_ns: int  # host's monotonic time of the edge that caused it
    exposed_ns: int  # of its start
    exposure_us: float
    gain_db: float


ImageSource = Callable[[Exposure], "NDArray[np.uint8] | None"]
"""Returns the whole sensor's image (H, W), not changed any more; nothing is sent for `None`."""


class Imaging:
    """Images as they go out, of one camera."""

    def __init__(
        self, registers: Registers, *, faults: Faults, source: ImageSource, note: Callable[[str], None]
    ) -> None:
        self._registers = registers
        self._faults = faults
        self._source = source
        self._note = note
        self._frozen: NDArray[np.uint8] | None = None

    def take(self, exposure: Exposure) -> NDArray[np.uint8] | None:
        """Return the region of interest of what the source shows; nothing when it shows nothing, or something odd."""
        image, registers = self._source(exposure), self._registers
        if image is None:
            return None
        shape = (registers.number("SensorHeight"), registers.number("SensorWidth"))
        if image.shape != shape or image.dtype != np.uint8:
            self._note(f"image source gave {image.dtype} {image.shape}, not uint8 {shape}: nothing sent")
            return None
        self._adapt(float(image[::8, ::8].mean()), exposure)
        top, left = registers.number("OffsetY"), registers.number("OffsetX")
        return self._spoilt(
            image[top : top + registers.number("Height"), left : left + registers.number("Width")]
        )

    def _spoilt(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
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
        """Move exposure time or gain towards the target; `Once` is done as soon as it is near."""
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
