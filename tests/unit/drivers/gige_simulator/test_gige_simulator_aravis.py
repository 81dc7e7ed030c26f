"""The simulated camera against the real Aravis: what it opens, sets, receives and asks for again."""

import socket
import time
from collections.abc import Iterator

import numpy as np
import pytest
from support.aravis_stream import AravisError, AravisStream, opened
from support.eventually import PATIENCE_S, eventually
from support.simulated_camera import ADDRESS, picture

from drivers.gige_simulator.camera import CameraDesign, SimulatedCamera
from drivers.gvcp import GVCP_PORT, action_command
from pipeline.frames import CameraId

SIZE_PX = (256, 192)
PACKET_BYTES = 576
"""A frame of so many and so small packets fits into the smallest receive buffer, when Aravis comes late."""


def show(n: int) -> np.ndarray:
    return np.tile(picture(n), (2, 2))


def _camera(**changes: object) -> SimulatedCamera:
    settings = {"id": CameraId("c01"), "address": ADDRESS, "serial": "SIM01", "image_size_px": SIZE_PX}
    return SimulatedCamera(CameraDesign(**(settings | changes)), lambda exposure: show(exposure.n))


@pytest.fixture(params=["sfnc", "legacy"])
def either(request: pytest.FixtureRequest) -> Iterator[SimulatedCamera]:
    camera = _camera(dialect=request.param, has_zipped_xml=request.param == "legacy")
    camera.start()
    yield camera
    camera.stop()


@pytest.fixture
def simulated(request: pytest.FixtureRequest) -> Iterator[SimulatedCamera]:
    camera = _camera(**getattr(request, "param", {}))
    camera.start()
    yield camera
    camera.stop()


def _trigger_by(camera, source: str) -> None:
    camera.set_trigger(source)
    camera.set_exposure_time(200.0)
    camera.gv_set_packet_size(PACKET_BYTES)


def test_every_feature_of_the_description_can_be_read(either: SimulatedCamera) -> None:
    with opened(ADDRESS) as camera:
        n_read = 0
        for feature in either.features.values():
            match feature.kind:
                case "integer":
                    value = camera.get_integer(feature.name)
                    bounds = camera.get_integer_bounds(feature.name)
                    assert bounds[0] <= value <= bounds[1]
                case "float" | "scaled":
                    value = camera.get_float(feature.name)
                    assert feature.minimum <= value <= feature.maximum
                case "boolean":
                    camera.get_boolean(feature.name)
                case "enumeration":
                    assert camera.get_string(feature.name) in feature.entries
                case "string":
                    camera.get_string(feature.name)
                case "command":
                    assert camera.is_feature_available(feature.name)
            n_read += 1
        assert n_read > 60


def test_settings_are_written_and_read_back(either: SimulatedCamera) -> None:
    with opened(ADDRESS) as camera:
        camera.set_region(16, 8, 128, 96)
        region = camera.get_region()
        assert (region.x, region.y, region.width, region.height) == (16, 8, 128, 96)
        assert camera.get_width_bounds() == (16, 240)  # what the offset leaves
        camera.set_exposure_time(1234.0)
        assert camera.get_exposure_time() == either.feature("ExposureTime") == 1234.0
        camera.set_trigger("Line2")
        assert either.feature("TriggerSource") == 1
        for line, mode in (("Line2", "Output"), ("Line1", "Input")):
            camera.set_string("LineSelector", line)
            camera.set_string("LineMode", mode)
        assert [either.feature("LineMode", bank) for bank in (0, 1)] == [0, 1]
        delay = "TriggerDelay" if either.design.dialect == "sfnc" else "TriggerDelayAbs"
        camera.set_float(delay, 247_400.0)
        assert either.feature("TriggerDelay") == 247_400.0


@pytest.mark.parametrize("simulated", [{"mtu_bytes": 4000}], indirect=True)
def test_packet_size_is_negotiated_up_to_the_mtu(simulated: SimulatedCamera) -> None:
    with opened(ADDRESS) as camera:
        assert camera.gv_auto_packet_size() == 4000
        assert simulated.feature("GevSCPSPacketSize") == 4000


def test_frames_by_line_by_software_and_by_action_commands(either: SimulatedCamera) -> None:
    with opened(ADDRESS) as camera, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sender.bind(("127.0.0.1", 0))
        _trigger_by(camera, "Line1")
        for name in ("ActionDeviceKey", "ActionGroupKey", "ActionGroupMask"):
            camera.set_integer(name, 1)
        requests = iter(range(1, 10))

        def act(address: str) -> None:
            command = action_command(device_key=1, group_key=1, group_mask=1, request_id=next(requests))
            sender.sendto(command, (address, GVCP_PORT))

        with AravisStream(camera) as stream:
            ways = (
                ("Line1", either.line),
                ("Software", camera.software_trigger),
                ("Action1", lambda: act(ADDRESS)),
                ("Action1", lambda: act("255.255.255.255")),
            )
            for n, (source, fire) in enumerate(ways, start=1):
                camera.set_string("TriggerSource", source)
                fire()
                popped = stream.pop()
                assert popped is not None
                assert popped[:2] == ("success", n), source
                np.testing.assert_array_equal(popped[2], show(n))


