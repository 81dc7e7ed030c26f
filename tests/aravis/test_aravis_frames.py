"""Frames of a simulated camera through the real driver: every trigger source, and a wire that loses."""

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from support.eventually import PATIENCE_S, eventually
from support.gige import INTERFACE, NET, SIZE_PX, design, gige_rig, picture, powered, settings_for
from support.recordings import CAMERAS, tagged_image
from support.sinks import Collector

from drivers.cameras import aravis
from drivers.cameras.aravis import AravisCamera
from drivers.cameras.genicam import Feature, action_features, trigger_features
from drivers.cameras.host_trigger import ActionKeys, ActionTrigger
from drivers.gige_simulator.camera import CameraDesign, SimulatedCamera
from drivers.interfaces import DeviceEvent, FrameLost
from pipeline.frames import Frame


class SlowAtFirst(Collector):
    """Blocks its first delivery until told to go on."""

    def __init__(self) -> None:
        super().__init__()
        self._may_go_on = threading.Event()

    def deliver(self, event: DeviceEvent) -> bool:
        self._may_go_on.wait(PATIENCE_S)
        return super().deliver(event)

    def go_on(self) -> None:
        self._may_go_on.set()


@dataclass(frozen=True)
class Bench:
    """An armed camera."""

    simulated: SimulatedCamera
    camera: AravisCamera
    sink: Collector

    def expose(self) -> Frame | FrameLost:
        """One edge; what comes of it."""
        self.simulated.line()
        event = self.sink.next()
        assert isinstance(event, Frame | FrameLost)
        return event


@pytest.fixture
def bench_of() -> Iterator[Callable[..., Bench]]:
    """Make benches; all are closed, and what the driver counted is what the camera counted."""
    closing: list[Callable[[], None]] = []

    def make(camera_design: CameraDesign | None = None, **changes: object) -> Bench:
        camera_design = camera_design or design()
        power = powered(camera_design)
        bench = Bench(power.__enter__(), AravisCamera(settings_for(camera_design, **changes)), Collector())
        closing.extend((lambda: power.__exit__(None, None, None), bench.camera.close))
        bench.camera.open()
        bench.camera.arm(bench.sink)
        return bench

    yield make
    for close in reversed(closing):
        close()


@pytest.fixture
def bench(bench_of: Callable[..., Bench]) -> Bench:
    return bench_of()


def assert_shows(event: DeviceEvent, n: int) -> None:
    assert isinstance(event, Frame), event
    assert np.array_equal(event.image, picture(n))


# --- triggers ---


def test_a_frame_is_what_was_exposed_and_when(bench: Bench) -> None:
    before_ns = time.monotonic_ns()
    frames = [bench.expose() for _ in range(3)]
    after_ns = time.monotonic_ns()
    for n, frame in enumerate(frames, start=1):
        assert_shows(frame, n)
        assert isinstance(frame, Frame)
        assert (frame.camera, frame.frame_id) == ("c02", n)
        assert not frame.image.flags.writeable
        assert frame.image.base is not None  # no copy: what Aravis received into
    times_ns = [frame.received_ns for frame in frames]
    assert [before_ns, *times_ns, after_ns] == sorted([before_ns, *times_ns, after_ns])


def test_trigger_delay_is_kept_and_told_by_both_clocks(bench_of: Callable[..., Bench]) -> None:
    bench = bench_of(
        design(clock_offset_ns=5_000_000_000_000),
        features=trigger_features(source="Line1", delay_us=50_000.0),
    )
    edges_ns, frames = [], []
    for _ in range(2):
        edges_ns.append(time.monotonic_ns())
        frames.append(bench.expose())
    first, second = frames
    assert isinstance(first, Frame)
    assert isinstance(second, Frame)
    assert 50e6 < first.received_ns - edges_ns[0] < 150e6
    assert first.device_ns > 5_000_000_000_000
    spacing_ns = edges_ns[1] - edges_ns[0]
    assert second.device_ns - first.device_ns == pytest.approx(spacing_ns, abs=5e6)


@pytest.mark.parametrize("dialect", ["sfnc", "legacy"])
def test_software_trigger(bench_of: Callable[..., Bench], dialect: str) -> None:
    bench = bench_of(design(dialect=dialect), features=trigger_features(source="Software", delay_us=0.0))
    for n in (1, 2):
        bench.camera.software_trigger()
        assert_shows(bench.sink.next(), n)
    bench.simulated.line()
    assert bench.simulated.counters.missed == 1  # the line is not its trigger


