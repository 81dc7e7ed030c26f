"""`stonefall record` on the replay backend."""

import json
import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.eventually import PATIENCE_S, eventually
from support.extents import first_quick
from support.recordings import CAMERAS, make_bundle, write_recording
from support.warm_stonefall import start_stonefall

from drivers.errors import CameraUnavailableError
from drivers.factory import Devices, ReplayBackend, build_devices
from drivers.files.recording import open_recording, playback_order, read_bundle
from drivers.replay.camera import ReplayCamera
from pipeline.frames import BundleKind, FrameBundle
from service.base.errors import ServiceError
from service.commands import record
from service.store.schema import lock_store

BUNDLES = [
    make_bundle(0, kind=BundleKind.BACKGROUND, name="empty"),
    *(make_bundle(sequence, name=f"s{sequence}") for sequence in range(1, 31)),
]


@pytest.fixture
def config(tmp_path: Path) -> Path:
    return configuration(tmp_path, 'pace = "fast"')


def configuration(folder: Path, rig: str) -> Path:
    write_recording(folder / "source", BUNDLES)
    path = folder / "stonefall.toml"
    path.write_text(
        f'[rig]\nrecording = "source"\n{rig}\n[spool]\ndir = "spool"\n[store]\ndir = "state"\n'
        "[recordings]\nreserve_gb = 0.0\n[views]\ngood = 4\nreduced = 3\nmin = 2\n"
        "[carving]\nmax_disagreeing_views = 0\n"
    )
    return path


def bundles_in(path: Path) -> Iterator[FrameBundle]:
    for header in playback_order(open_recording(path)):
        yield read_bundle(header.path, CAMERAS)


def test_what_is_played_is_recorded(tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str]):
    record.command(tmp_path / "out", config, as_json=True)
    summary = json.loads(capsys.readouterr().out)
    assert (summary["bundles"], summary["stones"], summary["ended_by"]) == (31, 30, "stop")
    for found, expected in zip(bundles_in(tmp_path / "out"), BUNDLES, strict=True):
        # all but the times, which are the belt's
        assert (found.name, found.kind, found.trigger.utc) == (
            expected.name,
            expected.kind,
            expected.trigger.utc,
        )
        assert found.frames.keys() == expected.frames.keys()
        for camera, frame in found.frames.items():
            assert np.array_equal(frame.image, expected.frames[camera].image)
    assert open_recording(tmp_path / "out").rig is not None


def test_count_and_a_name_that_is_taken(tmp_path: Path, config: Path, capsys: pytest.CaptureFixture[str]):
    record.command(tmp_path / "out", config, count=3)
    assert capsys.readouterr().out.startswith(f"{tmp_path / 'out'}: 3 stones, 1 exposures")
    assert [bundle.name for bundle in bundles_in(tmp_path / "out")] == ["empty", "s1", "s2", "s3"]
    with pytest.raises(Exception, match="exists already"):
        record.command(tmp_path / "out", config, count=3)


class Absent(ReplayCamera):
    def open(self) -> None:
        raise CameraUnavailableError(self.id, "is controlled by another application")


@pytest.mark.parametrize("daemon_runs", [False, True])
def test_cameras_that_are_not_to_be_had(
    tmp_path: Path, config: Path, monkeypatch: pytest.MonkeyPatch, daemon_runs: bool
):
    def build_without_cameras(backend: ReplayBackend) -> Devices:
        devices = build_devices(backend)
        assert devices.belt is not None
        return replace(devices, cameras={camera: Absent(camera, devices.belt) for camera in CAMERAS})

    monkeypatch.setattr(record, "build_devices", build_without_cameras)
    (tmp_path / "state").mkdir()
    lock = lock_store(tmp_path / "state") if daemon_runs else None
    with pytest.raises(ServiceError, match="the first one: is controlled by another application") as caught:
        record.command(tmp_path / "out", config)
    if lock is not None:
        os.close(lock)
    assert ("POST /api/v1/recordings" in str(caught.value)) == daemon_runs
    assert not list(tmp_path.glob("*out*"))


def test_asked_twice_it_waits_for_no_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    closing, release, closed = threading.Event(), threading.Event(), threading.Event()

    class Stuck(ReplayCamera):
        def close(self) -> None:
            closing.set()
            release.wait(PATIENCE_S)
            closed.set()
            super().close()

    def build_stuck(backend: ReplayBackend) -> Devices:
        devices = build_devices(backend)
        assert devices.belt is not None
        first = {CAMERAS[0]: Stuck(CAMERAS[0], devices.belt)}
        return replace(devices, cameras={**devices.cameras, **first})

    def insist() -> None:
        eventually(lambda: len(list(tmp_path.glob(".out.*.unfinished/bundles/*.tiff"))) >= 2)
        os.kill(os.getpid(), signal.SIGINT)
        assert closing.wait(PATIENCE_S)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(record, "build_devices", build_stuck)
    insisting = threading.Thread(target=insist)
    insisting.start()
    try:
        record.command(tmp_path / "out", configuration(tmp_path, "loop = true"))
        assert not closed.is_set()
        assert len(list(bundles_in(tmp_path / "out"))) >= 2
    finally:
        release.set()
        insisting.join()


@pytest.mark.parametrize("number", first_quick([signal.SIGTERM, signal.SIGINT]))
def test_a_signal_ends_it_cleanly(tmp_path: Path, number: signal.Signals):
    config = configuration(tmp_path, "loop = true")
    process = start_stonefall("record", tmp_path / "out", "--config", config, "--json")
    eventually(lambda: len(list(tmp_path.glob(".out.*.unfinished/bundles/*.tiff"))) >= 2)
    process.send_signal(number)
    output, told = process.communicate()
    assert process.returncode == 0, told
    assert json.loads(output)["bundles"] == len(list(bundles_in(tmp_path / "out"))) >= 2
