"""Opening a camera: found, ours, set and read back, or refused with the reason."""

import sys
from collections.abc import Iterator
from dataclasses import replace

import pytest
from support.gige import NET, SIZE_PX, design, place, powered, serial, settings_for
from support.sinks import Collector

from drivers import gvcp
from drivers.cameras.aravis import AravisCamera
from drivers.cameras.feature_access import FeatureAccess
from drivers.cameras.finding import are_simulated
from drivers.cameras.genicam import (
    Feature,
    GigeCameraSettings,
    action_features,
    exposure_features,
    strobe_features,
    trigger_features,
)
from drivers.errors import CameraUnavailableError, LossCause
from drivers.gige_simulator.camera import SimulatedCamera
from pipeline.frames import CameraId


@pytest.fixture(params=["sfnc", "legacy"])
def either(request: pytest.FixtureRequest) -> Iterator[SimulatedCamera]:
    with powered(design(dialect=request.param)) as camera:
        yield camera


@pytest.fixture
def simulated() -> Iterator[SimulatedCamera]:
    with powered(design()) as camera:
        yield camera


def refusal(settings: GigeCameraSettings) -> str:
    """Why the camera cannot be opened; afterwards it is as if it never had been."""
    camera = AravisCamera(settings)
    with pytest.raises(CameraUnavailableError) as caught:
        camera.open()
    with pytest.raises(CameraUnavailableError, match="is not open"):
        camera.examine()
    return str(caught.value)


def with_features(*features: Feature) -> GigeCameraSettings:
    settings = settings_for(design())
    return replace(settings, features=(*settings.features, *features))


# --- which camera ---


@pytest.mark.usefixtures("simulated")
def test_a_simulated_camera_is_refused_in_a_rig_that_is_not() -> None:
    problem = refusal(replace(settings_for(design()), may_be_simulated=False))
    assert "is a simulated camera" in problem
    assert "rig.is_simulated = true" in problem


@pytest.mark.usefixtures("simulated")
@pytest.mark.parametrize(
    ("names", "is_so"),
    [
        ({}, True),
        ({"address": None, "serial": serial(2)}, True),
        ({"serial": "another"}, False),
        ({"address": f"{NET}.3"}, False),  # where none answers
        ({"address": None, "serial": "another"}, False),
    ],
)
def test_a_rig_is_simulated_if_all_of_its_cameras_that_answer_are(
    names: dict[str, str | None], is_so: bool
) -> None:
    assert are_simulated([replace(settings_for(design()), **names)]) is is_so


@pytest.mark.usefixtures("simulated")
@pytest.mark.parametrize(
    "names",
    [
        {"serial": serial(2)},
        {"user_name": place(2)},
        {"address": f"{NET}.2"},
        {"serial": serial(2), "user_name": place(2), "address": f"{NET}.2"},
    ],
    ids=lambda names: "+".join(names),
)
def test_found_by_any_name(names: dict[str, str]) -> None:
    camera = AravisCamera(settings_for(design(), **({"address": None} | names)))
    camera.open()
    vitals = camera.examine()
    camera.close()
    assert (vitals.serial, vitals.address, vitals.model) == (serial(2), f"{NET}.2", "SF-1280")


@pytest.mark.usefixtures("simulated")
def test_another_camera_in_the_place_is_refused_by_name() -> None:
    with powered(design(3)):
        problem = refusal(settings_for(design(), serial=serial(3)))
        assert problem.startswith(
            f"c02: should be serial {serial(3)}, address {NET}.2, but the camera there is"
        )
        assert f"serial {serial(2)} ({place(2)})" in problem
        problem = refusal(settings_for(design(), user_name=place(3)))
        assert f"should be user name {place(3)}" in problem


@pytest.mark.usefixtures("simulated")
def test_a_camera_that_is_not_there_is_told_from_those_that_are() -> None:
    assert f"does not answer at {NET}.7" in refusal(settings_for(design(), address=f"{NET}.7"))
    problem = refusal(settings_for(design(), address=None, serial=serial(99)))
    assert f"serial {serial(99)} does not answer; found" in problem
    assert f"serial {serial(2)} ({place(2)}) at {NET}.2" in problem


@pytest.mark.usefixtures("simulated")
def test_a_name_two_cameras_have_is_refused() -> None:
    with powered(design(3, user_name=place(2))):
        problem = refusal(settings_for(design(), address=None, user_name=place(2)))
    assert "ambiguous" in problem
    assert serial(2) in problem
    assert serial(3) in problem


def test_a_second_application_is_refused_and_told_when_to_try_again(simulated: SimulatedCamera) -> None:
    first = AravisCamera(settings_for(design()))
    first.open()
    owner = simulated.controller
    assert "in use by another application" in (problem := refusal(settings_for(design())))
    assert "its heartbeat ends within 3 s" in problem
    assert simulated.controller == owner
    first.examine()
    first.close()
    assert simulated.controller is None
    second = AravisCamera(settings_for(design()))
    second.open()
    second.close()


