import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support.recordings import (
    CAMERAS,
    DELAY_NS,
    SPACING_NS,
    make_bundle,
    tagged_image,
    write_recording,
)
from support.sinks import Collector

from drivers.errors import CameraUnavailableError
from drivers.files.recording import open_recording
from drivers.interfaces import DeviceEvent, FrameLossReason, FrameLost, PlaybackEnded
from drivers.replay.belt import MAX_SPACING_NS, Pace, ReplayBelt
from drivers.replay.camera import ReplayCamera
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Trigger


@contextmanager
def playing(
    path: Path,
    *,
    pace: Pace = "fast",
    permits: int = 1000,
    speed: float = 1.0,
    loop: bool = False,
    cameras: Sequence[CameraId] = CAMERAS,
) -> Iterator[tuple[ReplayBelt, Collector]]:
    """A belt with all its sinks in one collector."""
    belt = ReplayBelt(open_recording(path), pace=pace, speed=speed, loop=loop)
    sink = Collector()
    for camera in cameras:
        belt.cameras[camera].plug(sink)
    belt.permit(permits)
    belt.start(sink)
    try:
        yield belt, sink
    finally:
        belt.stop()


def until_the_end(sink: Collector) -> list[DeviceEvent]:
    while not isinstance(sink.next(), PlaybackEnded):
        pass
    return sink.events[:-1]


def triggers(events: Sequence[DeviceEvent]) -> list[Trigger]:
    return [event for event in events if isinstance(event, Trigger)]


def recorded(tmp_path: Path, bundles: Sequence[FrameBundle]) -> Path:
    return write_recording(tmp_path / "rec", bundles)


@pytest.mark.parametrize("pace", ["recorded", "fast", "stepped"])
def test_everything_comes_in_time_order_with_recorded_differences(tmp_path: Path, pace: Pace) -> None:
    path = recorded(tmp_path, [make_bundle(number) for number in range(4)])
    with playing(path, pace=pace, speed=10) as (belt, sink):
        events = until_the_end(sink)
        assert sink.threads == {"replay belt"}
        assert events[-1].received_ns <= belt.clock()
    assert all(earlier.received_ns <= later.received_ns for earlier, later in pairwise(events))
    # the next stone passes the gate before the last one is seen: 250 ms < 259.4 ms
    assert [type(event).__name__ for event in events[:4]] == ["Trigger", "Trigger", "Frame", "Frame"]
    seen = triggers(events)
    assert [trigger.name for trigger in seen] == [f"{number:08d}" for number in range(4)]
    assert {later.received_ns - earlier.received_ns for earlier, later in pairwise(seen)} == {SPACING_NS}
    for number, trigger in enumerate(seen):
        for i, camera in enumerate(CAMERAS):
            (frame,) = (
                event
                for event in events
                if isinstance(event, Frame) and (event.camera, event.frame_id) == (camera, number + 1)
            )
            assert np.array_equal(frame.image, tagged_image(number, camera))
            assert frame.received_ns - trigger.received_ns == DELAY_NS + 1_000_000 * i
            assert frame.device_ns - trigger.device_ns == 7_000_000_000 * (i + 1)


def test_recorded_pace_takes_its_time(tmp_path: Path) -> None:
    path = recorded(tmp_path, [make_bundle(number) for number in range(5)])
    started_s = time.monotonic()
    with playing(path, pace="recorded", speed=8) as (_, sink):
        until_the_end(sink)
    assert time.monotonic() - started_s >= (4 * SPACING_NS + DELAY_NS) / 1e9 / 8


def test_fast_jumps_over_pauses(tmp_path: Path) -> None:
    bundles = [make_bundle(number) for number in (0, 1, 200)]
    started_s = time.monotonic()
    with playing(recorded(tmp_path, bundles)) as (_, sink):
        seen = triggers(until_the_end(sink))
    assert time.monotonic() - started_s < 10
    assert [later.received_ns - earlier.received_ns for earlier, later in pairwise(seen)] == [
        SPACING_NS,
        199 * SPACING_NS,
    ]


def test_spacing_is_invented_where_the_order_was_changed_or_days_lie_between(tmp_path: Path) -> None:
    bundles = [make_bundle(0), make_bundle(1), make_bundle(2, kind=BundleKind.BACKGROUND), make_bundle(10**6)]
    with playing(recorded(tmp_path, bundles)) as (_, sink):
        seen = triggers(until_the_end(sink))
    assert [trigger.sequence for trigger in seen] == [2, 0, 1, 10**6]
    assert [later.received_ns - earlier.received_ns for earlier, later in pairwise(seen)] == [
        SPACING_NS,
        SPACING_NS,
        MAX_SPACING_NS,
    ]


def test_without_a_permit_nothing_passes_but_time(tmp_path: Path) -> None:
    path = recorded(tmp_path, [make_bundle(number) for number in range(4)])
    with playing(path, permits=2) as (belt, sink):
        for _ in range(2 * (1 + len(CAMERAS))):
            sink.next()
        last_ns = max(event.received_ns for event in sink.events)
        while belt.clock() <= last_ns + 5_000_000:  # deadlines pass although the belt waits
            time.sleep(0.001)
        assert len(triggers(sink.events)) == 2
        now_ns = belt.clock()
        belt.step()
        assert isinstance(third := sink.next(), Trigger)
        assert third.received_ns >= now_ns


