"""`[rig]` of the configuration: a recording that is replayed, or cameras and a light gate."""

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Discriminator, Tag

from drivers.cameras.genicam import (
    HOST_SOURCES,
    Feature,
    GigeCameraSettings,
    action_features,
    exposure_features,
    strobe_features,
    strobe_line,
    trigger_features,
)
from drivers.cameras.host_trigger import ActionKeys
from drivers.factory import AravisBackend, Devices, ReplayBackend
from drivers.files.recording import RecordingSource
from pipeline.rig.cameras import RigCalibration
from service.base.paths import ConfiguredPath
from service.base.schema import require_ranges
from service.bundling.window import BundlingParameters, BundlingSettings
from service.configuration.camera_wire import (
    BUFFER_BYTES,
    LINK_BYTES_S,
    PACKET_BYTES,
    UPLINK_BYTES_S,
    CameraWire,
)
from service.configuration.live_rig import DelayMaker, LiveRigSettings, Place

SOURCE = re.compile(r"[A-Z][A-Za-z0-9_]{1,63}")
"""Name of an entry of TriggerSource."""


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
        require_ranges(self, speed=(0.01, 100))
        if self.pace == "fast" and self.speed != 1.0:
            raise ValueError('speed scales the recorded pace and means nothing with pace = "fast"')

    @property
    def calibration_path(self) -> Path:
        return self.calibration or self.recording / "rig.json"

    def bundling_for(self, bundling: BundlingSettings) -> BundlingParameters:
        return bundling.over(BundlingParameters())

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
            fall=recording.fall,
        )

    @property
    def optical_settings(self) -> None:
        """Return None: in replay the background comes from the recording alone."""
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPlace(Place):
    """The GigE camera in one place of the rig; it must match everything that is given here."""

    address: str | None = None
    user_name: str | None = None
    trigger: str | None = None  # input of this camera, where it has another name than in the others
    features: tuple[Feature, ...] = ()  # of this camera, written after those of all cameras


@dataclass(frozen=True, slots=True, kw_only=True)
class AravisRigSettings(LiveRigSettings):
    """GigE Vision cameras that a light gate triggers."""

    OPTICAL = ("cameras", "exposure_us", "flash_us", "strobe_line", "gain_db", "features")

    backend: Literal["aravis"]
    cameras: tuple[CameraPlace, ...]
    trigger: str = "Line1"  # as the cameras name it; "software" or "action": this machine triggers them
    trigger_activation: Literal["RisingEdge", "FallingEdge"] = "RisingEdge"
    action: ActionKeys = field(default_factory=ActionKeys)
    strobe_line: str | None = None  # output of the cameras that fires the light panels
    gain_db: float = 0.0
    features: tuple[Feature, ...] = ()  # further GenICam features of all cameras, written in this order

    interfaces: tuple[str, ...] = ()  # this machine's addresses towards the cameras; all of them if empty
    packet_size_bytes: int | Literal["negotiate"] = PACKET_BYTES
    packet_delay_ns: int = 0
    throughput_limit_bytes_s: int | None = None
    receive_buffer_bytes: int = 4 << 20
    link_bytes_s: float = LINK_BYTES_S  # of each camera
    uplink_bytes_s: float = UPLINK_BYTES_S  # of this machine
    switch_buffer_bytes: int = BUFFER_BYTES  # for packets that wait for the uplink

    def __post_init__(self) -> None:
        LiveRigSettings.__post_init__(self)
        require_ranges(
            self, link_bytes_s=(1e6, 1e12), uplink_bytes_s=(1e6, 1e12), switch_buffer_bytes=(1 << 14, 1 << 40)
        )
        if self.trigger in ("software", "action") and self.delay_is_made_by is not DelayMaker.CAMERA:
            raise ValueError(
                f'delay: this machine triggers the cameras ({self.trigger}): nothing but they can make it ("camera")'
            )
        if self.trigger not in ("software", "action"):
            _require_source("trigger", self.trigger)
        for place in self.cameras:
            if place.trigger is not None:
                _require_source(f"cameras: trigger of {place.id}", place.trigger)
                if self.trigger in ("software", "action"):
                    raise ValueError(
                        f"cameras: trigger of {place.id}: this machine triggers all cameras ({self.trigger})"
                    )
            if self.strobe_line == (source := place.trigger or self.trigger):
                raise ValueError(f"strobe_line is an output: it cannot be {source}, the input of trigger")
        self.require_unique("address", "user_name")
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
            gate_delay_us=self.gate_delay_us,
            interfaces=self.interfaces,
            fired_by=self._fired_by,
            is_simulated=self.is_simulated,
        )

    def wire_for(self, calibration: RigCalibration, *, negotiated_bytes: int = 1500) -> CameraWire:
        """Return the wire of the images, with `negotiated_bytes` for packets whose size is negotiated."""
        sizes_px = (camera.image_size_px for camera in calibration.cameras)
        return CameraWire(
            n_cameras=len(self.cameras),
            image_bytes=max(width * height for width, height in sizes_px),
            link_bytes_s=min(self.link_bytes_s, self.throughput_limit_bytes_s or self.link_bytes_s),
            uplink_bytes_s=self.uplink_bytes_s,
            buffer_bytes=self.switch_buffer_bytes,
            packet_bytes=negotiated_bytes
            if self.packet_size_bytes == "negotiate"
            else self.packet_size_bytes,
            packet_delay_ns=self.packet_delay_ns,
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
        source = {"software": "Software", "action": "Action1"}.get(
            self.trigger, place.trigger or self.trigger
        )
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
                    delay_us=round(self.camera_delay_ms * 1e3),
                ),
                *self.features,
                *place.features,
            ),
            packet_size_bytes=None if self.packet_size_bytes == "negotiate" else self.packet_size_bytes,
            packet_delay_ns=self.packet_delay_ns,
            throughput_limit_bytes_s=self.throughput_limit_bytes_s,
            receive_buffer_bytes=self.receive_buffer_bytes,
        )


def _require_source(where: str, source: str) -> None:
    """Raise `ValueError` unless it can be a trigger source; which of them a camera offers is known once it is open."""
    if not SOURCE.fullmatch(source) or source.startswith(HOST_SOURCES):
        raise ValueError(
            f'{where} must be a source as the cameras name it, such as "Line1", "Input1", "Hardware", "Timer1Active" or'
            f' "Counter1End", or "software" or "action", not {source!r}'
        )


def _backend(rig: Any) -> Any:
    return rig.get("backend", "replay") if isinstance(rig, dict) else getattr(rig, "backend", None)


RigSettings = Annotated[
    Annotated[ReplayRigSettings, Tag("replay")] | Annotated[AravisRigSettings, Tag("aravis")],
    Discriminator(_backend),
]
BACKENDS = frozenset(get_args(kind)[1].tag for kind in get_args(get_args(RigSettings)[0]))
"""What `backend` can be, as the union has it."""
