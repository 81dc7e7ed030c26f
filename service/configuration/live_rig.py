"""What every live rig has in `[rig]`: places of cameras, a light gate, the fall, the exposure.

The delay from gate to exposure is not a setting: it follows from the height of the fall. What makes it is one.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import AfterValidator, TypeAdapter, ValidationInfo

from drivers.factory import Devices, GateDevice, LiveBackend
from drivers.files.recording import RecordingSource
from drivers.gates.gpio import GpioGateSettings
from drivers.gates.modem_line import ModemLineSettings
from drivers.gates.serial_gate import SerialGateSettings
from pipeline.fall import FALL_HEIGHT_MM, Fall, fall_time_ms, speed_mm_s
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from service.base.paths import ConfiguredPath, resolve_path
from service.base.schema import require_ranges
from service.bundling.window import MAX_WINDOW_SHARE, TRANSFER_MS, BundlingParameters, BundlingSettings

QUICK_BUSY_MS = 50.0
"""A rig whose cameras are busy for less takes the next stone while others are in the air."""
QUICK_DEAD_MS = 25.0
"""Least time between two triggers of cameras that do not wait: a frame takes 11 ms on the wire."""
QUICK_WINDOW_MS = 10.0
"""Half width of the window of such frames; of those that come later, clock and counter of the camera decide."""
UNDATED_DEAD_MS, UNDATED_WINDOW_MS = 80.0, 35.0
"""The same where the gate has no clock: a polled line is dated late when the machine is busy."""
PortGate = TypeVar("PortGate", SerialGateSettings, ModemLineSettings)


class DelayMaker(StrEnum):
    """What makes the delay from the edge of the light gate to the exposure."""

    CAMERA = "camera"
    """The cameras, by their TriggerDelay; they are busy meanwhile."""
    GATE = "gate"
    """A serial gate, which is set over its line and can let several pulses wait."""
    TIMER = "timer"
    """A timer of the cameras' own, or a delay generator in the trigger line; set by hand."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A place of the rig, and the camera in it."""

    id: CameraId
    serial: str | None = None


def _resolve_port(gate: PortGate, info: ValidationInfo) -> PortGate:
    return replace(gate, port=str(resolve_path(Path(gate.port), info)))