@pytest.mark.parametrize(
    "targets", [("255.255.255.255",), (f"{NET}.2", f"{NET}.3")], ids=["broadcast", "unicast"]
)
def test_action_command(bench_of: Callable[..., Bench], targets: tuple[str, ...]) -> None:
    keys = ActionKeys(device_key=0x51, group_key=2, group_mask=4, targets=targets)
    features = (
        *trigger_features(source="Action1", delay_us=0.0),
        *action_features(device_key=0x51, group_key=2, group_mask=6),
    )
    benches = [bench_of(design(number), features=features) for number in (2, 3)]
    other = bench_of(design(4), features=(*features, ("ActionDeviceKey", 0x52)))
    fire = ActionTrigger(keys, [INTERFACE])
    for n in (1, 2):
        fire()
        for bench in benches:
            assert_shows(bench.sink.next(), n)
    assert other.simulated.counters.actions == 0
    assert other.sink.events == []


def test_a_region_of_the_sensor(bench_of: Callable[..., Bench]) -> None:
    bench = bench_of(image_size_px=(160, 120))
    event = bench.expose()
    assert isinstance(event, Frame)
    assert np.array_equal(event.image, picture(1)[:120, :160])


@pytest.mark.parametrize(
    "feature", [("ChunkModeActive", True), ("GevGVSPExtendedIDMode", "On")], ids=["chunks", "extended ids"]
)
def test_other_kinds_of_packets_carry_the_same_image(
    bench_of: Callable[..., Bench], feature: Feature
) -> None:
    bench = bench_of(features=(*settings_for(design()).features, feature))
    for n in (1, 2):
        assert_shows(bench.expose(), n)


def test_arming_again_starts_anew(bench: Bench) -> None:
    """The camera counts from 1 again; Aravis must not take its frames for late ones of before."""
    for _ in range(5):
        bench.expose()
    bench.camera.disarm()
    bench.camera.disarm()
    bench.simulated.line()
    assert bench.simulated.counters.missed == 1
    bench.camera.arm(second := Collector())
    bench.simulated.line()
    assert_shows(frame := second.next(), 6)
    assert isinstance(frame, Frame)
    assert frame.frame_id == 1
    assert len(bench.sink.events) == 5
    assert bench.camera.examine().frames == 6


def test_cameras_side_by_side_expose_together() -> None:
    with gige_rig(CAMERAS) as rig:
        sinks = {camera: Collector() for camera in CAMERAS}
        for camera, driver in rig.cameras.items():
            driver.open()
            driver.arm(sinks[camera])
        for n in range(5):
            rig.fire()
            for camera, sink in sinks.items():
                assert isinstance(frame := sink.next(), Frame)
                assert frame.camera == camera
                assert np.array_equal(frame.image, tagged_image(n, camera))


# --- a wire that loses ---


