"""`[rig]` of the configuration: a recording that is replayed, or cameras and a light gate.

The trigger delay of the cameras is not a setting: it follows from the height of the fall.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args

from pydantic import AfterValidator, Discriminator, Tag, TypeAdapter, ValidationInfo

from drivers.cameras.genicam import (
    Feature,
    GigeCameraSettings,
    action_features,
    exposure_features,
    strobe_features,
    strobe_line,
    trigger_features,
)
from drivers.cameras.host_trigger import ActionKeys
from drivers.factory import AravisBackend, Devices, GateDevice, LiveBackend, ReplayBackend
from drivers.files.recording import RecordingSource
from drivers.gates.gpio import GpioGateSettings
from drivers.gates.modem_line import ModemLineSettings
from drivers.gates.serial_gate import SerialGateSettings
from pipeline.fall import FALL_HEIGHT_MM, Fall, fall_time_ms, speed_mm_s
from pipeline.frames import CameraId
from pipeline.rig.cameras import RigCalibration
from service.base.configured_paths import ConfiguredPath, resolve_path
from service.bundling.parameters import BundlingParameters

PortGate = TypeVar("PortGate", SerialGateSettings, ModemLineSettings)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayRigSettings:
    """A recording that is replayed in the place of a rig."""

    recording: ConfiguredPath
    backend: Literal["replay"] = "replay"
    pace: Literal["recorded", "fast"] = "recorded"
    speed: float = 1.0  # factor on the recorded pace
    loop: bool = False
    calibration: ConfiguredPath | None = None  # rig file; default: the recording's own

    def __post_init__(self) -> None:
        if not 0.01 <= self.speed <= 100:
            raise ValueError(f"speed must be in 0.01..100, not {self.speed:g}")
        if self.pace == "fast" and self.speed != 1.0:
            raise ValueError('speed scales the recorded pace and means nothing with pace = "fast"')

    @property
    def calibration_path(self) -> Path:
        return self.calibration or self.recording / "rig.json"

    def bundling_for(self, bundling: BundlingParameters) -> BundlingParameters:
        return bundling

    def backend_for(self, calibration: RigCalibration) -> ReplayBackend:
        return ReplayBackend(recording=self.recording, pace=self.pace, speed=self.speed, loop=self.loop)

    def describe(self) -> dict[str, Any]:
        """Describe the source of the stones, for the record of the session in the store."""
        return {"recording": str(self.recording)}

    def source(self, devices: Devices, rig: RigCalibration) -> RecordingSource:
        """Return the description of the rig for recordings of this replay: that of the replayed recording."""
        assert devices.belt is not None  # noqa: S101 - every replay has one
        recording = devices.belt.recording
        return RecordingSource(
            camera_ids=tuple(devices.cameras),
            rig=rig,
            is_simulated=devices.is_simulated,
            camera_settings=recording.document.get("camera_settings", {}),
            gate_settings=recording.document.get("gate_settings", {}),
            fall=Fall(speed_at_gate_mm_s=recording.speed_at_gate_mm_s),
        )

    @property
    def optical_settings(self) -> None:
        """Return None: in replay the background comes from the recording alone."""
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A place of the rig, and the camera in it."""

    id: CameraId
    serial: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPlace(Place):
    """The GigE camera in one place of the rig; it must match everything that is given here."""

    address: str | None = None
    user_name: str | None = None
    features: tuple[Feature, ...] = ()  # of this camera, written after those of all cameras


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
    start_above_gate_mm: float = (
        0.0  # height of the stone's lowest point above the beam when it starts from rest
    )
    delay_correction_ms: float = 0.0  # measured; negative for the latency of gate and cameras
    exposure_us: float = 20.0
    flash_us: float | None = (
        None  # light of one flash, if shorter than the exposure; only checked, set nowhere
    )
    trigger_skew_us: float = 1.0  # between cameras; of a wired trigger next to none
    max_blur_px: float = 1.5

    def __post_init__(self) -> None:
        if not self.cameras:
            raise ValueError("cameras must not be empty")
        _require_ranges(
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
        self._require_unique("id", "serial")

    def _require_unique(self, *names: str) -> None:
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
    def busy_ms(self) -> float:
        """Return the time from an edge to the end of its exposure, during which cameras ignore further edges."""
        return self.trigger_delay_ms + self.exposure_us / 1e3

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


@dataclass(frozen=True, slots=True, kw_only=True)
class AravisRigSettings(LiveRigSettings):
    """GigE Vision cameras that a light gate triggers."""

    OPTICAL = ("cameras", "exposure_us", "flash_us", "strobe_line", "gain_db", "features")

    backend: Literal["aravis"]
    cameras: tuple[CameraPlace, ...]
    trigger: str = "Line1"  # input of the cameras; "software" or "action": this machine triggers them
    trigger_activation: Literal["RisingEdge", "FallingEdge"] = "RisingEdge"
    action: ActionKeys = field(default_factory=ActionKeys)
    strobe_line: str | None = None  # output of the cameras that fires the light panels
    gain_db: float = 0.0
    features: tuple[Feature, ...] = ()  # further GenICam features of all cameras, written in this order

    interfaces: tuple[str, ...] = ()  # this machine's addresses towards the cameras; all of them if empty
    packet_size_bytes: int | Literal["negotiate"] = 8192
    packet_delay_ns: int = 0
    throughput_limit_bytes_s: int | None = None
    receive_buffer_bytes: int = 4 << 20
    link_bytes_s: float = 125e6  # of each camera: 1 Gb/s
    uplink_bytes_s: float = 2.5e9  # of this machine: 2 x 10 Gb/s

    def __post_init__(self) -> None:
        LiveRigSettings.__post_init__(self)
        _require_ranges(self, link_bytes_s=(1e6, 1e12), uplink_bytes_s=(1e6, 1e12))
        if not (self.trigger in ("software", "action") or self.trigger.startswith("Line")):
            raise ValueError(
                f'trigger must be an input such as "Line1", "software" or "action", not {self.trigger!r}'
            )
        if self.strobe_line == self.trigger:
            raise ValueError(f"strobe_line is an output: it cannot be {self.trigger}, the input of trigger")
        self._require_unique("address", "user_name")
        for camera in self.cameras:
            try:
                self._camera(camera, (1, 1))
            except ValueError as err:
                raise ValueError(f"cameras: {err}") from None

    @property
    def has_flash(self) -> bool:
        """True when an output of a camera fires the light, or `flash_us` says that it flashes."""
        return self.flash_us is not None or any(
            strobe_line(camera.features) for camera in self.sought_cameras()
        )

    def backend_for(self, calibration: RigCalibration) -> AravisBackend:
        sizes_px = {camera.id: camera.image_size_px for camera in calibration.cameras}
        return AravisBackend(
            cameras=tuple(self._camera(camera, sizes_px[camera.id]) for camera in self.cameras),
            gate=self.gate.device,
            interfaces=self.interfaces,
            fired_by=self._fired_by,
            is_simulated=self.is_simulated,
        )

    def sought_cameras(self) -> tuple[GigeCameraSettings, ...]:
        """Return the cameras as `find_camera` looks for them; it needs no rig file, which has the image sizes."""
        return tuple(
            replace(self._camera(place, (1, 1)), may_be_simulated=self.is_simulated) for place in self.cameras
        )

    @property
    def _fired_by(self) -> ActionKeys | Literal["software"] | None:
        if self.trigger == "software":
            return "software"
        return self.action if self.trigger == "action" else None

    def _camera(self, place: CameraPlace, image_size_px: tuple[int, int]) -> GigeCameraSettings:
        keys = {name: getattr(self.action, name) for name in ("device_key", "group_key", "group_mask")}
        source = {"software": "Software", "action": "Action1"}.get(self.trigger, self.trigger)
        return GigeCameraSettings(
            id=place.id,
            serial=place.serial,
            address=place.address,
            user_name=place.user_name,
            interfaces=self.interfaces,
            image_size_px=image_size_px,
            features=(
                *exposure_features(exposure_us=self.exposure_us, gain_db=self.gain_db),
                *(strobe_features(line=self.strobe_line) if self.strobe_line else ()),
                *(action_features(**keys) if self.trigger == "action" else ()),
                *trigger_features(
                    source=source,
                    activation=self.trigger_activation,
                    delay_us=round(self.trigger_delay_ms * 1e3),
                ),
                *self.features,
                *place.features,
            ),
            packet_size_bytes=None if self.packet_size_bytes == "negotiate" else self.packet_size_bytes,
            packet_delay_ns=self.packet_delay_ns,
            throughput_limit_bytes_s=self.throughput_limit_bytes_s,
            receive_buffer_bytes=self.receive_buffer_bytes,
        )


def _require_ranges(settings: LiveRigSettings, **ranges: tuple[float, float]) -> None:
    for name, (low, high) in ranges.items():
        if not low <= getattr(settings, name) <= high:
            raise ValueError(f"{name} must be in {low:g}..{high:g}, not {getattr(settings, name):g}")


def _backend(rig: Any) -> Any:
    return rig.get("backend", "replay") if isinstance(rig, dict) else getattr(rig, "backend", None)


RigSettings = Annotated[
    Annotated[ReplayRigSettings, Tag("replay")] | Annotated[AravisRigSettings, Tag("aravis")],
    Discriminator(_backend),
]
BACKENDS = frozenset(get_args(kind)[1].tag for kind in get_args(get_args(RigSettings)[0]))
"""What `backend` can be."""
