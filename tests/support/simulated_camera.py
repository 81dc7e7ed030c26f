"""One simulated camera of small images, and an application that is its controller."""

import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.eventually import eventually
from support.gige_client import SCDA, SCP, SCPS, Application, Receiver

from drivers.gige_simulator.camera import CameraDesign, Exposure, SimulatedCamera, Strobe
from drivers.gige_simulator.counters import Counters
from drivers.gige_simulator.uplink import Uplink
from pipeline.frames import CameraId

NET = f"127.31.{os.getpid() % 256}"
"""Of this test process alone: the port of the control protocol is the same for all simulators of a machine."""
ADDRESS = f"{NET}.2"
SIZE_PX = (128, 96)
N_PIXELS = SIZE_PX[0] * SIZE_PX[1]
PACKET_BYTES = 1500
N_PACKETS = -(-N_PIXELS // (PACKET_BYTES - 36)) + 2


def picture(n: int) -> NDArray[np.uint8]:
    """What exposure `n` shows: no two alike."""
    width_px, height_px = SIZE_PX
    return np.random.default_rng(n).integers(0, 256, (height_px, width_px), np.uint8)


def design(**changes: Any) -> CameraDesign:
    camera = CameraDesign(
        id=CameraId("c01"),
        address=ADDRESS,
        serial="SIM01",
        user_name="place 1",
        image_size_px=SIZE_PX,
        seed=7,
    )
    return replace(camera, **changes)


@dataclass
class Session:
    """A camera that is switched on, its controller and the receiver of its stream."""

    camera: SimulatedCamera
    control: Application
    receiver: Receiver
    exposures: list[Exposure]
    strobes: list[Strobe] = field(default_factory=list)

    def address(self, name: str, bank: int = 0) -> int:
        return self.camera.address_of(name, bank)

    def set(self, name: str, value: int, bank: int = 0) -> int:
        """Write an integer, boolean or enumeration; the status."""
        return self.control.write(self.address(name, bank), value)

    def number(self, name: str, bank: int = 0) -> int:
        """Read what the camera tells over the wire."""
        return self.control.read(self.address(name, bank))

    def set_quantity(self, name: str, value: float, bank: int = 0) -> int:
        """Write a float of the SFNC dialect; the status."""
        return self.control.write_memory(self.address(name, bank), struct.pack(">d", value))

    def start(self, *, packet_bytes: int = 1500, source: int = 0) -> None:
        """Let frames come to the receiver: triggered by Line1 at once, without delay, unless set otherwise."""
        control = self.control
        assert self.set("TriggerMode", 1) == self.set("TriggerSource", source) == 0
        assert self.set_quantity("ExposureTime", 100.0) == 0
        self.stream_to_receiver(packet_bytes)
        assert self.set("AcquisitionStart", 1) == 0
        assert control.read(self.address("AcquisitionStatus")) == 1

    def stream_to_receiver(self, packet_bytes: int = 1500) -> None:
        control = self.control
        assert control.write(SCDA, 0x7F000001) == control.write(SCP, self.receiver.port) == 0
        assert control.write(SCPS, packet_bytes) == 0

    def settled(self) -> Counters:
        """Return the counters once everything that was exposed is accounted for."""

        def is_settled() -> bool:
            counters = self.camera.counters
            done = counters.frames + counters.torn + counters.swallowed + counters.unexposed
            return counters.exposures == done + counters.aborted

        eventually(is_settled)
        return self.camera.counters


@contextmanager
def session(
    show: Callable[[Exposure], NDArray[np.uint8] | None] | None = None,
    *,
    uplink: Uplink | None = None,
    **changes: Any,
) -> Iterator[Session]:
    """Switch a camera on and take control of it; its exposure `n` shows `picture(n)` unless `show` says otherwise."""
    exposures: list[Exposure] = []
    strobes: list[Strobe] = []

    def source(exposure: Exposure) -> NDArray[np.uint8] | None:
        exposures.append(exposure)
        return show(exposure) if show else picture(exposure.n)

    camera = SimulatedCamera(design(**changes), source, on_strobe=strobes.append, uplink=uplink)
    camera.start()
    control, receiver = Application(camera.design.address), Receiver()
    try:
        control.take_control()
        yield Session(camera, control, receiver, exposures, strobes)
    finally:
        control.close()
        receiver.close()
        camera.stop()
