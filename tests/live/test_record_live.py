"""`stonefall record` on the real Aravis driver: what it records is, pixel by pixel, what the cameras were given."""

import json
from pathlib import Path

import pytest
from support.live_rig import eventually, live_section, simulated_rig
from support.small_recording import write_small_recording
from support.warm_stonefall import start_stonefall

from drivers.files.recording import open_recording, playback_order, read_bundle
from pipeline.frames import BundleKind

N_STONES = 4


@pytest.mark.full
def test_a_live_rig_is_recorded(tmp_path: Path) -> None:
    write_small_recording(tmp_path / "source", n_stones=N_STONES)
    source = open_recording(tmp_path / "source")
    given = {
        (camera, frame.image.tobytes()): header.name
        for header in source.headers
        for camera, frame in read_bundle(header.path, source.camera_ids).frames.items()
    }
    with simulated_rig(tmp_path, tmp_path / "source", number=1) as rig:
        config = tmp_path / "stonefall.toml"
        section = live_section(rig, tmp_path, tmp_path / "source", by_address=True)
        config.write_text(
            f'{section}[spool]\ndir = "spool"\n[store]\ndir = "state"\n[recordings]\nreserve_gb = 0.1\n'
        )
        arguments = ("record", tmp_path / "out", "--config", config, "--count", str(N_STONES), "--json")
        process = start_stonefall(*arguments)
        pattern = ".out.*.unfinished/bundles/*.tiff"
        eventually(lambda: len(list(tmp_path.glob(pattern))) >= 2, "the empty rig is recorded")
        rig.belt.start()
        output, _ = process.communicate()
    assert process.returncode == 0
    summary = json.loads(output)
    assert (summary["stones"], summary["without_frames"], summary["ended_by"]) == (N_STONES, 0, "count")

    recorded = open_recording(tmp_path / "out")
    assert recorded.is_simulated
    assert recorded.rig is not None
    assert recorded.document["camera_settings"]["trigger"] == "Line1"
    assert recorded.document["gate_settings"]["serial"]["port"] == str(tmp_path / "gate")
    assert recorded.document["gate_settings"]["speed_at_gate_mm_s"] == 0
    stones, widths_ns = [], []
    for header in playback_order(recorded):
        bundle = read_bundle(header.path, recorded.camera_ids)
        assert set(bundle.frames) == set(source.camera_ids)
        (name,) = {given[camera, frame.image.tobytes()] for camera, frame in bundle.frames.items()}
        assert name.endswith("background") == (header.kind is BundleKind.BACKGROUND)
        if header.kind is not BundleKind.BACKGROUND:
            stones.append(name)
            widths_ns.append(header.trigger.pulse_width_ns)
    fallen = [header for header in source.headers if header.kind is not BundleKind.BACKGROUND]
    assert stones == [header.name for header in fallen]
    assert widths_ns == pytest.approx([header.trigger.pulse_width_ns for header in fallen], abs=100_000)
