"""Opening a camera: found, ours, set and read back, or refused with the reason."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from support.gige import INTERFACE, NET, SIZE_PX, design, powered, settings_for

from drivers.cameras.aravis import AravisCamera, genicam_xml
from drivers.cameras.genicam import (
    Feature,
    GigeCameraSettings,
    action_features,
    exposure_features,
    strobe_features,
    trigger_features,
)
from drivers.errors import CameraUnavailableError
from drivers.gige_simulator.camera import CameraDesign, SimulatedCamera
from pipeline.frames import CameraId


@pytest.fixture(params=["sfnc", "legacy"])
def simulated(request: pytest.FixtureRequest) -> Iterator[SimulatedCamera]:
    with powered(design(dialect=request.param)) as camera:
        yield camera


@pytest.fixture
def sfnc() -> Iterator[SimulatedCamera]:
    with powered(design()) as camera:
        yield camera


def opened(settings: GigeCameraSettings) -> AravisCamera:
    camera = AravisCamera(settings)
    camera.open()
    return camera


def refusal(settings: GigeCameraSettings) -> str:
    """Why the camera cannot be opened; afterwards nobody has it."""
    camera = AravisCamera(settings)
    with pytest.raises(CameraUnavailableError) as caught:
        camera.open()
    with pytest.raises(CameraUnavailableError, match="is not open"):
        camera.examine()
    return str(caught.value)


def with_features(camera: CameraDesign, *features: Feature) -> GigeCameraSettings:
    settings = settings_for(camera)
    return replace(settings, features=(*settings.features, *features))


@pytest.mark.usefixtures("simulated")
@pytest.mark.parametrize(
    "named",
    [
        {"serial": "SIM02"},
        {"user_name": "place 2"},
        {"address": f"{NET}.2"},
        {"serial": "SIM02", "user_name": "place 2", "address": f"{NET}.2"},
    ],
)
def test_found_by_any_name(named: dict[str, str]) -> None:
    camera = opened(
        replace(settings_for(design(), address=None), **named)
        if "address" not in named
        else replace(settings_for(design()), **named)
    )
    vitals = camera.examine()
    camera.close()
    assert (vitals.serial, vitals.address) == ("SIM02", f"{NET}.2")


@pytest.mark.usefixtures("simulated")
def test_both_dialects_take_all_settings() -> None:
    everything = (
        *trigger_features(source="Line1", activation="FallingEdge", delay_us=247_350.0),
        *exposure_features(exposure_us=80.0),
        *strobe_features(line="Line2"),
        *action_features(device_key=7, group_key=1, group_mask=3),
        ("LineSelector", "Line1"),
        ("LineMode", "Input"),
        ("LineDebouncerTime", 5.0),
        ("PtpEnable", True),
        ("GevHeartbeatTimeout", 1500),
    )
    camera = opened(
        settings_for(design(), features=everything, packet_delay_ns=2000, throughput_limit_bytes_s=7_000_000)
    )
    vitals = camera.examine()
    camera.close()
    assert vitals.temperature_c is not None
    assert 0 < vitals.temperature_c < 100
    assert vitals.ptp_offset_ns is not None
