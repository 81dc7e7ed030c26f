import asyncio
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import TypeAdapter, ValidationError
from support.recordings import CAMERAS, SOURCE, make_bundle

from drivers.files.recording import open_recording
from pipeline.frames import BundleKind
from service.base.status import trouble_check
from service.recording.live_recording import RecordingState
from service.recording.recordings import (
    KEPT_BACKGROUNDS,
    RecordingRefusedError,
    RecordingRequest,
    Recordings,
    RecordingsSettings,
    Refusal,
)


def opened(folder: Path, **settings) -> Recordings:
    return Recordings(
        folder, SOURCE, RecordingsSettings(**{"reserve_gb": 0.0} | settings), {"command": "test"}
    )


def offer(recordings: Recordings, *sequences: int, kind: BundleKind = BundleKind.PARTICLE) -> None:
    for sequence in sequences:
        recordings.offer(make_bundle(sequence, kind=kind))


def names_in(path: Path) -> list[str]:
    return sorted(entry.name for entry in path.iterdir())


def sequences_in(path: Path) -> list[int]:
    return [header.sequence for header in open_recording(path).headers]


async def test_a_recording_begins_in_the_past_with_what_makes_it_measurable(tmp_path: Path):
    recordings = opened(tmp_path, pre_trigger=3)
    offer(recordings, *range(1, 8), kind=BundleKind.BACKGROUND)
    offer(recordings, 8, 9, 10)
    offer(recordings, 11, kind=BundleKind.BACKGROUND)
    offer(recordings, 12)
    recordings.offer(make_bundle(13, missing=dict.fromkeys(CAMERAS, "no_frame")))
    started = await recordings.start(RecordingRequest(name="r1", count=2, pre_trigger=2))
    assert (started.name, started.state) == ("r1", RecordingState.RECORDING)
    offer(recordings, 14, 15, 16)
    stopped = await recordings.stop("r1")
    assert stopped is not None
    assert (stopped.state, stopped.ended_by) == (RecordingState.COMPLETE, "count")
    newest = [*range(1, 8), 11][-KEPT_BACKGROUNDS:]
    assert sequences_in(tmp_path / "r1") == sorted([*newest, 10, 12, 14, 15])
    assert stopped.made_by == {
        "command": "test",
        "count": 2,
        "duration_s": None,
        "pre_trigger": 2,
        "ended_by": "count",
        "without_frames": 0,
    }


@pytest.mark.parametrize("kept", [0, 2])
async def test_no_more_of_the_past_than_is_kept(tmp_path: Path, kept: int):
    recordings = opened(tmp_path, pre_trigger=kept)
    offer(recordings, 1, 2, 3)
    await recordings.start(RecordingRequest(name="r1", count=1, pre_trigger=100))
    offer(recordings, 4)
    await recordings.close()
    assert sequences_in(tmp_path / "r1") == [1, 2, 3, 4][3 - kept :]


async def test_one_at_a_time_and_every_name_once(tmp_path: Path):
    recordings = opened(tmp_path)
    plans = [RecordingRequest(name=name, count=5) for name in ("r1", "r2")]
    results = await asyncio.gather(*map(recordings.start, plans), return_exceptions=True)
    (refused,) = [error for error in results if isinstance(error, RecordingRefusedError)]
    assert refused.kind is Refusal.RUNNING
    (running,) = await recordings.all()
    offer(recordings, 1)
    assert (await recordings.stop(running.name)) == await recordings.stop(running.name)
    with pytest.raises(RecordingRefusedError, match=running.name) as caught:
        await recordings.start(RecordingRequest(name=running.name, count=1))
    assert caught.value.kind is Refusal.EXISTS
    await recordings.start(RecordingRequest(name="r3", count=1))
    offer(recordings, 2)
    await recordings.close()
    assert [(status.name, status.bundles) for status in await recordings.all()] == [
        (running.name, 1),
        ("r3", 1),
    ]
    assert await recordings.stop("r4") is None


async def test_failures_are_told_until_the_next_recording(tmp_path: Path):
    recordings = opened(tmp_path)
    assert recordings.trouble is None
    await recordings.start(RecordingRequest(name="r1", count=1))
    stopped = await recordings.stop("r1")
    assert stopped is not None
    assert stopped.state is RecordingState.FAILED
    assert recordings.trouble == "recording r1: nothing was recorded, it ended by stop"
    assert recordings.checks() == {"recording": trouble_check(recordings.trouble)}
    assert await recordings.all() == [stopped]
    await recordings.start(RecordingRequest(name="r1", count=1))  # a name that holds nothing is free
    assert recordings.trouble is None
    offer(recordings, 1)
    await recordings.close()
    assert [status.state for status in await recordings.all()] == [RecordingState.COMPLETE]
    assert recordings.trouble is None


