"""One smoke test against a camera nobody here wrote: Aravis' own `arv-fake-gv-camera`."""

import subprocess
from collections.abc import Iterator

import pytest
from support.eventually import eventually
from support.sinks import Collector

from drivers.cameras.aravis import AravisCamera
from drivers.cameras.genicam import GigeCameraSettings, exposure_features, trigger_features
from drivers.gvcp import probe
from pipeline.frames import CameraId, Frame

ADDRESS = "127.0.0.1"
"""It needs an address that is configured, and this one always is."""


@pytest.fixture
def fake() -> Iterator[None]:
    command = ["arv-fake-gv-camera-0.8", "--interface", ADDRESS, "--serial", "FAKE1"]
    with subprocess.Popen(command) as process:
        eventually(lambda: probe(ADDRESS) is not None)
        yield
        process.kill()


@pytest.mark.usefixtures("fake")
def test_it_is_opened_set_and_triggered_by_software() -> None:
    settings = GigeCameraSettings(
        id=CameraId("c01"),
        address=ADDRESS,
        serial="FAKE1",
        image_size_px=(640, 512),
        features=(
            *trigger_features(source="Software", delay_us=0.0),
            *exposure_features(exposure_us=50.0),
        ),
        packet_size_bytes=None,  # it answers no test packet, and keeps what it has
        may_be_simulated=True,
    )
    camera = AravisCamera(settings)
    camera.open()
    camera.arm(sink := Collector())
    frames = []
    for _ in range(3):
        camera.software_trigger()
        frames.append(sink.next())
    vitals = camera.examine()
    camera.close()
    assert all(isinstance(frame, Frame) and frame.image.shape == (512, 640) for frame in frames)
    assert [frame.frame_id for frame in frames if isinstance(frame, Frame)] == [65401, 65402, 65403]
    assert (vitals.serial, vitals.model, vitals.frames) == ("FAKE1", "Fake", 3)
