"""The simulated rig: GigE Vision cameras, a light gate and a belt around one recording, in one process.

The belt lets a stone of the recording close the gate's beam; the gate tells its host and pulses Line1 of all
cameras; each waits its trigger delay, exposes, and sends what the recording has of that stone.
"""

import ipaddress
import random
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from drivers.files.recording import Recording
from drivers.gige_simulator.belt import Belt
from drivers.gige_simulator.camera import CameraDesign, SimulatedCamera
from drivers.gige_simulator.counters import Counters
from drivers.gige_simulator.gate import GateDesign, SimulatedGate
from drivers.gige_simulator.hopper import Fall, Hopper, read_fall
from drivers.gige_simulator.request_socket import request_socket
from drivers.gige_simulator.rig_requests import RigRequests, counters_of
from drivers.gige_simulator.sources import SIGHT_MS, Images, Scene
from drivers.gige_simulator.uplink import Uplink
from pipeline.frames import BundleKind, CameraId

TRIGGER_LINE = "Line1"
MAX_EMPTY = 5
"""Exposures of the empty rig that are kept in memory, to be seen in turn where no stone is."""
EXPOSURE_US = 20.0
"""Of a recording that does not say; the design's."""
LINGER_NS = 1_500_000_000
"""After the last exposure: for frames on the wire and packets that the host wants again."""
MAX_CLOCK_OFFSET_NS = 10**13
MAX_CLOCK_DRIFT_PPM = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RigDesign:
    """What a simulated rig is."""

    gate_link: Path  # the host's end of the gate's serial line
    control: Path | None = None  # Unix socket for faults at run time
    first_address: str = "127.0.0.2"  # of consecutive ones, a camera each
    n_cameras: int | None = None  # the first of the recording; None: all
    legacy_every: int = 4  # so often a camera speaks the older dialect; 0: none
    rate_hz: float = 4.0
    is_looping: bool = False
    fall_ms: float = 247.35  # from the gate to the middle of the rig: 0.3 m
    sight_ms: float = SIGHT_MS  # before and after that a stone is seen
    exposure_us: float | None = None  # at which images are as recorded; None: the recording's
    gain_db: float = 0.0
    uplink_bytes_s: float | None = None  # of the switch all cameras are at; None: faster than all of them
    uplink_buffer_bytes: int = 2 << 20  # that the switch has for it
    seed: int = 0


