"""Build the devices of a rig from its description; the one module that knows every backend."""

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from drivers.camera_process.camera import RemoteCamera
from drivers.camera_process.messages import CameraSettings
from drivers.camera_process.process import CameraProcess
from drivers.cameras.finding import are_simulated
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
from drivers.interfaces import Camera, CameraProcessStatus, LightGate
from drivers.replay.belt import Pace, ReplayBelt
from drivers.replay.camera import ReplayCamera
from drivers.replay.gate import ReplayGate
from pipeline.frames import CameraId

log = logging.getLogger(__name__)

ARAVIS = "drivers.cameras.aravis:AravisCamera"
GateDevice = SerialGateSettings | ModemLineSettings | GpioGateSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayBackend:
    """A recording played in the place of devices."""

    recording: Path
    pace: Pace = "recorded"
    speed: float = 1.0  # times the recorded pace
    loop: bool = False
    faults: FaultPlan | None = None  # injected by the faulty twins


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveBackend:
    """Cameras, whose driver runs in a process of its own, and a light gate."""

    cameras: tuple[CameraSettings, ...]
    gate: GateDevice
    driver: str
    """Makes the cameras in their process; by name, as the daemon does not load their library."""
    gate_delay_us: int = (
        0  # from the edge to the gate's pulse to the cameras; only a serial gate can make one
    )
    fired_by: ActionKeys | Literal["software"] | None = None  # None: the cameras are wired to the gate
    interfaces: tuple[str, ...] = ()  # IPv4 addresses of this machine, towards the cameras
    is_simulated: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AravisBackend(LiveBackend):
    """GigE cameras and a light gate."""

    cameras: tuple[GigeCameraSettings, ...]
    driver: str = ARAVIS


@dataclass(frozen=True, slots=True, kw_only=True)
class Devices:
    """The devices of a rig, not yet opened."""

    cameras: Mapping[CameraId, Camera]  # in page order
    gate: LightGate
    clock: Callable[[], int] = time.monotonic_ns
    """The clock of `received_ns`, in ns."""
    belt: ReplayBelt | None = None
    """Plays the recording, in replay; the paces `stepped` and `fast` need its permits."""
    is_simulated: bool = False
    """Whether the images are synthetic."""
    close: Callable[[], None] = lambda: None
    """To be called at the end, when all devices are closed; may take as long as a camera takes to close."""
    camera_process: Callable[[], CameraProcessStatus] = CameraProcessStatus
    """State of the process that the cameras' library runs in, if there is one; never blocks."""


def build_devices(backend: ReplayBackend | LiveBackend) -> Devices:
    """Return the devices of a backend.

    Raises
    ------
    RecordingError
        The recording to replay cannot be opened.
    """
    if isinstance(backend, LiveBackend):
        return _live_devices(backend)
    recording = open_recording(backend.recording)
    belt = ReplayBelt(recording, pace=backend.pace, speed=backend.speed, loop=backend.loop)
    cameras: dict[CameraId, Camera] = {camera: ReplayCamera(camera, belt) for camera in recording.camera_ids}
    gate: LightGate = ReplayGate(belt)
    if plan := backend.faults:
        cameras = {camera: FaultyCamera(device, plan) for camera, device in cameras.items()}
        # a swallowed trigger becomes no bundle, whose end would give its permit back
        gate = FaultyGate(gate, plan, on_swallowed=belt.permit)
    return Devices(
        cameras=cameras, gate=gate, clock=belt.clock, belt=belt, is_simulated=recording.is_simulated
    )


def _live_devices(backend: LiveBackend) -> Devices:
    is_simulated = backend.is_simulated
    if isinstance(backend, AravisBackend):
        if not is_simulated and are_simulated(backend.cameras):
            log.warning("the cameras are simulated: so are all results, and they are marked")
            is_simulated = True
        allowed = [replace(settings, may_be_simulated=is_simulated) for settings in backend.cameras]
        backend = replace(backend, cameras=tuple(allowed))
    process = CameraProcess(backend.driver)
    cameras = {settings.id: RemoteCamera(settings, process) for settings in backend.cameras}
    gate = build_gate(backend.gate, backend.gate_delay_us)
    match backend.fired_by:
        case "software":
            gate = FiringGate(gate, SoftwareTrigger([camera.software_trigger for camera in cameras.values()]))
        case ActionKeys() as keys:
            gate = FiringGate(gate, ActionTrigger(keys, backend.interfaces))
    return Devices(
        cameras=cameras,
        gate=gate,
        is_simulated=is_simulated,
        close=process.close,
        camera_process=process.status,
    )


def build_gate(device: GateDevice, delay_us: int = 0) -> LightGate:
    """Return the light gate alone, not yet opened; `delay_us` is from an edge to its pulse, of a serial gate."""
    match device:
        case SerialGateSettings():
            return SerialGate(device, delay_us=delay_us)
        case ModemLineSettings():
            return ModemLineGate(device)
        case GpioGateSettings():
            return GpioGate(device)
