"""Sixteen cameras behind one uplink: two bundles 25 ms apart arrive whole with the packet delay that init sets.

Images, links and uplink are a quarter of those of 1280 x 1024 px, 1 and 10 Gb/s: times are as with these.
"""

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import replace

import numpy as np
import pytest
from support.eventually import eventually
from support.gige import design, powered, settings_for
from support.sinks import Collector

from drivers.camera_process.camera import RemoteCamera
from drivers.camera_process.process import CameraProcess
from drivers.factory import ARAVIS
from drivers.gige_simulator.camera import Exposure, SimulatedCamera
from drivers.gige_simulator.uplink import Uplink
from drivers.gvcp import probe
from pipeline.arrays import GreyImage
from pipeline.frames import Frame
from service.configuration.camera_wire import BURST_MS, CameraWire, carried

SIZE_PX = (640, 512)
LINK_BYTES_S = 31_250_000
WIRE = CameraWire(
    n_cameras=16,
    image_bytes=640 * 512,
    link_bytes_s=LINK_BYTES_S,
    uplink_bytes_s=312.5e6,
    buffer_bytes=256 << 10,
)
Burst = tuple[Sequence[SimulatedCamera], Sequence[Collector]]


def shown(exposure: Exposure) -> GreyImage:
    """Return an image that says which camera took it and its number."""
    image = np.full(SIZE_PX[::-1], 40 + exposure.n, np.uint8)
    image[:, : int(exposure.camera[1:])] = 255
    return image


@pytest.fixture
def process() -> Iterator[CameraProcess]:
    process = CameraProcess(ARAVIS)
    yield process
    process.close()


@contextmanager
def burst(process: CameraProcess, wire: CameraWire) -> Iterator[Burst]:
    """Expose all cameras twice, 25 ms apart; the cameras, once all is sent, and what comes of each."""
    uplink = Uplink(rate_bytes_s=wire.uplink_bytes_s, buffer_bytes=wire.buffer_bytes)
    designs = [
        replace(design(number), image_size_px=SIZE_PX, link_bytes_s=LINK_BYTES_S) for number in range(2, 18)
    ]
    with ExitStack() as stack:
        simulated = [stack.enter_context(powered(each, shown, uplink)) for each in designs]
        eventually(lambda: all(probe(each.address) for each in designs))
        cameras = [
            RemoteCamera(
                settings_for(
                    each,
                    image_size_px=SIZE_PX,
                    packet_size_bytes=wire.packet_bytes,
                    packet_delay_ns=wire.packet_delay_ns,
                ),
                process,
            )
            for each in designs
        ]
        sinks = [Collector() for _ in cameras]
        for camera in cameras:
            stack.callback(camera.close)
        with ThreadPoolExecutor(len(cameras)) as calls:
            list(calls.map(RemoteCamera.open, cameras))
            list(calls.map(RemoteCamera.arm, cameras, sinks))
        first_ns = time.monotonic_ns()
        for at_ns in (first_ns, first_ns + round(BURST_MS * 1e6)):
            for each in simulated:
                each.line(at_ns=at_ns)
        eventually(lambda: all(each.counters.frames + each.counters.torn == 2 for each in simulated))
        yield simulated, sinks


def test_two_bundles_in_a_burst_arrive_whole(process: CameraProcess) -> None:
    wire = WIRE.paced()
    assert carried(wire, 10).is_burst_carried
    with burst(process, wire) as (simulated, sinks):
        for camera, sink in zip(simulated, sinks, strict=True):
            for n in (1, 2):
                frame = sink.next()
                assert isinstance(frame, Frame), frame
                number = int(camera.id[1:])
                assert frame.image[0, number - 1] == 255
                assert frame.image[-1, number] == 40 + n
        assert sum(each.counters.dropped for each in simulated) == 0


def test_without_a_packet_delay_the_switch_loses_packets(process: CameraProcess) -> None:
    assert not carried(WIRE, 4).is_carried
    with burst(process, WIRE) as (simulated, _):
        assert sum(each.counters.dropped for each in simulated) > 0
