"""What every live rig has in `[rig]`: places of cameras, a light gate, the fall, the exposure.

The trigger delay of the cameras is not a setting: it follows from the height of the fall.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
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
from service.bundling.window import BundlingParameters

PortGate = TypeVar("PortGate", SerialGateSettings, ModemLineSettings)


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
    delay_outside_ms: float = 0.0  # part of the delay that gate or timer make, not the cameras
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
        if not 0 <= self.delay_outside_ms <= self.trigger_delay_ms:
            raise ValueError(
                f"delay_outside_ms must be in 0..{self.trigger_delay_ms:.1f}, the whole delay from gate to exposure,"
                f" not {self.delay_outside_ms:g}"
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
    def camera_delay_ms(self) -> float:
        """Return the part of the trigger delay that the cameras make."""
        return self.trigger_delay_ms - self.delay_outside_ms

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

    def bundling_for(self, bundling: BundlingParameters) -> BundlingParameters:
        """Return the parameters, with a dead time of at least `busy_ms` if the gate has a clock of its own."""
        if self.gate.modem_line is not None:
            return bundling
        return replace(bundling, dead_time_ms=max(bundling.dead_time_ms, self.busy_ms))

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
            gate_settings={**document["gate"], "speed_at_gate_mm_s": self.fall.speed_at_gate_mm_s},
            fall=self.fall,
        )

    @property
    def optical_settings(self) -> list[Any]:
        """Return the settings that change what the cameras see, as JSON has them."""
        document = self._document()
        return [document[name] for name in self.OPTICAL]

    def _document(self) -> dict[str, Any]:
        return dict(TypeAdapter(type(self)).dump_python(self, mode="json"))
