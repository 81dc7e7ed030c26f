"""From the description of a rig to its devices; the one place that knows every backend."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from drivers.cameras.aravis import AravisCamera
from drivers.cameras.genicam import GigeCameraSettings
from drivers.cameras.host_trigger import ActionKeys, ActionTrigger, SoftwareTrigger
from drivers.faulty.camera import FaultyCamera
from drivers.faulty.faults import FaultPlan
from drivers.faulty.gate import FaultyGate
from drivers.files.recording import open_recording
from drivers.gates.firing import FiringGate
from drivers.gates.gpio import GpioGate, GpioGateSettings
from drivers.gates.modem_line import ModemLineGate, ModemLineSettings
from drivers.gates.serial_gate import SerialGate, SerialGateSettings
from drivers.interfaces import Camera, LightGate
from drivers.replay.belt import Pace, ReplayBelt
from drivers.replay.camera import ReplayCamera
from drivers.replay.gate import ReplayGate
from pipeline.frames import CameraId

GateDevice = SerialGateSettings | ModemLineSettings | GpioGateSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayBackend:
    """A recording instead of devices."""

    recording: Path
    pace: Pace = "recorded"
    speed: float = 1.0  # of the recorded pace
    loop: bool = False
    faults: FaultPlan | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AravisBackend:
    """GigE cameras and a light gate."""

    cameras: tuple[GigeCameraSettings, ...]
    gate: GateDevice
    interfaces: tuple[str, ...] = ()  # of this machine, towards the cameras
    fired_by: ActionKeys | Literal["software"] | None = None  # None: by a wire from the gate
    is_simulated: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Devices:
    """A rig's devices, not yet opened."""

    cameras: Mapping[CameraId, Camera]  # in page order
    gate: LightGate
    clock: Callable[[], int] = time.monotonic_ns
    """What `received_ns` is read from."""
    belt: ReplayBelt | None = None
    """Grants permits and tells what was skipped, in replay."""
    is_simulated: bool = False
    """Whether the images are synthetic."""


def build_devices(backend: ReplayBackend | AravisBackend) -> Devices:
    """The devices of a backend.

    Raises
    ------
    RecordingError
        The recording to replay cannot be opened.
    """
    if isinstance(backend, AravisBackend):
        return _live(backend)
    recording = open_recording(backend.recording)
    belt = ReplayBelt(recording, pace=backend.pace, speed=backend.speed, loop=backend.loop)
    cameras: dict[CameraId, Camera] = {camera: ReplayCamera(camera, belt) for camera in recording.camera_ids}
    gate: LightGate = ReplayGate(belt)
    if plan := backend.faults:
        cameras = {camera: FaultyCamera(device, plan) for camera, device in cameras.items()}
        # a swallowed trigger becomes no bundle, so nobody would give its permit back
        gate = FaultyGate(gate, plan, on_swallowed=belt.permit)
    return Devices(
        cameras=cameras, gate=gate, clock=belt.clock, belt=belt, is_simulated=recording.is_simulated
    )


def _live(backend: AravisBackend) -> Devices:
    cameras = {settings.id: AravisCamera(settings) for settings in backend.cameras}
    gate = _gate(backend.gate)
    match backend.fired_by:
        case "software":
            gate = FiringGate(gate, SoftwareTrigger([camera.software_trigger for camera in cameras.values()]))
        case ActionKeys() as keys:
            gate = FiringGate(gate, ActionTrigger(keys, backend.interfaces))
    return Devices(cameras=cameras, gate=gate, is_simulated=backend.is_simulated)


def _gate(device: GateDevice) -> LightGate:
    match device:
        case SerialGateSettings():
            return SerialGate(device)
        case ModemLineSettings():
            return ModemLineGate(device)
        case GpioGateSettings():
            return GpioGate(device)
