"""From the description of a rig to its devices; the one place that knows every backend."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.cameras.faulty import FaultyCamera
from drivers.cameras.replay import ReplayCamera
from drivers.faults import FaultPlan
from drivers.gates.faulty import FaultyGate
from drivers.gates.replay import ReplayGate
from drivers.interfaces import Camera, LightGate
from drivers.recording import open_recording
from drivers.replay_belt import Pace, ReplayBelt
from pipeline.frames import CameraId


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplayBackend:
    """A recording instead of devices."""

    recording: Path
    pace: Pace = "recorded"
    speed: float = 1.0  # of the recorded pace
    loop: bool = False
    faults: FaultPlan | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Devices:
    """A rig's devices, not yet opened."""

    cameras: Mapping[CameraId, Camera]  # in page order
    gate: LightGate
    clock: Callable[[], int] = time.monotonic_ns
    """What `received_ns` is read from."""
    belt: ReplayBelt | None = None
    """Grants permits and tells what was skipped, in replay."""


def build_devices(backend: ReplayBackend) -> Devices:
    """The devices of a backend.

    Raises
    ------
    RecordingError
        The recording to replay cannot be opened.
    """
    recording = open_recording(backend.recording)
    belt = ReplayBelt(recording, pace=backend.pace, speed=backend.speed, loop=backend.loop)
    cameras: dict[CameraId, Camera] = {camera: ReplayCamera(camera, belt) for camera in recording.camera_ids}
    gate: LightGate = ReplayGate(belt)
    if plan := backend.faults:
        cameras = {camera: FaultyCamera(device, plan) for camera, device in cameras.items()}
        # a swallowed trigger becomes no bundle, so nobody would give its permit back
        gate = FaultyGate(gate, plan, on_swallowed=belt.permit)
    return Devices(cameras=cameras, gate=gate, clock=belt.clock, belt=belt)
