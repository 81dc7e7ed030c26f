"""`stonefall archive`: the newest stones with frames, as a recording that is measured like any other."""

from pathlib import Path

import numpy as np
import pytest
from support.configurations import REPLAY
from support.outcomes import measured
from support.recordings import CAMERAS, make_bundle, small_rig, write_recording
from typer.testing import CliRunner

from drivers.files.recording import open_recording, playback_order, read_bundle, write_bundle
from pipeline.frames import BundleKind
from pipeline.segmentation.background import CameraBackground
from pipeline.segmentation.noise import SensorNoise
from service.base.errors import UsageError
from service.commands.cli import build_app
from service.processing.backgrounds import write_background
from service.store import Store

N_STONES = 6


@pytest.fixture
async def config(store: Store, state_dir: Path, tmp_path: Path) -> Path:
    """Return the configuration of a store with six stones, of which the third is of another calibration."""
    write_recording(tmp_path / "recording", [make_bundle(1)])
    file = tmp_path / "stonefall.toml"
    file.write_text(REPLAY.replace('dir = "state"', f'dir = "{state_dir}"'))
    session = await store.begin_session({"is_replay": True})
    for number in range(1, N_STONES + 1):
        bundle = make_bundle(number, name=f"{number:08d}")
        await store.record_triggers(session, {bundle.name: bundle.trigger})
        used = "other" if number == 3 else small_rig().calibration_id
        mesh = tmp_path / "mesh.ply"
        mesh.write_bytes(b"ply")
        seq = await store.finish(session, bundle.name, measured(calibration_id=used), {"mesh.ply": mesh})
        write_bundle(await store.raw_path(seq), bundle, CAMERAS, compression="zstd")
    return file


def archive(config: Path, out: Path, *options: str) -> str:
    done = CliRunner().invoke(
        build_app(["archive"]), ["archive", str(out), "--config", str(config), *options]
    )
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.output


async def test_the_newest_stones_of_one_calibration_with_their_pixels(
    config: Path, store: Store, tmp_path: Path
) -> None:
    (await store.raw_path(5)).unlink()
    assert "2 stones" in archive(
        config, tmp_path / "three", "--newest", "3"
    )  # 6, 4; 3 is of another calibration
    assert "4 stones" in archive(config, tmp_path / "all")
    recording = open_recording(tmp_path / "all")
    names = [header.name for header in playback_order(recording)]
    assert [name.partition("-")[2] for name in names] == ["00000001", "00000002", "00000004", "00000006"]
    assert recording.rig is not None and recording.rig.calibration_id == small_rig().calibration_id
    last = read_bundle(recording.headers[-1].path, CAMERAS)
    assert all(np.array_equal(last.frames[c].image, make_bundle(6).frames[c].image) for c in CAMERAS)
    assert last.trigger.pulse_width_ns == make_bundle(6).trigger.pulse_width_ns


async def test_the_empty_rig_is_drawn_with_mean_and_noise_of_the_background(
    config: Path, tmp_path: Path
) -> None:
    mean = np.linspace(40, 200, 48 * 64, dtype=np.float32).reshape(48, 64)
    model = {
        camera: CameraBackground(mean=mean, n_frames=9, noise=SensorNoise(4.0, 0.0)) for camera in CAMERAS
    }
    older, newer = (tmp_path / f"spool/store/1/background-{n}" for n in (1, 2))
    write_background(older, {CAMERAS[0]: CameraBackground(mean=mean + 30, n_frames=1)})
    write_background(newer, model)
    assert "background of 4 cameras" in archive(config, tmp_path / "out")
    empty = [h for h in open_recording(tmp_path / "out").headers if h.kind is BundleKind.BACKGROUND]
    assert len(empty) == 3
    seen = np.array([read_bundle(each.path, CAMERAS).frames[CAMERAS[1]].image for each in empty], float)
    assert abs((seen - mean).mean()) < 0.1
    assert (seen - mean).std() == pytest.approx(2.0, rel=0.1)
    assert not np.array_equal(seen[0], seen[1])


async def test_without_frames_it_says_which_setting_keeps_them(
    config: Path, store: Store, tmp_path: Path
) -> None:
    for seq in range(1, N_STONES + 1):
        (await store.raw_path(seq)).unlink()
    with pytest.raises(UsageError, match="the frames of no stone"):
        archive(config, tmp_path / "out")
    assert not (tmp_path / "out").exists()
