"""The simulated rig: GigE Vision cameras, a light gate and a belt in one process, which replay one recording.

The belt lets a stone of the recording close the gate's beam; the gate reports it to the host and pulses a line of all
cameras, at once or after the delay that the host sets; a timer in that line may add another. Each camera waits for its
trigger delay, exposes, and sends the recorded image of that stone.
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
from drivers.gige_simulator.hopper import Drop, Hopper, read_fall
from drivers.gige_simulator.personalities import PERSONALITIES
from drivers.gige_simulator.request_socket import request_socket
from drivers.gige_simulator.rig_requests import RigRequests, counters_of
from drivers.gige_simulator.sources import SIGHT_MS, Images, Scene
from drivers.gige_simulator.uplink import Uplink
from pipeline.frames import BundleKind, CameraId

MAX_EMPTY = 5
"""How many exposures of the empty rig are kept in memory; they are seen in turn while no stone is in view."""
EXPOSURE_US = 20.0
"""Exposure time of a recording that does not give it."""
LINGER_NS = 1_500_000_000
"""Time after the last exposure for frames on the wire and packets that the host requests again."""
MAX_CLOCK_OFFSET_NS = 10**13
MAX_CLOCK_DRIFT_PPM = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RigDesign:
    """The properties of a simulated rig."""

    gate_link: Path  # the host's end of the gate's serial line
    control: Path | None = None  # path of the control socket, for requests at run time
    first_address: str = "127.0.0.2"  # of the first camera; the others have the addresses after it
    n_cameras: int | None = None  # how many of the recording's, from the first; None: all
    legacy_every: int = 4  # every so many cameras one speaks the older dialect; 0: none
    vendors: tuple[str, ...] = ()  # whose ways the cameras have, in turn; empty: the simulator's own
    gate_places: int = 8  # pulses that can wait in the gate; 0: it cannot make a delay
    timer_ms: float = 0.0  # delay of a generator in the line from gate to cameras
    rate_hz: float = 4.0
    is_looping: bool = False
    only_stones: bool = False  # the belt leaves out recorded exposures of the empty rig
    fall_ms: float = 247.35  # from the gate to the middle of the rig: 0.3 m
    sight_ms: float = SIGHT_MS  # a stone is seen so long before and after it passes the middle
    exposure_us: float | None = None  # at which images are as recorded; None: as recording.json says
    gain_db: float = 0.0  # at which images are as recorded
    strobe_line: str | None = None  # output of each camera that fires its light; None: the light is always on
    uplink_bytes_s: float | None = None  # shared by all cameras behind a switch; None: unlimited
    uplink_buffer_bytes: int = 512 << 10  # of the switch, as small ones have
    seed: int = 0


class SimulatedRig:
    """Powered from `open` to `close`; the belt stands until it is started.

    Attributes
    ----------
    cameras, gate, belt
        The parts, which can be examined and broken while they run.
    """

    def __init__(self, design: RigDesign, recording: Recording) -> None:
        scene = Scene(
            empty=_empty_rig(recording),
            fall_ns=round(design.fall_ms * 1e6),
            exposure_us=design.exposure_us or _recorded_exposure_us(recording),
            gain_db=design.gain_db,
            strobe_line=design.strobe_line,
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
                places=design.gate_places,
                seed=design.seed,
            ),
            pulse=self._pulse,
            empty_rig=scene.enter_empty,
        )
        hopper = Hopper(recording, is_looping=design.is_looping, only_stones=design.only_stones)
        self.belt = Belt(hopper, self._drop, rate_hz=design.rate_hz)
        self._control = design.control
        self._requests = RigRequests(cameras=self.cameras, gate=self.gate, belt=self.belt)
        self._running = ExitStack()
        self._timer_ns = round(design.timer_ms * 1e6)
        self._last_edge_ns = 0
        self._linger_ns = round(design.fall_ms * 1e6) + LINGER_NS

    def open(self) -> None:
        """Switch all parts on.

        Raises
        ------
        CameraUnavailableError
            The address of a camera is taken.
        GateUnavailableError
            The link of the gate's serial port cannot be made.
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
        """Whether all stones fell and all images were sent, long enough ago for requests to resend packets."""
        if not self.belt.ended.is_set() or time.monotonic_ns() < self._last_edge_ns + self._linger_ns:
            return False
        return all(_is_sent(camera.counters) for camera in self.cameras.values())

    @property
    def is_ready(self) -> bool:
        """Whether a host has opened the gate and all cameras are acquiring."""
        return self.gate.is_opened and all(camera.is_acquiring for camera in self.cameras.values())

    def counters(self) -> dict[str, Any]:
        """Return the counters of belt, gate and cameras."""
        return counters_of(self.cameras, self.gate, self.belt)

    def _drop(self, fall: Drop, edge_ns: int) -> None:
        self._last_edge_ns = edge_ns
        self._scene.enter(edge_ns, fall.images)
        if fall.is_empty:
            self.gate.test_pulse(edge_ns)
        else:
            self.gate.interrupt(edge_ns, fall.pulse_width_ns)

    def _pulse(self, at_ns: int) -> None:
        for camera in self.cameras.values():
            camera.line(at_ns=at_ns + self._timer_ns)


def _is_sent(counters: Counters) -> bool:
    done = counters.frames + counters.torn + counters.swallowed + counters.unexposed + counters.aborted
    return counters.exposures == done


def _camera_designs(design: RigDesign, recording: Recording) -> Iterator[CameraDesign]:
    """Yield the design of each camera, with a clock of its own, some with the older dialect."""
    first = ipaddress.IPv4Address(design.first_address)
    known = {camera.id: camera.serial for camera in recording.rig.cameras} if recording.rig else {}
    vendors = [PERSONALITIES[vendor] for vendor in design.vendors]
    for index, camera in enumerate(recording.camera_ids[: design.n_cameras]):
        dice = random.Random(f"{design.seed}/{camera}")  # noqa: S311 - nothing secret
        yield CameraDesign(
            id=camera,
            address=str(first + index),
            serial=known.get(camera) or f"SIM{index + 1:04d}",
            user_name=camera,
            personality=vendors[index % len(vendors)] if vendors else None,
            dialect="legacy" if design.legacy_every and (index + 1) % design.legacy_every == 0 else "sfnc",
            image_size_px=recording.image_size_px,
            clock_offset_ns=dice.randrange(MAX_CLOCK_OFFSET_NS),
            clock_drift_ppm=dice.uniform(-MAX_CLOCK_DRIFT_PPM, MAX_CLOCK_DRIFT_PPM),
            seed=dice.randrange(1 << 31),
        )


def _empty_rig(recording: Recording) -> list[Images]:
    """Return exposures of the empty rig; one black image for each camera if none was recorded."""
    headers = [header for header in recording.headers if header.kind is BundleKind.BACKGROUND]
    if seen := [read_fall(header, recording).images for header in headers[:MAX_EMPTY]]:
        return seen
    width_px, height_px = recording.image_size_px
    return [dict.fromkeys(recording.camera_ids, np.zeros((height_px, width_px), np.uint8))]


def _recorded_exposure_us(recording: Recording) -> float:
    settings = recording.document.get("camera_settings")
    exposure_us = settings.get("exposure_us") if isinstance(settings, dict) else None
    return float(exposure_us) if isinstance(exposure_us, int | float) and exposure_us > 0 else EXPOSURE_US
