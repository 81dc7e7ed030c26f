import asyncio
import shutil
import threading
from collections import namedtuple
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from support.eventually import PATIENCE_S
from support.recordings import CAMERAS, assert_same_bundle, make_bundle, small_rig

from drivers.files.recording import (
    RecordingSource,
    RecordingWriter,
    open_recording,
    playback_order,
    read_bundle,
)
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle
from service.recording.live_recording import (
    MAX_WAITING,
    EndedBy,
    LiveRecording,
    RecordingState,
)

SOURCE = RecordingSource(
    camera_ids=CAMERAS, rig=small_rig(), is_simulated=False, camera_settings={"gain_db": 6}
)


def live_recording(path: Path, *, compression="zstd", reserve_bytes: int = 0, **options) -> LiveRecording:
    writer = RecordingWriter(path, SOURCE, made_by={"command": "test"}, compression=compression)
    return LiveRecording(writer, room_needed_bytes=reserve_bytes + SOURCE.bundle_bytes, **options)


async def closed(recording: LiveRecording) -> LiveRecording:
    async with asyncio.timeout(PATIENCE_S):
        await recording.closed.wait()
    return recording


def bundles_in(path: Path) -> list[FrameBundle]:
    return [read_bundle(header.path, CAMERAS) for header in playback_order(open_recording(path))]


def names_in(path: Path) -> list[str]:
    return sorted(entry.name for entry in path.iterdir())


class SlowFrames(dict[CameraId, Frame]):
    """Frames that reach the disk only when a test says so."""

    def __init__(self, frames) -> None:
        super().__init__(frames)
        self.has_begun = threading.Event()
        self.may_end = threading.Event()

    def values(self):
        self.has_begun.set()
        self.may_end.wait(PATIENCE_S)
        return super().values()


def slow_bundle(sequence: int) -> tuple[FrameBundle, SlowFrames]:
    bundle = make_bundle(sequence, name=f"slow{sequence}")
    frames = SlowFrames(bundle.frames)
    return replace(bundle, frames=frames), frames


async def test_what_was_offered_is_what_is_recorded(tmp_path: Path):
    path = tmp_path / "new" / "recording"
    given = [
        make_bundle(0, kind=BundleKind.BACKGROUND, name="empty"),
        make_bundle(1, name="one"),
        make_bundle(2, name="two", missing={CAMERAS[1]: "no_frame"}),
    ]
    statuses = []
    recording = live_recording(path, on_closed=statuses.append)
    recording.start()
    for bundle in given:
        recording.offer(bundle)
    assert not path.exists()  # before it is complete
    recording.end(EndedBy.STOP)
    recording.offer(make_bundle(3))
    await closed(recording)
    for found, expected in zip(bundles_in(path), given, strict=True):
        assert_same_bundle(found, expected)
    written = open_recording(path)
    assert written.rig is not None
    assert written.rig.calibration_id == SOURCE.rig.calibration_id
    assert written.document["camera_settings"] == {"gain_db": 6}
    made_by = {"command": "test", "ended_by": "stop", "without_frames": 0}
    assert written.document["made_by"] == made_by
    (status,) = statuses
    assert status == recording.status()
    assert (status.state, status.bundles, status.made_by) == (RecordingState.COMPLETE, 3, made_by)
    assert status.bytes == sum(file.stat().st_size for file in (path / "bundles").iterdir())
    assert (status.created_at, recording.stones) == (written.document["created_at"], 2)


async def test_only_stones_after_the_start_count(tmp_path: Path):
    earlier = [make_bundle(1, kind=BundleKind.BACKGROUND), make_bundle(2)]
    recording = live_recording(tmp_path / "recording", count=2, earlier=earlier)
    recording.start()
    recording.offer(make_bundle(3, missing=dict.fromkeys(CAMERAS, "no_frame")))  # a file cannot hold it
    recording.offer(make_bundle(4, kind=BundleKind.BACKGROUND))
    for sequence in (5, 6, 7):
        recording.offer(make_bundle(sequence))
    await closed(recording)
    assert [bundle.trigger.sequence for bundle in bundles_in(tmp_path / "recording")] == [1, 2, 4, 5, 6]
    assert (recording.ended_by, recording.without_frames) == (EndedBy.COUNT, 1)