def test_an_address_this_machine_has_no_longer_is_a_camera_that_is_not_there() -> None:
    settings = settings_for(design(), address=None, serial=serial(2), interfaces=("198.51.100.7",))
    assert "c02: no camera can be looked for out of 198.51.100.7" in refusal(settings)


def test_whatever_aravis_says_is_said_of_the_camera(
    simulated: SimulatedCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = AravisCamera(settings_for(design()))
    camera.open()

    def fail(features: FeatureAccess, _: object) -> None:
        features._device.get_integer_feature_bounds("NoSuchFeature")

    monkeypatch.setattr(FeatureAccess, "verify", fail)
    with pytest.raises(CameraUnavailableError, match=r"c02: cannot be examined: .*NoSuchFeature"):
        camera.examine()
    camera.close()
    assert "c02: cannot be opened: " in refusal(settings_for(design()))
    assert simulated.controller is None


@pytest.mark.full
def test_one_that_falls_silent_amid_the_questions_is_as_silent_as_before_them(
    simulated: SimulatedCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = AravisCamera(settings_for(design()))
    camera.open()
    probe = gvcp.probe

    def probe_and_unplug(address: str) -> gvcp.DiscoveredCamera | None:
        seen = probe(address)
        simulated.unplug()
        return seen

    with monkeypatch.context() as patched:
        patched.setattr(gvcp, "probe", probe_and_unplug)
        with pytest.raises(
            CameraUnavailableError, match=r"c02: does not answer: cannot read register"
        ) as lost:
            camera.examine()
    assert lost.value.cause is LossCause.SILENT
    simulated.replug()  # a camera that is gone takes 8 s to close
    camera.close()


# --- what it is set to ---


def test_both_dialects_take_all_settings(either: SimulatedCamera) -> None:
    everything = (
        ("UserSetSelector", "Default"),
        ("UserSetLoad", True),
        *trigger_features(source="Line1", activation="FallingEdge", delay_us=247_350.0),
        *exposure_features(exposure_us=80.0),
        *strobe_features(line="Line2"),
        ("LineSelector", "Line1"),
        ("LineMode", "Input"),
        ("LineDebouncerTime", 5),
        *action_features(device_key=7, group_key=1, group_mask=3),
        ("PtpEnable", True),
    )
    settings = settings_for(
        design(), features=everything, packet_delay_ns=2000, throughput_limit_bytes_s=7_000_000
    )
    camera = AravisCamera(settings)
    camera.open()
    expected = {
        "TriggerMode": 1,
        "TriggerSource": 0,
        "TriggerActivation": 1,
        "TriggerDelay": 247_350.0,
        "ExposureTime": 80.0,
        "ActionDeviceKey": 7,
        "ActionGroupMask": 3,
        "GevSCPD": 2000,
        "GevSCPSPacketSize": 1500,
        "DeviceLinkThroughputLimit": 7_000_000,
        "PtpEnable": 1,
    }
    assert {name: either.feature(name) for name in expected} == expected
    assert [either.feature("LineMode", bank) for bank in (0, 1)] == [0, 1]
    assert [either.feature("LineSource", bank) for bank in (0, 1)] == [0, 1]
    assert either.feature("LineDebouncerTime", 0) == 5.0
    vitals = camera.examine()
    camera.close()
    assert vitals.temperature_c is not None
    assert 0 < vitals.temperature_c < 100
    assert isinstance(vitals.ptp_offset_ns, int)
    assert any("PTP" in warning for warning in vitals.warnings)  # it takes seconds to lock


def test_a_trigger_left_on_by_someone_else_is_switched_off(either: SimulatedCamera) -> None:
    """FrameBurstStart or AcquisitionStart would wait for ever for a source that nobody drives."""
    either.tamper("TriggerMode", "On", bank=1)
    camera = AravisCamera(settings_for(design()))
    camera.open()
    assert [either.feature("TriggerMode", bank) for bank in (0, 1)] == [1, 0]
    camera.close()


@pytest.mark.parametrize("dialect", ["sfnc", "legacy"])
def test_what_a_camera_cannot_do_is_refused_with_what_it_can(dialect: str) -> None:
    """One dialect refuses the value, the other silently makes another of it."""
    with powered(design(dialect=dialect)):
        problem = refusal(with_features(("ExposureTime", 5.0)))
    assert problem.startswith("c02: ")
    assert "ExposureTime" in problem
    assert "5.0" in problem
    assert "it can do 10 to 1000000" in problem


@pytest.mark.usefixtures("simulated")
@pytest.mark.parametrize(
    ("feature", "problem"),
    [
        (("ExposureTimes", 5.0), "has no ExposureTimes: remove it"),
        (("TriggerSource", "Line9"), "cannot set TriggerSource to Line9"),
        (("TriggerSource", 1), "wants TriggerSource as str, not 1"),
        (("PtpEnable", "yes"), "wants PtpEnable as bool, not 'yes'"),
        (("Width", 16.5), "wants Width as int, not 16.5"),
        (("TriggerMode", "Off"), "setting TriggerMode is Off, should be On"),
        (("SensorWidth", 100), "cannot set SensorWidth to 100"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_impossible_settings_are_named(feature: Feature, problem: str) -> None:
    assert problem in refusal(with_features(feature))


def test_gain_in_steps_of_its_own_is_not_taken_for_db() -> None:
    with powered(design(dialect="legacy")) as simulated:
        settings = settings_for(design(), features=exposure_features(exposure_us=50.0, gain_db=6.0))
        assert "cannot set Gain to 6.0 dB: it has only GainRaw" in refusal(settings)
        camera = AravisCamera(replace(settings, features=(("GainRaw", 60),)))
        camera.open()
        assert simulated.feature("Gain") == pytest.approx(6.0)
        camera.close()


@pytest.mark.usefixtures("simulated")
def test_the_image_size_is_the_configured_one_or_an_error() -> None:
    assert "Width" in refusal(settings_for(design(), image_size_px=(SIZE_PX[0] + 4, SIZE_PX[1])))
    camera = AravisCamera(settings_for(design(), image_size_px=(160, 120)))
    camera.open()
    camera.close()


# --- packets ---


@pytest.mark.parametrize(
    ("mtu_bytes", "wanted_bytes", "got_bytes"), [(9000, 8192, 8192), (9000, None, 8996), (4000, None, 4000)]
)
def test_packets_are_fixed_or_negotiated(mtu_bytes: int, wanted_bytes: int | None, got_bytes: int) -> None:
    with powered(design(mtu_bytes=mtu_bytes)) as simulated:
        camera = AravisCamera(settings_for(design(), packet_size_bytes=wanted_bytes))
        camera.open()
        camera.arm(sink := Collector())
        assert simulated.feature("GevSCPSPacketSize") == got_bytes
        simulated.line()
        sink.next()
        camera.examine()
        camera.close()


def test_packets_the_network_does_not_pass_are_refused_with_the_remedy() -> None:
    with powered(design(mtu_bytes=4000)):
        problem = refusal(settings_for(design(), packet_size_bytes=8192))
    assert "packets of 8192 bytes do not get through, 4000 do: set the MTU" in problem


@pytest.mark.usefixtures("simulated")
def test_a_receive_buffer_the_kernel_cuts_is_a_warning_with_the_remedy() -> None:
    camera = AravisCamera(settings_for(design(), receive_buffer_bytes=1 << 20))
    camera.open()
    vitals = camera.examine()
    assert vitals.receive_buffer_bytes == 1 << 20
    assert vitals.warnings == ()
    camera.close()
    too_much = (1 << 31) - 1  # doubled, this is more than the kernel can count
    camera = AravisCamera(settings_for(design(), receive_buffer_bytes=too_much))
    camera.open()
    vitals = camera.examine()
    camera.close()
    assert vitals.receive_buffer_bytes is not None
    assert vitals.receive_buffer_bytes < too_much
    (warning,) = vitals.warnings
    assert f"sysctl -w net.core.rmem_max={too_much}" in warning


# --- settings and description ---


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        ({"address": None}, "serial, address or user_name"),
        ({"address": "camera.plant"}, "camera.plant"),
        ({"interfaces": ("eth0",)}, "eth0"),
        ({"id": CameraId("c/1")}, "id"),
        ({"image_size_px": (0, 240)}, "image_size_px"),
        ({"packet_size_bytes": 100}, "packet_size_bytes"),
        ({"packet_delay_ns": -1}, "packet_delay_ns"),
        ({"throughput_limit_bytes_s": 0}, "throughput_limit_bytes_s"),
        ({"n_buffers": 1}, "n_buffers"),
        ({"receive_buffer_bytes": 0}, "receive_buffer_bytes"),
        ({"receive_buffer_bytes": 1 << 31}, "receive_buffer_bytes must be in 1..2147483647"),
        ({"packet_delay_ns": 1 << 63}, "packet_delay_ns"),
        ({"throughput_limit_bytes_s": 1 << 63}, "throughput_limit_bytes_s"),
        ({"features": (("Width", 1 << 63),)}, "feature Width must have 64 bits"),
    ],
)
def test_settings_are_checked_before_any_camera(changes: dict[str, object], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        settings_for(design(), **changes)


@pytest.mark.usefixtures("simulated")
def test_without_aravis_the_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)
    problem = refusal(settings_for(design()))
    assert "Aravis 0.8 is missing" in problem
    assert "apt-get install python3-gi gir1.2-aravis-0.8" in problem
