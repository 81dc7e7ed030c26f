import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.recordings import (
    CAMERAS,
    SIZE_PX,
    SOURCE,
    assert_same_bundle,
    make_bundle,
    small_rig,
    write_recording,
)

from drivers.errors import RecordingError
from drivers.files.bundle_header import header_text
from drivers.files.recording import RecordingWriter, open_recording, playback_order, read_bundle
from drivers.files.rig_file import read_rig, write_rig
from pipeline.fall import Fall
from pipeline.frames import BundleKind, CameraId, NearStone


def names_in_playback(path: Path) -> list[str]:
    return [header.name for header in playback_order(open_recording(path))]


def test_a_recording_gives_back_what_was_added(tmp_path: Path) -> None:
    bundles = [make_bundle(2), make_bundle(0, kind=BundleKind.BACKGROUND, name="empty"), make_bundle(1)]
    path = write_recording(tmp_path / "rec", bundles)
    recording = open_recording(path)
    assert recording.camera_ids == CAMERAS
    assert recording.image_size_px == SIZE_PX
    assert recording.is_simulated
    assert recording.rig_name == "small"
    assert recording.rig is not None
    assert recording.rig.calibration_id == small_rig().calibration_id
    assert recording.unreadable == ()
    assert [header.sequence for header in recording.headers] == [0, 1, 2]
    by_sequence = sorted(bundles, key=lambda bundle: bundle.trigger.sequence)
    for header, bundle in zip(recording.headers, by_sequence, strict=True):
        assert_same_bundle(read_bundle(header.path, recording.camera_ids), bundle)


def test_how_stones_fell_from_the_gate(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "rec", [make_bundle(0)])
    assert open_recording(path).fall == Fall()
    document = json.loads((path / "recording.json").read_text())

    def fall_of(gate_settings: object) -> Fall:
        (path / "recording.json").write_text(json.dumps(document | {"gate_settings": gate_settings}))
        return open_recording(path).fall

    assert fall_of({"port": "gate"}) == Fall()
    assert fall_of({"speed_at_gate_mm_s": 313}) == Fall(speed_at_gate_mm_s=313)
    assert fall_of({"fall_height_mm": 450.5}) == Fall(height_mm=450.5)
    for name in ("speed_at_gate_mm_s", "fall_height_mm"):
        for wrong in (-1, "313", None, float("nan"), float("inf")):
            with pytest.raises(RecordingError, match=rf"recording\.json: gate_settings\.{name}: must be in"):
                fall_of({name: wrong})
    with pytest.raises(RecordingError, match=r"recording\.json: gate_settings: must be an object, not \[\]"):
        fall_of([])


def test_stones_near_in_time_are_recorded_with_a_bundle(tmp_path: Path) -> None:
    near = (NearStone(-21_000_000, 9_000_000), NearStone(17_500_000))
    bundle = make_bundle(1)
    crowded = replace(bundle, trigger=replace(bundle.trigger, near_stones=near))
    path = write_recording(tmp_path / "rec", [make_bundle(0), crowded])
    alone, found = (read_bundle(header.path, CAMERAS) for header in open_recording(path).headers)
    assert found.trigger.near_stones == near
    assert alone.trigger.near_stones == ()
    frames = list(alone.frames.values())
    assert "near_stones" not in header_text(alone, frames, [frame.image for frame in frames])


def test_background_comes_before_the_first_stone(tmp_path: Path) -> None:
    empty = BundleKind.BACKGROUND
    late = [
        make_bundle(0),
        make_bundle(1),
        make_bundle(2, kind=empty),
        make_bundle(3),
        make_bundle(4, kind=empty),
    ]
    path = write_recording(tmp_path / "late", late)
    assert names_in_playback(path) == ["00000002", "00000004", "00000000", "00000001", "00000003"]
    first = [make_bundle(0, kind=empty), make_bundle(1), make_bundle(2, kind=empty)]
    path = write_recording(tmp_path / "first", first)
    assert names_in_playback(path) == ["00000000", "00000001", "00000002"]


