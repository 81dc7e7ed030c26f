"""Cameras with the ways of seven vendors, through the real driver: opened as they were left, they see what is there."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from support.eventually import eventually
from support.gige import INTERFACE, NET, SIZE_PX, design, picture, powered, settings_for
from support.sinks import Collector

from drivers.cameras.aravis import AravisCamera
from drivers.cameras.frame_reader import CHUNKS
from drivers.cameras.genicam import action_features, trigger_features
from drivers.cameras.host_trigger import ActionKeys, ActionTrigger
from drivers.cameras.pixel_formats import CONVERTED
from drivers.errors import CameraUnavailableError, DeviceFault, Told
from drivers.gige_simulator.camera import SimulatedCamera
from drivers.gige_simulator.personalities import FLIR, HIKROBOT, JAI, LUCID, PERSONALITIES, PLAIN, Personality
from drivers.interfaces import FrameLost
from pipeline.frames import Frame

Prepare = Callable[[SimulatedCamera], None]
Opened = tuple[SimulatedCamera, AravisCamera, Collector]


@pytest.fixture
def opened() -> Iterator[Callable[..., Opened]]:
    """Power cameras, prepare them, open and arm the drivers to them; all are closed."""
    with ExitStack() as stack:

        def make(ways: Personality, prepare: Prepare = lambda _: None, **changes: object) -> Opened:
            source = changes.pop("source", next(iter(ways.sources)))
            made = design(personality=ways)
            prepare(simulated := stack.enter_context(powered(made)))
            camera = AravisCamera(settings_for(made, source=str(source), **changes))
            stack.callback(camera.close)
            camera.open()
            camera.arm(sink := Collector())
            return simulated, camera, sink

        yield make


def said(camera: AravisCamera, fault: DeviceFault) -> dict[str, str]:
    """The remarks of a kind: what each is about, and what it is now."""
    remarks = [remark for remark in camera.examine().remarks if isinstance(remark, Told)]
    last = {DeviceFault.FEATURE_PUT_BACK: "after", DeviceFault.ENTRY_INSTEAD: "used"}[fault]
    return {
        str(remark.parameters["feature"]): str(remark.parameters[last])
        for remark in remarks
        if remark.fault is fault
    }


@pytest.mark.parametrize("vendor", PERSONALITIES)
def test_a_camera_of_each_vendor_shows_each_exposure_as_the_sensor_saw_it(
    vendor: str, opened: Callable[..., Opened]
) -> None:
    ways = PERSONALITIES[vendor]
    simulated, camera, sink = opened(ways)
    for n in (1, 2):
        simulated.line()
        event = sink.next()
        assert isinstance(event, Frame), event
        np.testing.assert_array_equal(event.image, picture(n))
        assert event.frame_id == n
    camera.examine()
    eventually(lambda: simulated.counters.frames == 2)
    assert simulated.counters.exposures == 2
    put_back = set(said(camera, DeviceFault.FEATURE_PUT_BACK))
    names = {simulated.features[key].name for key in ways.left_on}
    not_told = {
        "AcquisitionFrameRate",
        "AcquisitionBurstFrameCount",
        "ExposureTimeMode",
        "GevGVSPExtendedIDMode",
    }
    assert names - put_back <= {*not_told, "AcquisitionFrameRateAbs", "AcquisitionFrameCount", "Gamma"}
    camera.close()
    again = AravisCamera(settings_for(simulated.design, source=next(iter(ways.sources))))
    again.open()
    assert said(again, DeviceFault.FEATURE_PUT_BACK) == {}  # told once
    again.close()


@pytest.mark.parametrize("name", CONVERTED)
def test_images_of_other_formats_are_their_upper_bits(name: str, opened: Callable[..., Opened]) -> None:
    simulated, camera, sink = opened(
        replace(PLAIN, pixel_formats=("Mono16", name) if name != "Mono16" else (name,))
    )
    simulated.line()
    event = sink.next()
    assert isinstance(event, Frame), event
    np.testing.assert_array_equal(event.image, picture(1))
    assert said(camera, DeviceFault.ENTRY_INSTEAD)["PixelFormat"] == name


def test_a_camera_of_colours_alone_is_refused_with_what_it_offers() -> None:
    problem = refused(replace(PLAIN, pixel_formats=("BayerRG8",)))
    assert "cannot set PixelFormat to Mono8" in problem
    assert "it can be BayerRG8" in problem


def test_what_the_configuration_sets_is_not_put_back(opened: Callable[..., Opened]) -> None:
    """By either name of a feature."""
    settings = settings_for(design())
    more = (("ReverseX", True), ("TestImageSelector", "GreyHorizontalRamp"), ("BlackLevelRaw", 3.0))
    ways = replace(PLAIN, names={"TestPattern": "TestImageSelector", "BlackLevel": "BlackLevelRaw"})
    simulated, camera, sink = opened(ways, features=(*settings.features, *more))
    assert camera.examine().remarks == ()
    simulated.line()
    event = sink.next()
    assert isinstance(event, Frame)
    assert event.image[7].tolist() == [min((SIZE_PX[0] - 1 - x) % 256 + 3, 255) for x in range(SIZE_PX[0])]


def test_a_user_set_that_the_configuration_loads_is_the_configuration(opened: Callable[..., Opened]) -> None:
    settings = settings_for(design())
    loading = (("UserSetSelector", "Default"), ("UserSetLoad", True))
    simulated, camera, _ = opened(
        replace(PLAIN, left_on={"Gamma": 2.0}), features=(*loading, *settings.features)
    )
    assert camera.examine().remarks == ()
    assert simulated.feature("Gamma") == 1.0  # as the set has it


def test_what_cannot_be_put_back_is_told(opened: Callable[..., Opened]) -> None:
    dark = replace(PLAIN, left_on={"BlackLevel": 3.0}, fixed=frozenset({"BlackLevel"}))
    assert opened(dark)[1].examine().remarks == ("BlackLevel is 3.0, and cannot be put back",)


def test_a_mirrored_camera_is_used_only_if_the_configuration_says_so(opened: Callable[..., Opened]) -> None:
    mirrored = replace(PLAIN, left_on={"ReverseX": 1}, fixed=frozenset({"ReverseX"}))
    assert "if ReverseX shall stay True, set it so in features" in refused(mirrored)
    features = (*settings_for(design()).features, ("ReverseX", True))
    assert opened(mirrored, features=features)[1].examine().remarks == ()


def test_each_engine_of_a_camera_that_bins_is_put_back(opened: Callable[..., Opened]) -> None:
    def prepare(simulated: SimulatedCamera) -> None:
        for factor, engine in ((3, "ISP"), (2, "Sensor")):
            simulated.tamper("BinningVertical", factor, FLIR.binning_engines.index(engine))

    _, camera, _ = opened(replace(FLIR, left_on={}), prepare)
    put_back = [str(remark) for remark in camera.examine().remarks]
    assert put_back == [f"BinningVertical was {n}: put back to 1" for n in (2, 3)]


def test_what_others_change_later_is_seen(opened: Callable[..., Opened]) -> None:
    simulated, camera, _ = opened(PLAIN)
    simulated.tamper("ReverseY", 1)
    with pytest.raises(CameraUnavailableError, match="setting ReverseY is True, should be False"):
        camera.examine()


def test_chunks_without_an_image_are_named(opened: Callable[..., Opened]) -> None:
    """aravis 753: Aravis finds no image in payload type 4."""
    settings = settings_for(design())
    features = (*settings.features, ("ChunkModeActive", True))
    simulated, _, sink = opened(replace(PLAIN, chunk_payload=0x0004), features=features)
    simulated.line()
    event = sink.next()
    assert isinstance(event, FrameLost)
    assert event.reason == CHUNKS
    assert "ChunkModeActive" in CHUNKS


# --- triggers ---


def test_one_trigger_is_one_frame_though_bursts_of_three_were_left_on(opened: Callable[..., Opened]) -> None:
    """aravis 589."""
    simulated, camera, sink = opened(HIKROBOT)
    for _ in range(2):
        simulated.line()
        assert isinstance(sink.next(), Frame)
    eventually(lambda: simulated.counters.frames == 2)
    assert simulated.counters.exposures == 2
    assert said(camera, DeviceFault.ENTRY_INSTEAD) == {"TriggerSelector": "FrameBurstStart"}


def test_a_burst_that_would_never_end_is_refused() -> None:
    """harvesters 77: after the first trigger such a camera runs freely."""
    lacks = frozenset({"AcquisitionBurstFrameCount"})
    problem = refused(replace(PLAIN, selectors=("AcquisitionStart",), lacks=lacks))
    assert "has no AcquisitionBurstFrameCount nor AcquisitionFrameCount" in problem
    assert "no trigger of single frames" in problem


def test_a_trigger_that_others_left_on_is_switched_off(opened: Callable[..., Opened]) -> None:
    """ic4-examples 9: with ExposureActive on, the camera waits for a second signal."""
    ways = PERSONALITIES["The Imaging Source"]
    bank = ways.selectors.index("ExposureActive")
    simulated, _, sink = opened(ways, lambda camera: camera.tamper("TriggerMode", "On", bank))
    simulated.line()
    assert isinstance(sink.next(), Frame)


def test_the_only_input_is_the_one_that_is_wired(opened: Callable[..., Opened]) -> None:
    simulated, camera, sink = opened(JAI, source="Line1")
    assert said(camera, DeviceFault.ENTRY_INSTEAD) == {"TriggerSource": "Line5"}
    simulated.line("Line5")
    assert isinstance(sink.next(), Frame)


def test_among_several_inputs_the_configuration_chooses() -> None:
    problem = refused(FLIR, source="Line1")
    assert "cannot set TriggerSource to Line1" in problem
    assert "it can be Line0, Line2, Line3, Software, Action0" in problem
    assert problem.endswith("set trigger, of the rig or of this camera, to one of them")


def test_a_line_that_others_made_an_output_triggers_again(opened: Callable[..., Opened]) -> None:
    """VimbaPython 21: lines can be inputs and outputs."""
    bank = LUCID.lines.index("Line2")
    simulated, camera, sink = opened(
        LUCID, lambda camera: camera.tamper("LineMode", "Output", bank), source="Line2"
    )
    simulated.line("Line2")
    assert isinstance(sink.next(), Frame)
    assert said(camera, DeviceFault.FEATURE_PUT_BACK)["LineMode of Line2"] == "Input"


def test_action_commands_reach_cameras_that_count_actions_from_0(opened: Callable[..., Opened]) -> None:
    keys = {"device_key": 0x51, "group_key": 2, "group_mask": 4}
    features = (*trigger_features(source="Action1", delay_us=0.0), *action_features(**keys))
    _, camera, sink = opened(LUCID, features=features)
    assert said(camera, DeviceFault.ENTRY_INSTEAD) == {"TriggerSource": "Action0"}
    ActionTrigger(ActionKeys(**keys, targets=(f"{NET}.2",)), [INTERFACE])()
    assert isinstance(sink.next(), Frame)


# --- clocks ---


def test_a_camera_that_is_the_master_of_the_others_warns_of_nothing() -> None:
    """pypylon 595, 662: cameras elect one of themselves; that it is the only one, the rig checks."""
    made = design(is_clock_master=True)
    settings = settings_for(made)
    with powered(made):
        camera = AravisCamera(replace(settings, features=(*settings.features, ("PtpEnable", True))))
        camera.open()
        eventually(lambda: camera.examine().ptp_status == "Master")
        assert camera.examine().warnings == ()
        camera.close()


# --- what a camera cannot do ---


@pytest.mark.parametrize(("exposure_us", "mode"), [(5.0, "UltraShort"), (20.0, "Standard")])
def test_the_mode_of_exposure_follows_the_time(
    exposure_us: float, mode: str, opened: Callable[..., Opened]
) -> None:
    """aravis 398: each mode has a range of its own, and the wrong one was left on."""
    other = {"ExposureTimeMode": "Standard" if mode == "UltraShort" else "UltraShort"}
    features = tuple(
        ("ExposureTime", exposure_us) if name == "ExposureTime" else (name, value)
        for name, value in settings_for(design(), source="Line0").features
    )
    simulated, _, sink = opened(replace(HIKROBOT, left_on=other), features=features)
    assert simulated.feature("ExposureTime") == exposure_us
    modes = simulated.features["ExposureTimeMode"].entries
    assert simulated.feature("ExposureTimeMode") == modes[mode]
    simulated.line()
    assert isinstance(sink.next(), Frame)


def test_an_exposure_between_the_modes_is_refused_and_the_mode_is_left() -> None:
    features = tuple(
        ("ExposureTime", 14.5) if name == "ExposureTime" else (name, value)
        for name, value in settings_for(design(), source="Line0").features
    )
    assert "cannot set ExposureTime to 14.5" in refused(HIKROBOT, features=features)


def test_a_delay_beyond_the_camera_is_refused_with_the_remedy() -> None:
    features = (*settings_for(design(), source="Line0").features, ("TriggerDelay", 247_400.0))
    problem = refused(FLIR, features=features)
    assert "it can do 0 to 65520: let gate or timer make the delay (rig.delay)" in problem
    problem = refused(replace(PLAIN, lacks=frozenset({"TriggerDelay"})), features=features[-1:])
    assert (
        problem
        == "c02: has no TriggerDelay nor TriggerDelayAbs: let gate or timer make the delay (rig.delay)"
    )


def test_a_packet_beyond_the_camera_is_refused_with_the_remedy() -> None:
    problem = refused(HIKROBOT, packet_size_bytes=8192)
    assert "it can do 220 to 8164: set packet_size_bytes to a size that all cameras can send" in problem


@pytest.mark.parametrize("left_ms", [300_000, 500])
def test_a_heartbeat_that_a_debugger_left_on_is_as_usual_again(
    left_ms: int, opened: Callable[..., Opened]
) -> None:
    """A long one keeps the camera in use for minutes after a crash; a short one loses control (pypylon 812, 863)."""
    ways = replace(PLAIN, left_on={"GevHeartbeatTimeout": left_ms})
    simulated, camera, _ = opened(ways)
    assert said(camera, DeviceFault.FEATURE_PUT_BACK) == {"GevHeartbeatTimeout": "3000"}
    second = AravisCamera(settings_for(simulated.design))
    with pytest.raises(CameraUnavailableError, match="its heartbeat ends within 3 s"):
        second.open()


def refused(ways: Personality, **changes: object) -> str:
    """The reason why a camera cannot be opened."""
    source = changes.pop("source", next(iter(ways.sources)))
    made = design(personality=ways)
    with powered(made):
        camera = AravisCamera(settings_for(made, source=str(source), **changes))
        with pytest.raises(CameraUnavailableError) as caught:
            camera.open()
    return str(caught.value)
