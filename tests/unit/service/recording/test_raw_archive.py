import asyncio
import multiprocessing
import os
from pathlib import Path

import pytest
import tifffile
from support.recordings import CAMERAS, assert_same_bundle, make_bundle

from drivers.files.bundle_file import Compression, overwrite_bundle, read_bundle
from service.base.status import trouble_check
from service.recording import raw_archive
from service.recording.raw_archive import RawArchive, keep_frames


class Folder:
    """Where frames belong, in the place of the store."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.dropped: list[int] = []

    async def raw_path(self, seq: int) -> Path:
        return self.path / f"{seq}" / "bundle.tiff"

    async def drop_old_raw(self, seq: int) -> None:
        self.dropped.append(seq)


async def test_frames_are_kept_beside_their_results_and_the_files_given_back(tmp_path: Path):
    folder = Folder(tmp_path)
    done: list[Path] = []
    files = [tmp_path / f"spool-{seq}.tiff" for seq in (1, 2, 3)]

    async def on_done(path: Path) -> None:
        done.append(path)

    archive = RawArchive(folder, CAMERAS, on_done, max_waiting=3)
    bundles = [make_bundle(1, missing={CAMERAS[0]: "lost"}), make_bundle(2), make_bundle(3)]
    await asyncio.to_thread(
        overwrite_bundle, files[0], make_bundle(0), CAMERAS
    )  # a larger one was in it before
    for path, bundle in zip(files, bundles, strict=True):
        await asyncio.to_thread(overwrite_bundle, path, bundle, CAMERAS)
    files[1].write_bytes(b"torn")
    assert [archive.take(path, seq) for seq, path in enumerate(files, start=1)] == [True, True, True]
    archive.finish()
    await archive.run()
    assert done == files
    assert folder.dropped == [1, 3]
    for seq in (1, 3):
        kept = await asyncio.to_thread(read_bundle, await folder.raw_path(seq), CAMERAS)
        assert_same_bundle(kept, bundles[seq - 1])
    assert archive.left_out == 1


@pytest.mark.parametrize(("rush", "expected"), [(4, ["NONE", "ZSTD", "ZSTD"]), (2, ["NONE", "NONE", "NONE"])])
async def test_they_are_compressed_while_no_others_wait_unless_they_come_in_a_rush(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rush: int, expected: list[str]
):
    monkeypatch.setattr(raw_archive, "RUSH", rush)
    monkeypatch.setattr(raw_archive, "RUSH_S", 60.0)
    folder = Folder(tmp_path)
    files = [tmp_path / f"spool-{seq}.tiff" for seq in (1, 2, 3)]

    async def on_done(path: Path) -> None:
        if path == files[1]:
            assert archive.take(files[2], 3)
        if path == files[2]:
            archive.finish()

    archive = RawArchive(folder, CAMERAS, on_done, max_waiting=3)
    for seq, path in enumerate(files, start=1):
        await asyncio.to_thread(overwrite_bundle, path, make_bundle(seq), CAMERAS)
    assert all(archive.take(path, seq) for seq, path in enumerate(files[:2], start=1))
    await archive.run()
    assert [compression(await folder.raw_path(seq)) for seq in (1, 2, 3)] == expected


@pytest.mark.parametrize(
    ("compression", "writer", "policy"),
    [("zstd", "write_bundle", os.SCHED_IDLE), ("none", "copy_past_cache", os.SCHED_OTHER)],
)
def test_only_to_compress_it_waits_for_an_idle_core(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: Compression, writer: str, policy: int
):
    path, policies = tmp_path / "spool.tiff", []
    overwrite_bundle(path, make_bundle(1), CAMERAS)
    write = getattr(raw_archive, writer)

    def noting(*args: object, **options: object) -> None:
        policies.append(os.sched_getscheduler(0))
        write(*args, **options)

    monkeypatch.setattr(raw_archive, writer, noting)
    keep_frames(path, CAMERAS, tmp_path / "1" / "bundle.tiff", compression)
    assert policies == [policy]
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
    assert_same_bundle(read_bundle(tmp_path / "1" / "bundle.tiff", CAMERAS), make_bundle(1))


async def test_a_disk_that_refuses_is_told_and_costs_no_process(tmp_path: Path):
    folder = Folder(tmp_path / "a file")
    folder.path.touch()
    files = [tmp_path / f"spool-{seq}.tiff" for seq in (1, 2)]
    pids: set[int] = set()

    async def on_done(path: Path) -> None:
        pids.update(child.pid or 0 for child in multiprocessing.active_children())

    archive = RawArchive(folder, CAMERAS, on_done, max_waiting=3)
    for seq, path in enumerate(files, start=1):
        await asyncio.to_thread(overwrite_bundle, path, make_bundle(seq), CAMERAS)
        assert archive.take(path, seq)
    archive.finish()
    await archive.run()
    assert archive.trouble == "frames of 2 stones were not kept since the start: Not a directory"
    assert len(pids) == 1


def compression(path: Path) -> str:
    with tifffile.TiffFile(path) as tiff:
        return tifffile.COMPRESSION(tiff.pages.first.compression).name


def test_what_comes_too_fast_is_left_out_and_told(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    async def on_done(path: Path) -> None:
        raise AssertionError(path)

    archive = RawArchive(Folder(tmp_path), CAMERAS, on_done, max_waiting=4)
    assert all(archive.take(tmp_path / f"{seq}", seq) for seq in range(4))
    assert archive.trouble is None
    assert not archive.take(tmp_path / "9", 9)
    assert not archive.take(tmp_path / "10", 10)
    assert archive.trouble is not None
    assert archive.trouble.startswith("frames of 2 stones were not kept")
    assert archive.checks() == {"archive": trouble_check(archive.trouble, 2, "left out")}
    assert caplog.text.count("frames not kept: stones come faster than frames are written seq=9") == 1