def test_chunks_are_parsed(simulated: SimulatedCamera) -> None:
    with opened(ADDRESS) as camera:
        _trigger_by(camera, "Line1")
        camera.set_chunk_mode(True)
        with AravisStream(camera) as stream:
            simulated.line()
            simulated.line()  # missed: still exposing
            chunks = stream.pop_chunks("ChunkFrameID", "ChunkTimestamp", "ChunkCounterValue")
            assert chunks["ChunkFrameID"] == 1
            assert chunks["ChunkCounterValue"] in (1, 2)
            simulated.line()
            assert stream.pop_chunks("ChunkFrameID", "ChunkCounterValue") == {
                "ChunkFrameID": 2,
                "ChunkCounterValue": 3,
            }


@pytest.mark.parametrize("mode", ["Off", "On"])
@pytest.mark.parametrize("probability", [0.01, 0.05])
def test_lost_packets_are_asked_for_until_the_frame_is_whole(
    simulated: SimulatedCamera, probability: float, mode: str
) -> None:
    with opened(ADDRESS) as camera:
        _trigger_by(camera, "Line1")
        camera.set_string("GevGVSPExtendedIDMode", mode)
        with AravisStream(camera, resend_ratio=1.0) as stream:
            simulated.faults.packet_loss = probability
            for n in range(1, 11):
                simulated.line()
                popped = stream.pop()
                assert popped is not None
                assert popped[:2] == ("success", n)
                np.testing.assert_array_equal(popped[2], show(n))
            eventually(
                lambda: simulated.counters.frames == 10 and stream.statistics()["n_completed_buffers"] == 10
            )
            counters, statistics = simulated.counters, stream.statistics()
    # on a busy machine the kernel may drop packets as well, which are asked for like those the camera has dropped
    assert statistics["n_received_packets"] <= counters.packets
    assert counters.dropped > 0
    assert 0 < counters.resent <= statistics["n_resend_requests"]
    assert counters.torn == statistics["n_failures"] == 0


@pytest.mark.parametrize("packet_id", [0, -1, 1])
def test_a_lost_leader_or_trailer_is_resent(simulated: SimulatedCamera, packet_id: int) -> None:
    simulated.faults.lost_packets = (packet_id,)
    with opened(ADDRESS) as camera:
        _trigger_by(camera, "Line1")
        with AravisStream(camera) as stream:
            for n in range(1, 4):
                simulated.line()
                popped = stream.pop()
                assert popped is not None
                assert popped[:2] == ("success", n)
                np.testing.assert_array_equal(popped[2], show(n))
            eventually(lambda: simulated.counters.frames == 3)
            assert simulated.counters.dropped == 3


@pytest.mark.parametrize(("name", "value"), [("no_resend", True), ("stall_after", 40)])
def test_a_frame_that_cannot_be_whole_is_given_up(
    simulated: SimulatedCamera, name: str, value: object
) -> None:
    with opened(ADDRESS) as camera:
        _trigger_by(camera, "Line1")
        with AravisStream(camera) as stream:
            simulated.faults.set(name, value)
            simulated.faults.lost_packets = (5, 50)
            simulated.line()
            popped = stream.pop()
            assert popped is not None
            assert popped[0] == "timeout"
            simulated.faults.clear()
            eventually(lambda: simulated.counters.torn == 1)
            simulated.line()
            popped = stream.pop()
            assert popped is not None
            assert popped[:2] == ("success", 2)


def test_a_second_application_is_refused(simulated: SimulatedCamera) -> None:
    with opened(ADDRESS) as first, opened(ADDRESS) as second:
        assert first.get_device().is_controller()
        assert not second.get_device().is_controller()
        assert second.get_integer("Width") == SIZE_PX[0]
        with pytest.raises(AravisError, match="access-denied"):
            second.set_integer("GevSCPD", 5)


def test_after_a_power_cycle_the_camera_is_opened_anew(simulated: SimulatedCamera) -> None:
    with opened(ADDRESS) as camera:
        _trigger_by(camera, "Line1")
        with AravisStream(camera) as stream:
            simulated.power_cycle(0.3)
            eventually(lambda: simulated.log[-1].event == "power on")
            deadline_s = time.monotonic() + PATIENCE_S  # Aravis' heartbeat sees that control is gone
            while camera.get_device().is_controller():
                assert time.monotonic() < deadline_s
                time.sleep(0.05)
            assert stream.pop(0.01) is None
    with opened(ADDRESS) as camera:
        assert camera.get_string("TriggerMode") == "Off"
        _trigger_by(camera, "Line1")
        with AravisStream(camera) as stream:
            simulated.line()
            popped = stream.pop()
            assert popped is not None
            assert popped[:2] == ("success", 1)
