"""Simulated GigE cameras and the settings to open them, for tests of the real driver."""

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from support.eventually import eventually
from support.recordings import SIZE_PX as SMALL_PX
from support.recordings import tagged_image

from drivers.camera_process.camera import RemoteCamera
from drivers.camera_process.process import CameraProcess
from drivers.cameras.aravis import AravisCamera
from drivers.cameras.genicam import GigeCameraSettings, exposure_features, trigger_features
from drivers.gige_simulator.camera import CameraDesign, Exposure, ImageSource, SimulatedCamera
from drivers.gige_simulator.uplink import Uplink
from drivers.gvcp import probe
from drivers.interfaces import Camera
from pipeline.frames import CameraId

PROCESS = os.getpid() % 256
NET = f"127.33.{PROCESS}"
"""Of this test process alone: the port of the control protocol is the same for all simulators of a machine."""
INTERFACE = f"{NET}.1"
SIZE_PX = (320, 240)
EXPOSURE_US = 100.0


def picture(n: int) -> NDArray[np.uint8]:
    """What exposure `n` of every camera shows: no two alike."""
    width_px, height_px = SIZE_PX
    return np.random.default_rng(n).integers(0, 256, (height_px, width_px), np.uint8)


def numbered(exposure: Exposure) -> NDArray[np.uint8]:
    """Show the picture of this exposure's number."""
    return picture(exposure.n)


def serial(number: int) -> str:
    """Of camera `number` of this process: another's answer to a broadcast, too."""
    return f"SIM{PROCESS}-{number:02}"


def place(number: int) -> str:
    """The user's name of it."""
    return f"place {PROCESS}-{number}"


def design(number: int = 2, **changes: Any) -> CameraDesign:
    """Camera `number` of the net; by default `c02`."""
    camera = CameraDesign(
        id=CameraId(f"c{number:02}"),
        address=f"{NET}.{number}",
        serial=serial(number),
        user_name=place(number),
        image_size_px=SIZE_PX,
        link_bytes_s=20_000_000,  # a frame takes longer than the readout: once it is here, the next may be exposed
        seed=number,
    )
    return replace(camera, **changes)


@contextmanager
def powered(
    camera: CameraDesign, source: ImageSource = numbered, uplink: Uplink | None = None
) -> Iterator[SimulatedCamera]:
    """Switch a simulated camera on, and off again."""
    simulated = SimulatedCamera(camera, source, uplink=uplink)
    simulated.start()
    try:
        yield simulated
    finally:
        simulated.stop()


def settings_for(camera: CameraDesign, *, source: str = "Line1", **changes: Any) -> GigeCameraSettings:
    """Settings that find `camera` by its address and trigger it at once."""
    settings = GigeCameraSettings(
        id=camera.id,
        address=camera.address,
        interfaces=(INTERFACE,),
        image_size_px=SIZE_PX,
        features=(
            *trigger_features(source=source, delay_us=0.0),
            *exposure_features(exposure_us=EXPOSURE_US),
        ),
        packet_size_bytes=1500,
        may_be_simulated=True,
    )
    return replace(settings, **changes)


@dataclass(frozen=True)
class GigeRig:
    """The small rig's cameras as simulated GigE cameras, and the drivers to them, not yet opened."""

    simulated: Mapping[CameraId, SimulatedCamera]
    cameras: Mapping[CameraId, Camera]
    _fired_ns: list[int]

    def fire(self) -> None:
        """Expose all of them: stone number n shows `tagged_image(n, camera)`, from 0."""
        self._fired_ns.append(time.monotonic_ns())
        for simulated in self.simulated.values():
            simulated.line(at_ns=self._fired_ns[-1])


@contextmanager
def gige_rig(camera_ids: Sequence[CameraId], process: CameraProcess | None = None) -> Iterator[GigeRig]:
    """Switch the cameras on; afterwards close the drivers, in this process or in that one, and switch them off."""
    fired_ns: list[int] = []

    def source(exposure: Exposure) -> NDArray[np.uint8]:
        return tagged_image(fired_ns.index(exposure.trigger_ns), exposure.camera)

    designs = [
        design(number, id=camera, image_size_px=SMALL_PX) for number, camera in enumerate(camera_ids, start=2)
    ]
    with ExitStack() as stack:
        simulated = {each.id: stack.enter_context(powered(each, source)) for each in designs}
        cameras: dict[CameraId, Camera] = {}
        for each in designs:
            settings = settings_for(each, image_size_px=SMALL_PX)
            cameras[each.id] = RemoteCamera(settings, process) if process else AravisCamera(settings)
        for camera in cameras.values():
            stack.callback(camera.close)
        # on a busy machine later than the driver waits for an answer
        eventually(lambda: all(probe(each.address) for each in designs))
        yield GigeRig(simulated, cameras, fired_ns)
