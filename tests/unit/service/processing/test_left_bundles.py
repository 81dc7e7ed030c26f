"""What a killed daemon leaves in the spool: the next one takes over what is worth it, and nothing twice."""

from pathlib import Path

import numpy as np
import pytest

from drivers.files.bundle_file import overwrite_bundle
from drivers.files.recording import read_bundle
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, Trigger
from service.base.messages import Code, message
from service.base.status import trouble_check
from service.processing.left_bundles import (
    MAX_BUNDLES,
    MAX_DEATHS,
    Quarantine,
    bundles_in,
    job_folder,
    take_over,
)
from service.processing.spool import LeftBundle

CAMERAS = (CameraId("c01"), CameraId("c02"))


class Spool:
    """The folder of a store's spool, in the hands of a test."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "spool"
        self.quarantine = Quarantine(folder / "quarantine")
        self.left: list[LeftBundle] = []

    def write(self, session: int, file: int, name: str, kind: BundleKind = BundleKind.PARTICLE) -> Path:
        trigger = Trigger(
            sequence=file, received_ns=file, device_ns=0, utc="2026-11-21T04:00:00Z", kind=kind, name=name
        )
        image = np.full((64, 48), file, np.uint8)
        frames = {
            camera: Frame(camera=camera, image=image, frame_id=file, device_ns=0, received_ns=file)
            for camera in CAMERAS
        }
        path = self.folder / str(session) / f"{file:08d}.tiff"
        path.parent.mkdir(parents=True, exist_ok=True)
        overwrite_bundle(path, FrameBundle(trigger=trigger, frames=frames), CAMERAS)
        return path

    def take_over(self, session: int, *open_triggers: tuple[int, str]) -> list[tuple[int, str]]:
        self.left = take_over(self.folder, session, open_triggers, CAMERAS, self.quarantine)
        assert [path.name for path in self.folder.iterdir()] == [str(session)]
        return [(bundle.session, bundle.name) for bundle in self.left]

    def names(self, session: int) -> list[str]:
        return sorted(path.name for path in (self.folder / str(session)).iterdir())


@pytest.fixture
def spool(tmp_path: Path) -> Spool:
    return Spool(tmp_path)


def test_bundles_of_open_triggers_are_taken_over_in_their_order(spool: Spool) -> None:
    spool.write(4, 2, "a")
    spool.write(4, 1, "b")
    spool.write(4, 3, "measured")
    spool.write(4, 4, "empty rig", BundleKind.BACKGROUND)
    assert bundles_in(spool.folder) == {(4, name) for name in ("a", "b", "measured", "empty rig")}
    assert spool.take_over(5, (3, "b"), (4, "a"), (4, "never written"), (4, "b")) == [(4, "a"), (4, "b")]
    assert spool.names(5) == ["left-4-0-00000001.tiff", "left-4-0-00000002.tiff"]
    assert [bundle.trigger.sequence for bundle in spool.left] == [2, 1]
    assert [read_bundle(bundle.content, CAMERAS).name for bundle in spool.left] == ["a", "b"]


def test_what_is_left_of_several_sessions_keeps_its_session(spool: Spool) -> None:
    spool.write(4, 1, "a")
    assert spool.take_over(5, (4, "a")) == [(4, "a")]
    spool.write(5, 1, "a")
    assert bundles_in(spool.folder) == {(4, "a"), (5, "a")}
    assert spool.take_over(6, (4, "a"), (5, "a")) == [(4, "a"), (5, "a")]
    assert spool.names(6) == ["left-4-0-00000001.tiff", "left-5-0-00000001.tiff"]
    assert spool.take_over(7, (5, "a")) == [(5, "a")]
    assert spool.take_over(8) == []
    assert spool.names(8) == []


def test_a_bundle_that_was_being_written_is_not_measured(spool: Spool) -> None:
    whole = spool.write(4, 1, "a").stat().st_size
    for file, size in ((2, whole - 100), (3, 100), (4, 0)):
        with spool.write(4, file, f"torn {file}").open("r+b") as torn:
            torn.truncate(size)
    with spool.write(4, 5, "half").open("r+b") as half:  # over an earlier bundle
        half.seek(-100, 2)
        half.write(b"earlier")
    (spool.folder / "4/left-x-0.tiff").write_bytes(b"no name of ours")
    open_triggers = [(4, name) for name in ("half", "torn 2", "torn 3", "torn 4", "a")]
    assert spool.take_over(5, *open_triggers) == [(4, "a")]


def test_the_newest_background_of_each_session_goes_with_its_bundles(spool: Spool) -> None:
    spool.write(4, 1, "a")
    for name in ("background-00000001", "background-00000002", "learning-00000003"):
        (spool.folder / "4" / name).mkdir()
        (spool.folder / "4" / name / "c01.npy").write_text(name)
    spool.take_over(5, (4, "a"))
    spool.write(5, 1, "a")
    spool.take_over(6, (4, "a"), (5, "a"))
    first, second = spool.left
    assert first.background is not None
    assert (first.background / "c01.npy").read_text() == "background-00000002"
    assert second.background is None  # it had learnt none: the one in use now
    spool.take_over(7)
    assert spool.names(7) == []


def test_a_bundle_that_ends_every_daemon_is_given_up(spool: Spool) -> None:
    spool.write(1, 1, "innocent")
    path = spool.write(1, 2, "poison")
    for session in range(2, 2 + MAX_DEATHS):
        assert (1, "poison") in ((bundle.session, bundle.name) for bundle in spool.left) or session == 2
        (path.parent / job_folder(path)).mkdir()  # a worker had it when the daemon ended
        taken = spool.take_over(session, (1, "innocent"), (1, "poison"))
        path = spool.left[-1].content
    assert taken == [(1, "innocent")]
    assert spool.quarantine.checks() == {
        "quarantine": trouble_check(message(Code.QUARANTINE, bundles="1-poison.tiff"), 1, "bundles")
    }
    assert read_bundle(spool.quarantine.folder / "1-poison.tiff", CAMERAS).name == "poison"


def test_the_quarantine_is_bounded(tmp_path: Path) -> None:
    quarantine = Quarantine(tmp_path / "quarantine")
    (tmp_path / "bundle").touch()
    for number in range(MAX_BUNDLES + 3):
        quarantine.keep(tmp_path / "bundle", 1, f"{number:08d}")
    assert len(quarantine.bundles()) == MAX_BUNDLES


def test_a_quarantine_that_cannot_be_written_is_no_failure(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "quarantine").touch()
    (tmp_path / "bundle").touch()
    quarantine = Quarantine(tmp_path / "quarantine")
    quarantine.keep(tmp_path / "bundle", 1, "a")
    assert "bundle not kept" in caplog.text
    assert quarantine.bundles() == []