class SimulatedRig:
    """Powered from `open` to `close`; the belt stands until it is started.

    Attributes
    ----------
    cameras, gate, belt
        To be examined and broken while they run.
    """

    def __init__(self, design: RigDesign, recording: Recording) -> None:
        scene = Scene(
            empty=_empty_rig(recording),
            fall_ns=round(design.fall_ms * 1e6),
            exposure_us=design.exposure_us or _recorded_exposure_us(recording),
            gain_db=design.gain_db,
            sight_ms=design.sight_ms,
            seed=design.seed,
        )
        self._scene = scene
        uplink = None
        if design.uplink_bytes_s is not None:
            uplink = Uplink(rate_bytes_s=design.uplink_bytes_s, buffer_bytes=design.uplink_buffer_bytes)
        self.cameras: Mapping[CameraId, SimulatedCamera] = {
            camera.id: SimulatedCamera(camera, scene.source_of(camera.id), uplink=uplink)
            for camera in _camera_designs(design, recording)
        }
        dice = random.Random(f"{design.seed}/gate")  # noqa: S311 - nothing secret
        self.gate = SimulatedGate(
            GateDesign(
                link=design.gate_link,
                clock_drift_ppm=dice.uniform(-MAX_CLOCK_DRIFT_PPM, MAX_CLOCK_DRIFT_PPM),
                seed=design.seed,
            ),
            pulse=self._pulse,
            empty_rig=scene.enter_empty,
        )
        hopper = Hopper(recording, is_looping=design.is_looping)
        self.belt = Belt(hopper, self._drop, rate_hz=design.rate_hz)
        self._control = design.control
        self._requests = RigRequests(cameras=self.cameras, gate=self.gate, belt=self.belt)
        self._running = ExitStack()
        self._last_edge_ns = 0
        self._linger_ns = round(design.fall_ms * 1e6) + LINGER_NS

    def open(self) -> None:
        """Power everything on.

        Raises
        ------
        CameraUnavailableError, GateUnavailableError
            An address is taken; the gate's link cannot be made.
        OSError
            The control socket cannot be made.
        """
        with ExitStack() as running:
            for camera in self.cameras.values():
                camera.start()
                running.callback(camera.stop)
            self.gate.open()
            running.callback(self.gate.close)
            self.belt.open()
            running.callback(self.belt.close)
            if self._control is not None:
                running.enter_context(request_socket(self._control, self._requests.answer))
            self._running = running.pop_all()

    def close(self) -> None:
        self._running.close()

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def is_over(self) -> bool:
        """Whether everything fell and every image was sent, a while ago: the host may want packets again."""
        if not self.belt.ended.is_set() or time.monotonic_ns() < self._last_edge_ns + self._linger_ns:
            return False
        return all(_is_sent(camera.counters) for camera in self.cameras.values())

    @property
    def is_ready(self) -> bool:
        """Whether a host has opened the gate and all cameras are acquiring."""
        return self.gate.is_opened and all(camera.is_acquiring for camera in self.cameras.values())

    def counters(self) -> dict[str, Any]:
        """What belt, gate and cameras counted."""
        return counters_of(self.cameras, self.gate, self.belt)

    def _drop(self, fall: Fall, edge_ns: int) -> None:
        self._last_edge_ns = edge_ns
        self._scene.enter(edge_ns, fall.images)
        if fall.is_empty:
            self.gate.test_pulse(edge_ns)
        else:
            self.gate.interrupt(edge_ns, fall.pulse_width_ns)

    def _pulse(self, at_ns: int) -> None:
        for camera in self.cameras.values():
            camera.line(TRIGGER_LINE, at_ns)


def _is_sent(counters: Counters) -> bool:
    done = counters.frames + counters.torn + counters.swallowed + counters.unexposed + counters.aborted
    return counters.exposures == done


def _camera_designs(design: RigDesign, recording: Recording) -> Iterator[CameraDesign]:
    """One camera after the other, each with a clock of its own, some of the older dialect."""
    first = ipaddress.IPv4Address(design.first_address)
    known = {camera.id: camera.serial for camera in recording.rig.cameras} if recording.rig else {}
    for index, camera in enumerate(recording.camera_ids[: design.n_cameras]):
        dice = random.Random(f"{design.seed}/{camera}")  # noqa: S311 - nothing secret
        yield CameraDesign(
            id=camera,
            address=str(first + index),
            serial=known.get(camera) or f"SIM{index + 1:04d}",
            user_name=camera,
            dialect="legacy" if design.legacy_every and (index + 1) % design.legacy_every == 0 else "sfnc",
            image_size_px=recording.image_size_px,
            clock_offset_ns=dice.randrange(MAX_CLOCK_OFFSET_NS),
            clock_drift_ppm=dice.uniform(-MAX_CLOCK_DRIFT_PPM, MAX_CLOCK_DRIFT_PPM),
            seed=dice.randrange(1 << 31),
        )


def _empty_rig(recording: Recording) -> list[Images]:
    """What the cameras see where no stone is: dark, if nobody recorded it."""
    headers = [header for header in recording.headers if header.kind is BundleKind.BACKGROUND]
    if seen := [read_fall(header, recording).images for header in headers[:MAX_EMPTY]]:
        return seen
    width_px, height_px = recording.image_size_px
    return [dict.fromkeys(recording.camera_ids, np.zeros((height_px, width_px), np.uint8))]


def _recorded_exposure_us(recording: Recording) -> float:
    settings = recording.document.get("camera_settings")
    exposure_us = settings.get("exposure_us") if isinstance(settings, dict) else None
    return float(exposure_us) if isinstance(exposure_us, int | float) and exposure_us > 0 else EXPOSURE_US