@dataclass(frozen=True, slots=True, kw_only=True)
class GateSettings:
    """The light gate: exactly one of the three kinds."""

    serial: Annotated[SerialGateSettings, AfterValidator(_resolve_port)] | None = None
    modem_line: Annotated[ModemLineSettings, AfterValidator(_resolve_port)] | None = None
    gpio: GpioGateSettings | None = None

    def __post_init__(self) -> None:
        if sum(kind is not None for kind in (self.serial, self.modem_line, self.gpio)) != 1:
            raise ValueError(
                "exactly one of [rig.gate.serial], [rig.gate.modem_line], [rig.gate.gpio] is needed"
            )

    @property
    def device(self) -> GateDevice:
        device = self.serial or self.modem_line or self.gpio
        assert device is not None  # noqa: S101 - __post_init__ has seen to it
        return device


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveRigSettings(ABC):
    """Cameras that a light gate triggers; a class beneath it is a kind of cameras, with the settings of its own."""

    OPTICAL: ClassVar[tuple[str, ...]] = ("cameras", "exposure_us", "flash_us")
    """Settings that change what the cameras see."""

    backend: str
    calibration: ConfiguredPath  # rig file
    cameras: tuple[Place, ...]
    gate: GateSettings
    is_simulated: bool = False  # results are marked as synthetic

    fall_height_mm: float = FALL_HEIGHT_MM  # from the beam of the gate to the centre of the rig
    start_above_gate_mm: float = 0.0  # of the stone's lowest point over the beam when it starts from rest
    delay_correction_ms: float = 0.0  # measured; negative for the latency of gate and cameras
    delay: DelayMaker | None = None  # default: camera; timer where delay_outside_ms is set
    delay_outside_ms: float | None = None  # part of the delay that gate or timer make; default: all of it
    exposure_us: float = 20.0
    flash_us: float | None = None  # of one flash, if shorter than the exposure; only checked, set nowhere
    trigger_skew_us: float = 1.0  # between cameras; of a wired trigger next to none
    max_blur_px: float = 1.5

    def __post_init__(self) -> None:
        if not self.cameras:
            raise ValueError("cameras must not be empty")
        require_ranges(
            self,
            fall_height_mm=(10, 10_000),
            start_above_gate_mm=(0, 10_000),
            delay_correction_ms=(-1_000, 1_000),
            exposure_us=(1, 100_000),
            trigger_skew_us=(0, 10_000),
            max_blur_px=(0.01, 100),
        )
        if self.flash_us is not None and not 0.1 <= self.flash_us <= self.exposure_us:
            raise ValueError(f"flash_us must be in 0.1..exposure_us, not {self.flash_us:g}")
        if self.trigger_delay_ms <= 0:
            raise ValueError(f"delay_correction_ms leaves a trigger delay of {self.trigger_delay_ms:.1f} ms")
        outside_ms = self.delay_outside_ms or 0.0
        if not 0 <= outside_ms <= self.trigger_delay_ms:
            raise ValueError(
                f"delay_outside_ms must be in 0..{self.trigger_delay_ms:.1f}, the whole delay from gate to exposure,"
                f" not {outside_ms:g}"
            )
        if self.delay is DelayMaker.CAMERA and outside_ms:
            raise ValueError(
                f'delay = "camera" leaves nothing outside, but delay_outside_ms is {outside_ms:g}'
            )
        if self.delay is DelayMaker.GATE and self.gate.serial is None:
            raise ValueError(
                'delay = "gate" needs [rig.gate.serial]: a sensor on a modem line or a GPIO line makes no delay'
            )
        self.require_unique("id", "serial")

    def require_unique(self, *names: str) -> None:
        """Raise `ValueError` when two cameras have the same value of a setting."""
        for name in names:
            values = [value for camera in self.cameras if (value := getattr(camera, name))]
            if twice := sorted({value for value in values if values.count(value) > 1}):
                raise ValueError(f"cameras: {name} {', '.join(twice)} is there twice")

    @abstractmethod
    def backend_for(self, calibration: RigCalibration) -> LiveBackend:
        """Return the devices, with the sizes of the images from the calibration."""

    @property
    def calibration_path(self) -> Path:
        return self.calibration

    @property
    def fall(self) -> Fall:
        """Return the fall from the gate to the centre of the rig."""
        return Fall(height_mm=self.fall_height_mm, speed_at_gate_mm_s=speed_mm_s(self.start_above_gate_mm))

    @property
    def trigger_delay_ms(self) -> float:
        """Return the time from the edge of the light gate to the exposure at the centre of the rig."""
        return fall_time_ms(self.fall.height_mm, self.fall.speed_at_gate_mm_s) + self.delay_correction_ms

    @property
    def delay_is_made_by(self) -> DelayMaker:
        """Return the maker of the delay, or of most of it."""
        return self.delay or (DelayMaker.TIMER if self.delay_outside_ms else DelayMaker.CAMERA)

    @property
    def outside_ms(self) -> float:
        """Return the part of the trigger delay that gate or timer make."""
        if self.delay_is_made_by is DelayMaker.CAMERA:
            return 0.0
        return self.trigger_delay_ms if self.delay_outside_ms is None else self.delay_outside_ms

    @property
    def gate_delay_us(self) -> int:
        """Return the delay that a serial gate is set to; 0 unless it makes one."""
        return round(self.outside_ms * 1e3) if self.delay_is_made_by is DelayMaker.GATE else 0

    @property
    def camera_delay_ms(self) -> float:
        """Return the part of the trigger delay that the cameras make; less than 1 us is none."""
        rest_ms = self.trigger_delay_ms - self.outside_ms
        return rest_ms if rest_ms >= 1e-3 else 0.0

    @property
    def exposed_ms(self) -> float:
        """Return the time from the edge of the light gate to the end of its exposure."""
        return self.trigger_delay_ms + self.exposure_us / 1e3

    @property
    def busy_ms(self) -> float:
        """Return the time from a camera's edge to the end of its exposure, during which it ignores further edges."""
        return self.camera_delay_ms + self.exposure_us / 1e3

    @property
    def has_flash(self) -> bool:
        """True when the light flashes."""
        return self.flash_us is not None

    def bundling_for(self, bundling: BundlingSettings) -> BundlingParameters:
        """Return the parameters, with a dead time of at least `busy_ms` if the gate has a clock of its own."""
        is_dated = self.gate.modem_line is None
        default = BundlingParameters()
        if self.delay in (DelayMaker.GATE, DelayMaker.TIMER) and self.busy_ms < QUICK_BUSY_MS:
            dead_ms, window_ms = UNDATED_DEAD_MS, UNDATED_WINDOW_MS
            if is_dated:
                dead_ms, window_ms = QUICK_DEAD_MS, QUICK_WINDOW_MS
            default = BundlingParameters(
                expected_delay_ms=self.exposed_ms + TRANSFER_MS,
                window_ms=window_ms,
                dead_time_ms=max(dead_ms, self.busy_ms, (bundling.window_ms or 0.0) / MAX_WINDOW_SHARE),
            )
        parameters = bundling.over(default)
        if not is_dated:
            return parameters
        return replace(parameters, dead_time_ms=max(parameters.dead_time_ms, self.busy_ms))

    def describe(self) -> dict[str, Any]:
        """Describe the source of the stones, for the record of the session in the store."""
        return {"cameras": [camera.id for camera in self.cameras], "gate": type(self.gate.device).__name__}

    def source(self, devices: Devices, rig: RigCalibration) -> RecordingSource:
        """Return the description of these devices for recordings."""
        document = self._document()
        return RecordingSource(
            camera_ids=tuple(devices.cameras),
            rig=rig,
            is_simulated=devices.is_simulated,
            camera_settings={name: value for name, value in document.items() if name != "gate"},
            gate_settings={
                **document["gate"],
                "fall_height_mm": self.fall.height_mm,
                "speed_at_gate_mm_s": self.fall.speed_at_gate_mm_s,
            },
            fall=self.fall,
        )

    @property
    def optical_settings(self) -> list[Any]:
        """Return the settings that change what the cameras see, as JSON has them."""
        document = self._document()
        return [document[name] for name in self.OPTICAL]

    def _document(self) -> dict[str, Any]:
        return dict(TypeAdapter(type(self)).dump_python(self, mode="json"))