async def test_it_ends_after_its_time(tmp_path: Path):
    recording = live_recording(tmp_path / "recording")
    recording.start(duration_s=0.05)
    recording.offer(make_bundle(1))
    assert (await closed(recording)).ended_by is EndedBy.DURATION
    assert len(bundles_in(tmp_path / "recording")) == 1


async def test_a_disk_too_slow_ends_the_recording_and_delays_nothing(tmp_path: Path):
    slow, frames = slow_bundle(1)
    recording = live_recording(tmp_path / "recording", earlier=[slow])
    recording.start()
    await asyncio.to_thread(frames.has_begun.wait, 10)
    # all this happens while the disk does nothing at all
    for sequence in range(2, MAX_WAITING + 10):
        recording.offer(make_bundle(sequence))
    assert recording.ended_by is EndedBy.SLOW_DISK
    assert recording.status().state is RecordingState.RECORDING
    frames.may_end.set()
    await closed(recording)
    kept = [bundle.trigger.sequence for bundle in bundles_in(tmp_path / "recording")]
    assert kept == list(range(1, len(kept) + 1))
    assert MAX_WAITING <= len(kept) <= MAX_WAITING + 2
    assert recording.status().is_cut_short


async def test_the_reserve_of_free_space_is_not_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    free_bytes = iter([SOURCE.bundle_bytes + 5000, SOURCE.bundle_bytes + 5000, SOURCE.bundle_bytes + 4999])
    usage = namedtuple("usage", "free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(next(free_bytes)))
    recording = live_recording(tmp_path / "recording", reserve_bytes=5000)
    recording.start()
    for sequence in (1, 2, 3, 4):
        recording.offer(make_bundle(sequence))
    assert (await closed(recording)).ended_by is EndedBy.LOW_DISK
    assert len(bundles_in(tmp_path / "recording")) == 2
    assert open_recording(tmp_path / "recording").document["made_by"]["ended_by"] == "low_disk"


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ([], "nothing was recorded, it ended by stop"),
        ([make_bundle(1), make_bundle(2, name="a/b")], "'a/b' cannot be the name of a file"),
        ([make_bundle(1, name="same"), make_bundle(2, name="same")], "already has a bundle same"),
    ],
)
async def test_a_recording_that_fails_leaves_nothing(
    tmp_path: Path, given: Sequence[FrameBundle], reason: str
):
    recording = live_recording(tmp_path / "recording")
    recording.start()
    for bundle in given:
        recording.offer(bundle)
    recording.end(EndedBy.STOP)
    await closed(recording)
    assert reason in str(recording.status().reason)
    assert recording.status().state is RecordingState.FAILED
    assert names_in(tmp_path) == []


async def test_an_io_error_is_a_reason_without_paths(tmp_path: Path):
    slow, frames = slow_bundle(1)
    recording = live_recording(tmp_path / "recording")
    recording.start()
    recording.offer(slow)
    await asyncio.to_thread(frames.has_begun.wait, 10)
    (unfinished,) = names_in(tmp_path)
    shutil.rmtree(tmp_path / unfinished)  # as if the disk were gone
    frames.may_end.set()
    await closed(recording)
    assert recording.status().reason == "cannot be written: No such file or directory"
    recording.offer(make_bundle(2))  # ignored
    assert names_in(tmp_path) == []


async def test_the_name_must_be_free_when_it_is_taken(tmp_path: Path):
    (tmp_path / "recording").mkdir()
    (tmp_path / "recording" / "file").touch()
    recording = live_recording(tmp_path / "recording")
    recording.start()
    assert (await closed(recording)).status().reason == "exists already"


async def test_a_gate_that_counts_anew_does_not_mix_up_the_order(tmp_path: Path):
    sequences = [7, 8, 1, 2, 3, 20]
    recording = live_recording(tmp_path / "recording", compression="none")
    recording.start()
    for number, sequence in enumerate(sequences):
        recording.offer(make_bundle(sequence, name=f"b{number}"))
    recording.end(EndedBy.STOP)
    await closed(recording)
    written = bundles_in(tmp_path / "recording")
    assert [bundle.name for bundle in written] == [f"b{number}" for number in range(len(sequences))]
    # numbered on; gaps stay, because they are lost triggers
    assert [bundle.trigger.sequence for bundle in written] == [7, 8, 9, 10, 11, 28]
