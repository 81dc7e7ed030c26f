"""The belt plays a recording at every pace, and damaged bundles cost only themselves."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from support.collector import Collector
from support.recordings import CAMERAS, DELAY_NS, SPACING_NS, make_bundle, write_recording

from drivers.factory import Devices, ReplayBackend, build_devices
from drivers.interfaces import FrameLost, PlaybackEnded
from pipeline.frames import BundleKind, Frame, Trigger


@contextmanager
def playing(backend: ReplayBackend, sink: Collector) -> Iterator[Devices]:
    devices = build_devices(backend)
    for camera in devices.cameras.values():
        camera.open()
        camera.arm(sink)
    devices.gate.open()
    devices.gate.arm(sink)
    try:
        yield devices
    finally:
        devices.gate.close()
        for camera in devices.cameras.values():
            camera.close()


def recorded(path: Path, n: int = 3) -> Path:
    return write_recording(path, [make_bundle(i) for i in range(1, n + 1)])


@pytest.mark.parametrize("pace", ["fast", "recorded"])
def test_times_within_and_between_bundles_are_as_recorded(tmp_path: Path, pace: str) -> None:
    events = Collector()
    backend = ReplayBackend(
        recording=recorded(tmp_path / "r"),
        pace=pace,  # type: ignore[arg-type]
        speed=10.0 if pace == "recorded" else 1.0,
    )
    started = time.monotonic()
    with playing(backend, events) as devices:
        assert devices.belt is not None
        devices.belt.permit(3)
        events.wait(lambda: bool(events.of(PlaybackEnded)))
    elapsed_s = time.monotonic() - started
    triggers, frames = events.of(Trigger), events.of(Frame)
    assert [trigger.name for trigger in triggers] == ["00000001", "00000002", "00000003"]
    assert len(frames) == 3 * len(CAMERAS)
    start_ns = triggers[0].received_ns
    for number, trigger in enumerate(triggers):
        assert trigger.received_ns == start_ns + number * SPACING_NS
        of_trigger = frames[number * len(CAMERAS) : (number + 1) * len(CAMERAS)]
        for position, frame in enumerate(of_trigger):
            assert frame.received_ns == trigger.received_ns + DELAY_NS + position * 1_000_000
    times = [event.received_ns for event in events.events]
    assert times == sorted(times), "the next trigger comes before the last frames of a slow bundle"
    recorded_s = (2 * SPACING_NS + DELAY_NS) / 1e9
    assert elapsed_s < recorded_s, "ten times as fast, or without waiting"
    if pace == "recorded":
        assert elapsed_s > recorded_s / 10


def test_a_bundle_a_permit(tmp_path: Path) -> None:
    events = Collector()
    with playing(ReplayBackend(recording=recorded(tmp_path / "r"), pace="stepped"), events) as devices:
        assert devices.belt is not None
        for number in (1, 2, 3):
            devices.belt.step()
            events.wait(lambda number=number: len(events.of(Frame)) == number * len(CAMERAS))
            assert len(events.of(Trigger)) == number


def test_background_comes_first_even_when_it_was_recorded_last(tmp_path: Path) -> None:
    bundles = [make_bundle(1), make_bundle(2), make_bundle(3, kind=BundleKind.BACKGROUND)]
    events = Collector()
    backend = ReplayBackend(recording=write_recording(tmp_path / "r", bundles), pace="fast")
    with playing(backend, events) as devices:
        assert devices.belt is not None
        devices.belt.permit(3)
        events.wait(lambda: bool(events.of(PlaybackEnded)))
    assert [trigger.sequence for trigger in events.of(Trigger)] == [3, 1, 2]
    times = [trigger.received_ns for trigger in events.of(Trigger)]
    assert times == sorted(times)


def test_a_loop_goes_on_with_new_names_sequences_and_frame_ids(tmp_path: Path) -> None:
    events = Collector()
    backend = ReplayBackend(recording=recorded(tmp_path / "r", n=2), pace="fast", loop=True)
    with playing(backend, events) as devices:
        assert devices.belt is not None
        devices.belt.permit(6)
        events.wait(lambda: len(events.of(Frame)) == 6 * len(CAMERAS))
    triggers = events.of(Trigger)
    assert [trigger.name for trigger in triggers[:4]] == [
        "00000001",
        "00000002",
        "00000001-r2",
        "00000002-r2",
    ]
    sequences = [trigger.sequence for trigger in triggers]
    assert sequences == sorted(set(sequences))
    ids = [frame.frame_id for frame in events.of(Frame) if frame.camera == CAMERAS[0]]
    assert ids == list(range(ids[0], ids[0] + 6))


def test_a_missing_view_and_a_damaged_bundle_are_lost_frames_not_silence(tmp_path: Path) -> None:
    path = write_recording(
        tmp_path / "r", [make_bundle(1, missing={CAMERAS[2]: "unplugged"}), make_bundle(2), make_bundle(3)]
    )
    damaged, torn = sorted((path / "bundles").iterdir())[1:]
    content = bytearray(damaged.read_bytes())
    content[-400] ^= 0xFF  # in the pixels of the last page
    damaged.write_bytes(content)
    torn.write_bytes(torn.read_bytes()[:60])
    events = Collector()
    with playing(ReplayBackend(recording=path, pace="fast"), events) as devices:
        assert devices.belt is not None
        devices.belt.permit(3)
        events.wait(lambda: bool(events.of(PlaybackEnded)))
        assert list(devices.belt.skipped) == ["00000003"]
    assert len(events.of(Trigger)) == 2
    losses = {(lost.camera, lost.reason) for lost in events.of(FrameLost)}
    assert (CAMERAS[2], "unplugged") in losses
    assert len(losses) == 2
    assert len(events.of(Frame)) == 2 * len(CAMERAS) - 2


def test_the_end_is_told_again_after_arming_again(tmp_path: Path) -> None:
    first, again = Collector(), Collector()
    with playing(ReplayBackend(recording=recorded(tmp_path / "r", n=1), pace="fast"), first) as devices:
        assert devices.belt is not None
        devices.belt.permit(1)
        first.wait(lambda: bool(first.of(PlaybackEnded)))
        devices.gate.disarm()
        devices.gate.arm(again)
        again.wait(lambda: bool(again.of(PlaybackEnded)))


def test_speed_must_be_positive(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="speed"):
        build_devices(ReplayBackend(recording=recorded(tmp_path / "r", n=1), speed=0))