def test_the_folder_appears_only_when_all_is_well(tmp_path: Path) -> None:
    path = tmp_path / "rec"
    with pytest.raises(ZeroDivisionError):
        write_recording(path, (make_bundle(i // (1 - i)) for i in range(2)))
    assert list(tmp_path.iterdir()) == []
    path.mkdir()
    write_recording(path, [make_bundle(0)])
    with pytest.raises(RecordingError, match="exists already"):
        write_recording(path, [make_bundle(1)])
    assert names_in_playback(path) == ["00000000"]


def test_the_writer_refuses_what_does_not_belong(tmp_path: Path) -> None:
    def write(*bundles: Any) -> None:
        write_recording(tmp_path / "rec", bundles)

    with pytest.raises(RecordingError, match="already has a bundle 00000001"):
        write(make_bundle(1), make_bundle(1))
    for name in ("../x", ".x", "a/b"):
        with pytest.raises(RecordingError, match="cannot be the name"):
            write(make_bundle(1, name=name))
    bundle = make_bundle(1)
    odd = replace(bundle.frames[CAMERAS[0]], image=np.zeros((4, 4), np.uint8))
    with pytest.raises(RecordingError, match="camera c01: images of 4x4 in a recording of 64x48 px"):
        write(replace(bundle, frames={**bundle.frames, CAMERAS[0]: odd}))
    other = replace(SOURCE, rig=small_rig([CameraId(f"x{i}") for i in range(4)]))
    with pytest.raises(RecordingError, match="rig of other cameras: it has no c01"):
        RecordingWriter(tmp_path / "rec", other, made_by={})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "stonefall-recording/2"}, "of a later version: update stonefall"),
        ({"format": "stonefall-rig/1"}, "format: must be"),
        ({"cameras": "c01"}, "cameras: must be a list"),
        ({"cameras": ["c01", "c01"]}, "an id occurs twice"),
        ({"cameras": ["c01", "c02", "c03", "x"]}, "rig of other cameras: it has no x"),
        ({"cameras": ["c01", "c02"]}, r"none of its 1 bundles can be used; .*does not have: c03, c04"),
        ({"image_size_px": [64]}, "image_size_px: must be"),
        ({"image_size_px": [640, 480]}, r"rig\.json: camera c01: images of 64x48 in a recording of 640x480"),
        ({"is_simulated": "yes"}, "is_simulated: must be true or false"),
    ],
)
def test_a_wrong_document_is_refused_with_the_field(
    tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    path = write_recording(tmp_path / "rec", [make_bundle(0)])
    document = json.loads((path / "recording.json").read_text())
    (path / "recording.json").write_text(json.dumps(document | change))
    with pytest.raises(RecordingError, match=message):
        open_recording(path)


def test_what_is_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"has no recording\.json"):
        open_recording(tmp_path / "nowhere")
    path = write_recording(tmp_path / "rec", [make_bundle(0)])
    shutil.rmtree(path / "bundles")
    with pytest.raises(RecordingError, match="holds no bundle"):
        open_recording(path)
    (path / "recording.json").write_text("{")
    with pytest.raises(RecordingError, match=r"recording\.json: is not JSON"):
        open_recording(path)


def test_a_bad_bundle_does_not_spoil_the_others(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "rec", [make_bundle(i) for i in range(4)])
    bundles = path / "bundles"
    (bundles / "00000001.tiff").write_bytes(b"II*\0")
    shutil.copy(bundles / "00000002.tiff", bundles / "copy.tiff")
    recording = open_recording(path)
    assert [header.sequence for header in recording.headers] == [0, 2, 3]
    problems = {error.path.name: error.problem for error in recording.unreadable}
    assert set(problems) == {"00000001.tiff", "copy.tiff"}
    assert "renamed or copied" in problems["copy.tiff"]


def test_rig_files(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    write_rig(path, small_rig())
    assert read_rig(path).calibration_id == small_rig().calibration_id
    document = json.loads(path.read_text())
    document["cameras"][1]["K"][0][0] *= 2
    path.write_text(json.dumps(document))
    with pytest.raises(RecordingError, match=r"rig\.json: checksum: does not match"):
        read_rig(path)
    del document["checksum"]
    del document["cameras"][1]["R"]
    path.write_text(json.dumps(document))
    with pytest.raises(RecordingError, match=r"rig\.json: cameras\[1\]\.R: is missing"):
        read_rig(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(RecordingError, match="is not JSON"):
        read_rig(path)
    with pytest.raises(RecordingError, match="cannot be read: No such file"):
        read_rig(tmp_path / "other.json")


@pytest.mark.parametrize("camera", ["../evil", "", "c 1", "é"])
def test_camera_ids_cannot_be_paths(tmp_path: Path, camera: str) -> None:
    path = write_recording(tmp_path / "r", [make_bundle(0)])
    document = json.loads((path / "recording.json").read_text())
    document["cameras"][0] = camera
    (path / "recording.json").write_text(json.dumps(document))
    with pytest.raises(RecordingError, match=r"recording\.json: cameras: "):
        open_recording(path)