async def test_without_room_nothing_is_started(tmp_path: Path):
    recordings = opened(tmp_path, reserve_gb=100_000.0)
    with pytest.raises(RecordingRefusedError, match="make room or record less") as caught:
        await recordings.start(RecordingRequest(name="r1", count=1))
    assert caught.value.kind is Refusal.NO_ROOM
    assert await recordings.all() == []


async def test_the_next_start_finds_what_is_complete_and_removes_what_is_not(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    recordings = opened(tmp_path)
    offer(recordings, 1)
    await recordings.start(RecordingRequest(name="r1", count=1, pre_trigger=1))
    offer(recordings, 2)
    await recordings.close()
    (tmp_path / ".r2.4711.unfinished" / "bundles").mkdir(parents=True)  # as a killed daemon leaves it
    (tmp_path / "damaged").mkdir()
    again = opened(tmp_path)
    assert "r2" in caplog.text
    damaged, complete = await again.all()
    assert (damaged.name, damaged.state) == ("damaged", RecordingState.FAILED)
    assert damaged.reason is not None
    assert damaged.reason.startswith("recording.json cannot be read")
    assert [complete] == [status for status in await recordings.all() if status.name == "r1"]
    assert (complete.bundles, complete.ended_by) == (2, "count")
    assert names_in(tmp_path) == ["damaged", "r1"]


@pytest.mark.parametrize(
    "document", ["[]", "7", '{"made_by": []}', '{"made_by": {"ended_by": 3}, "created_at": 1}']
)
async def test_a_strange_document_hides_no_other(tmp_path: Path, document: str):
    for name in ("strange", "other"):
        (tmp_path / name).mkdir()
    (tmp_path / "strange" / "recording.json").write_text(document)
    (tmp_path / "other" / "recording.json").write_text("{}")
    recordings = opened(tmp_path)
    other, strange = await recordings.all()
    assert other.state is RecordingState.COMPLETE
    assert (strange.state is RecordingState.FAILED) == ("ended_by" not in document)
    assert all(value is None or isinstance(value, str) for value in (strange.created_at, strange.ended_by))
    assert await recordings.find("strange") == strange


async def test_one_recording_is_found_without_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    (tmp_path.parent / "c").mkdir(exist_ok=True)
    looked_at = []
    monkeypatch.setattr("service.recording.recordings.read_json", looked_at.append)
    recordings = opened(tmp_path)
    for name in ("a", "d", "../c", "*"):
        await recordings.find(name)
    assert looked_at == [tmp_path / "a" / "recording.json"]


@pytest.mark.parametrize(
    ("plan", "field"),
    [
        ({"name": "../escape"}, "name"),
        ({"name": ".hidden"}, "name"),
        ({"name": ""}, "name"),
        ({"name": "x" * 65}, "name"),
        ({"name": "ok\n"}, "name"),
        ({"name": "ok", "count": 0}, "count"),
        ({"name": "ok", "duration_s": 0.0}, "duration_s"),
        ({"name": "ok", "duration_s": float("nan")}, "duration_s"),
        ({"name": "ok", "pre_trigger": -1}, "pre_trigger"),
    ],
)
def test_plans_are_checked(plan, field):
    with pytest.raises(ValidationError, match=f"\n{field}\n"):
        TypeAdapter(RecordingRequest).validate_python({"count": 1, **plan})


def test_a_recording_must_end():
    with pytest.raises(ValueError, match="a recording must end"):
        RecordingRequest(name="endless")


@pytest.mark.parametrize(
    "settings", [{"pre_trigger": -1}, {"reserve_gb": -1.0}, {"reserve_gb": float("nan")}]
)
def test_settings_are_checked(settings):
    (field,) = settings
    with pytest.raises(ValueError, match=f"^{field} "):
        RecordingsSettings(**settings)


async def test_a_recording_names_the_calibration_in_use(tmp_path: Path):
    recordings = opened(tmp_path)
    later = replace(SOURCE.rig, name="calibrated anew")
    recordings.use_rig(later)
    await recordings.start(RecordingRequest(name="r1", count=1))
    offer(recordings, 1)
    await recordings.stop("r1")
    rig = open_recording(tmp_path / "r1").rig
    assert rig is not None
    assert rig.calibration_id == later.calibration_id
