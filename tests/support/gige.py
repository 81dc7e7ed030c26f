"""A simulated GigE camera and the settings to open it, for tests of the real driver.

Addresses are 127.33.0.x, so that other simulators on this machine are not disturbed.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.cameras.genicam import GigeCameraSettings, exposure_features, trigger_features
from drivers.gige_simulator.camera import CameraDesign, Exposure, SimulatedCamera
from pipeline.frames import CameraId

NET = "127.33.0"
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


def design(number: int = 2, **changes: Any) -> CameraDesign:
    """Camera `number` of the net; by default `c02` at 127.33.0.2 with serial SIM02."""
    camera = CameraDesign(
        id=CameraId(f"c{number:02}"),
        address=f"{NET}.{number}",
        serial=f"SIM{number:02}",
        user_name=f"place {number}",
        image_size_px=SIZE_PX,
        seed=number,
    )
    return replace(camera, **changes)


@contextmanager
def powered(camera: CameraDesign) -> Iterator[SimulatedCamera]:
    """Switch a simulated camera on, and off again."""
    simulated = SimulatedCamera(camera, numbered)
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
    )
    return replace(settings, **changes)


def eventually(is_so: Callable[[], bool], timeout_s: float = 10.0) -> None:
    """Wait until it is so; fails when it takes too long."""
    deadline_s = time.monotonic() + timeout_s
    while not is_so():
        assert time.monotonic() < deadline_s, "never came true"
        time.sleep(0.01)