def test_a_loop_counts_on_under_new_names(tmp_path: Path) -> None:
    path = recorded(tmp_path, [make_bundle(number, name=f"n{number}") for number in (3, 4)])
    with playing(path, permits=5, loop=True, cameras=CAMERAS[:1]) as (_, sink):
        events = [sink.next() for _ in range(10)]
    seen = triggers(events)
    assert [trigger.name for trigger in seen] == ["n3", "n4", "n3-r2", "n4-r2", "n3-r3"]
    assert all(later.sequence > earlier.sequence for earlier, later in pairwise(seen))
    ids = [event.frame_id for event in events if isinstance(event, Frame)]
    assert ids == [4, 5, 6, 7, 8]
    devices_ns = [event.device_ns for event in events if isinstance(event, Frame)]
    assert {later - earlier for earlier, later in pairwise(devices_ns)} == {SPACING_NS}


def test_missing_and_damaged_views_are_told(tmp_path: Path) -> None:
    bundles = [make_bundle(0, missing={CAMERAS[1]: "no_image"}), make_bundle(1), make_bundle(2)]
    path = recorded(tmp_path, bundles)
    torn = path / "bundles" / "00000001.tiff"
    content = torn.read_bytes()
    torn.write_bytes(content[:-2000])  # the last page
    with playing(path) as (_, sink):
        events = until_the_end(sink)
    losses = [(event.camera, event.reason) for event in events if isinstance(event, FrameLost)]
    assert losses == [(CAMERAS[1], "no_image"), (CAMERAS[3], "damaged")]
    assert sum(isinstance(event, Frame) for event in events) == 10


def test_a_damaged_view_is_told_in_every_round_of_a_loop(tmp_path: Path) -> None:
    path = recorded(tmp_path, [make_bundle(0), make_bundle(1)])
    torn = path / "bundles" / "00000001.tiff"
    torn.write_bytes(torn.read_bytes()[:-2000])
    n_rounds, n_events = 3, 2 * (1 + len(CAMERAS))
    with playing(path, permits=2 * n_rounds, loop=True) as (_, sink):
        events = [sink.next() for _ in range(n_rounds * n_events)]
    losses = [(event.camera, event.reason) for event in events if isinstance(event, FrameLost)]
    assert losses == n_rounds * [(CAMERAS[3], "damaged")]


def test_what_cannot_be_read_still_triggers_after_all_others(tmp_path: Path) -> None:
    path = recorded(tmp_path, [make_bundle(number) for number in range(3)])
    (path / "bundles" / "00000001.tiff").write_bytes(b"")
    belt = ReplayBelt(open_recording(path), pace="fast")
    (path / "bundles" / "00000002.tiff").unlink()  # after the recording was opened
    sink = Collector()
    for outlet in belt.cameras.values():
        outlet.plug(sink)
    belt.permit(3)
    belt.start(sink)
    events = until_the_end(sink)
    belt.stop()
    names = [event.name for event in events if isinstance(event, Trigger)]
    assert names == ["00000000", "00000002", "00000001"]
    lost = [event for event in events if isinstance(event, FrameLost)]
    assert {event.reason for event in lost} == {FrameLossReason.UNREADABLE}
    assert [event.problem for event in lost[:4]] == ["does not exist"] * 4
    assert all(event.problem for event in lost[4:])
    assert len(lost) == 8


def test_a_bundle_without_a_sound_page_still_triggers(tmp_path: Path) -> None:
    path = recorded(tmp_path, [make_bundle(0)])
    belt = ReplayBelt(open_recording(path), pace="stepped")
    file = path / "bundles" / "00000000.tiff"
    content = bytearray(file.read_bytes())
    for i in range(3000, len(content) - 500, 50):
        content[i] ^= 0xFF
    file.write_bytes(content)
    sink = Collector()
    for outlet in belt.cameras.values():
        outlet.plug(sink)
    belt.start(sink)
    belt.step()
    events = until_the_end(sink)
    belt.stop()
    assert isinstance(events[0], Trigger)
    assert [(event.camera, event.problem) for event in events[1:] if isinstance(event, FrameLost)] == [
        (camera, "every page is damaged") for camera in CAMERAS
    ]
    assert {event.received_ns - events[0].received_ns for event in events[1:]} == {DELAY_NS + 1_000_000}


def test_the_end_is_told_again_after_rearming(tmp_path: Path) -> None:
    with playing(recorded(tmp_path, [make_bundle(0)])) as (belt, sink):
        until_the_end(sink)
        belt.pause()
        belt.start(again := Collector())
        assert isinstance(again.next(), PlaybackEnded)
        belt.stop()
        belt.start(after_stop := Collector())
        assert isinstance(after_stop.next(), PlaybackEnded)


def test_a_device_clock_that_is_not_there_stays_so(tmp_path: Path) -> None:
    bundle = make_bundle(0)
    frames = {camera: replace(frame, device_ns=0) for camera, frame in bundle.frames.items()}
    with playing(recorded(tmp_path, [replace(bundle, frames=frames)])) as (_, sink):
        events = until_the_end(sink)
    assert {event.device_ns for event in events if isinstance(event, Frame)} == {0}


def test_an_unknown_camera_is_unavailable(tmp_path: Path) -> None:
    belt = ReplayBelt(open_recording(recorded(tmp_path, [make_bundle(0)])))
    with pytest.raises(CameraUnavailableError, match="c99: is not in the recording"):
        ReplayCamera(CameraId("c99"), belt).open()
    with pytest.raises(ValueError, match="speed must be positive"):
        ReplayBelt(belt.recording, speed=0)