@pytest.mark.parametrize("loss", [0.01, 0.05])
def test_lost_packets_are_sent_again_and_no_frame_is_lost(
    bench_of: Callable[..., Bench], loss: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(aravis, "FRAME_RETENTION_US", 20_000_000)  # a busy machine is late with them
    bench = bench_of()
    bench.simulated.faults.packet_loss = loss
    for n in range(1, 61):
        assert_shows(bench.expose(), n)
    eventually(
        lambda: bench.simulated.counters.frames == 60
    )  # the last one may have come before it was counted
    counters, vitals = bench.simulated.counters, bench.camera.examine()
    assert counters.dropped > 0
    assert (vitals.frames, vitals.failed_frames) == (60, 0)
    # a busy machine asks again for what is only late, and the driver counts no packet twice
    assert 0.9 * counters.dropped <= vitals.resent_packets <= counters.resent


@pytest.mark.parametrize("packet", [0, -1, 7], ids=["leader", "trailer", "payload"])
def test_any_one_packet_lost(bench: Bench, packet: int) -> None:
    bench.simulated.faults.lost_packets = (packet,)
    for n in (1, 2, 3):
        assert_shows(bench.expose(), n)
    assert bench.simulated.counters.resent >= 3
    assert bench.simulated.counters.dropped == 3


def test_a_packet_that_comes_after_a_pause_completes_its_frame(bench: Bench) -> None:
    """As when either end is kept from the processor; Aravis alone gives up after 0.1 s."""
    faults = bench.simulated.faults
    faults.lost_packets, faults.control_loss = (7,), 1.0  # and nobody hears that it is missed
    bench.simulated.line()
    eventually(lambda: bench.simulated.counters.dropped == 1)
    time.sleep(0.13)
    faults.control_loss = 0.0
    assert_shows(bench.sink.next(), 1)


def test_without_resend_the_frame_is_lost_and_the_next_is_not(bench: Bench) -> None:
    bench.simulated.faults.no_resend = True
    bench.simulated.faults.lost_packets = (5, 6, 20)
    lost = bench.expose()
    assert isinstance(lost, FrameLost)
    assert lost.camera == "c02"
    assert lost.reason in ("timeout", "missing-packets")
    bench.simulated.faults.clear()
    assert_shows(bench.expose(), 2)
    vitals = bench.camera.examine()
    assert (vitals.frames, vitals.failed_frames) == (1, 1)
    # the camera counts a frame after its last packet, which is here by then
    eventually(lambda: bench.simulated.counters.frames == vitals.frames)
    assert vitals.missing_packets > 0


def test_a_camera_that_stalls_within_a_frame(bench: Bench) -> None:
    bench.simulated.faults.no_resend = True
    bench.simulated.faults.stall_after = 20
    lost = bench.expose()
    assert isinstance(lost, FrameLost)
    assert lost.reason == "timeout"
    bench.simulated.faults.clear()
    assert_shows(bench.expose(), 2)


def test_duplicates_and_another_order_do_no_harm(bench: Bench) -> None:
    bench.simulated.faults.duplicate = 0.3
    bench.simulated.faults.reorder = True
    for n in range(1, 11):
        assert_shows(bench.expose(), n)
    assert bench.camera.examine().frames == bench.simulated.counters.frames == 10


def test_a_swallowed_frame_is_no_event_and_the_next_one_tells(bench: Bench) -> None:
    bench.expose()
    bench.simulated.faults.swallowed_frames = 1
    bench.simulated.line()
    eventually(lambda: bench.simulated.counters.swallowed == 1)
    after = bench.expose()
    assert isinstance(after, Frame)
    assert after.frame_id == 3
    assert len(bench.sink.events) == 2


def test_a_picture_of_the_wrong_size_is_no_frame(bench: Bench) -> None:
    bench.simulated.faults.wrong_size = True
    lost = bench.expose()
    assert isinstance(lost, FrameLost)
    assert lost.reason == f"wrong size: 320 x 120, not {SIZE_PX[0]} x {SIZE_PX[1]}"
    bench.simulated.faults.clear()
    assert_shows(bench.expose(), 2)


@pytest.mark.parametrize("kind", ["short", "foreign", "huge", "abort"])
def test_a_malformed_datagram_does_not_reach_aravis(
    bench: Bench, kind: Literal["short", "foreign", "huge", "abort"]
) -> None:
    """Without the packet filter it is a lost frame, takes memory, or aborts this very process."""
    bench.simulated.send_malformed(kind)
    assert_shows(bench.expose(), 1)
    assert len(bench.sink.events) == 1


def test_what_another_address_sends_does_not_reach_aravis(bench: Bench) -> None:
    leader = struct.pack(">HHI", 0, 1, 1 << 24) + bytes(36)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind((f"{NET}.250", 0))
        for port in udp_ports(INTERFACE):
            stranger.sendto(leader, (INTERFACE, port))
    assert_shows(bench.expose(), 1)
    assert len(bench.sink.events) == 1
    assert bench.camera.examine().failed_frames == 0


def udp_ports(address: str) -> list[int]:
    """Ports of all UDP sockets bound to an address, as the kernel lists them."""
    wanted = f"{int.from_bytes(socket.inet_aton(address), 'little'):08X}"
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return [int(row[1].split(":")[1], 16) for row in rows if row[1].startswith(wanted)]


def test_frames_that_are_kept_stay_what_they_were(bench: Bench) -> None:
    """More than there are buffers, after the camera is closed, too."""
    frames = [bench.expose() for _ in range(20)]
    bench.camera.close()
    for n, frame in enumerate(frames, start=1):
        assert_shows(frame, n)


def test_a_reader_that_is_late_has_buffers_to_spare(bench_of: Callable[..., Bench]) -> None:
    """The sink is slow for one frame; the next four wait in Aravis and come whole."""
    bench = bench_of()
    assert_shows(bench.expose(), 1)
    bench.camera.close()
    bench.camera.open()
    bench.camera.arm(sink := SlowAtFirst())
    for n in range(5):
        bench.simulated.line()
        eventually(lambda n=n: bench.simulated.counters.frames == n + 2)
    sink.go_on()
    for n in range(2, 7):
        assert_shows(sink.next(), n)
