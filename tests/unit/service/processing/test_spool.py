import asyncio
import shutil
import threading
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.files.recording import read_bundle
from pipeline.frames import BundleKind, CameraId, Frame, FrameBundle, MissingReason, Trigger
from service.processing import spool as spool_module
from service.processing.spool import SPARE_FILES, BundleFiles, Loss, Spool, SpooledBundle
from service.results.fields import LossReason

CAMERAS = (CameraId("c01"), CameraId("c02"))


def bundle_of(sequence: int, cameras: Sequence[CameraId] = CAMERAS, kind: BundleKind = BundleKind.PARTICLE):
    trigger = Trigger(
        sequence=sequence, received_ns=sequence, device_ns=0, utc="2026-11-21T04:00:00Z", kind=kind
    )
    image = np.full((6, 8), sequence, dtype=np.uint8)
    frames = {
        camera: Frame(camera=camera, image=image, frame_id=sequence, device_ns=0, received_ns=sequence)
        for camera in cameras
    }
    missing = {camera: "no frame" for camera in CAMERAS if camera not in cameras}
    return FrameBundle(trigger=trigger, frames=frames, missing=missing)


@asynccontextmanager
async def writing(spool: Spool) -> AsyncIterator[None]:
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(spool.write())
        yield
        spool.finish()


async def take_all(spool: Spool) -> list[SpooledBundle]:
    taken = []
    while (bundle := await spool.take()) is not None:
        taken.append(bundle)
    return taken


async def test_bundles_come_out_as_files_in_order_and_unchanged(tmp_path: Path):
    spool = Spool(BundleFiles(tmp_path), max_bundles=5, camera_ids=CAMERAS)
    async with writing(spool):
        for sequence in (1, 2, 3):
            spool.offer(bundle_of(sequence))
    taken = await take_all(spool)
    assert [bundle.trigger.sequence for bundle in taken] == [1, 2, 3]
    for bundle in taken:
        read = await asyncio.to_thread(read_bundle, bundle.content, CAMERAS)
        assert read.trigger == bundle.trigger
        assert (read.frames[CAMERAS[0]].image == bundle.trigger.sequence).all()


async def test_when_full_whole_bundles_are_lost_in_their_place(tmp_path: Path):
    released = []
    files = BundleFiles(tmp_path, on_free=lambda: released.append(1))
    spool = Spool(files, max_bundles=2, camera_ids=CAMERAS)
    async with writing(spool):
        for sequence in (1, 2, 3):
            spool.offer(bundle_of(sequence))
        first = await spool.take()
        assert first is not None
        await spool.release(first)
        assert released == [1]
        spool.offer(bundle_of(4))
    rest = await take_all(spool)
    assert [bundle.trigger.sequence for bundle in rest] == [2, 3, 4]
    lost = rest[1].content
    assert isinstance(lost, Loss)
    assert lost.reason == "queue_full"
    assert spool.overflows == 1
    assert spool.trouble == "1 stones lost since the start (2 bundles were waiting)"
    for bundle in rest:
        await spool.release(bundle)
    assert spool.n_queued == 0


async def test_lost_exposures_of_the_empty_rig_are_no_lost_stones(tmp_path: Path):
    spool = Spool(BundleFiles(tmp_path), max_bundles=1, camera_ids=CAMERAS)
    for sequence in (1, 2):
        spool.offer(bundle_of(sequence, kind=BundleKind.BACKGROUND))
    assert (spool.n_queued, spool.overflows) == (1, 0)
    spool.offer(bundle_of(3))
    assert spool.overflows == 1


async def test_no_stone_waits_for_what_others_have_done_in_threads(tmp_path: Path):
    answered = threading.Event()
    others = [asyncio.create_task(asyncio.to_thread(answered.wait)) for _ in range(64)]
    spool = Spool(BundleFiles(tmp_path), max_bundles=1, camera_ids=CAMERAS)
    async with writing(spool):
        spool.offer(bundle_of(1))
        assert await asyncio.wait_for(spool.take(), 10) is not None
    answered.set()
    await asyncio.gather(*others)


async def test_files_of_bundles_that_are_through_are_written_over(tmp_path: Path):
    spool = Spool(BundleFiles(tmp_path), max_bundles=20, camera_ids=CAMERAS)
    async with writing(spool):
        for first in (1, 11):
            for sequence in range(first, first + 10):
                spool.offer(bundle_of(sequence))
            taken = [await spool.take() for _ in range(10)]
            for sequence, bundle in enumerate(taken, start=first):
                assert bundle is not None
                assert isinstance(bundle.content, Path)
                read = await asyncio.to_thread(read_bundle, bundle.content, CAMERAS, mapped=True)
                assert (read.frames[CAMERAS[0]].image == sequence).all()
                await spool.release(bundle)
            assert len(file_names(tmp_path)) == SPARE_FILES


async def test_while_the_store_is_held_losses_say_so_and_do_not_fill_the_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(spool_module, "MAX_LOSSES", 3)
    trouble = "database is locked: end the program"
    spool = Spool(BundleFiles(tmp_path), max_bundles=1, camera_ids=CAMERAS, store_trouble=lambda: trouble)
    async with writing(spool):
        for sequence in range(1, 10):
            spool.offer(bundle_of(sequence))
        assert spool.n_waiting == 9
        taken = []
        while spool.n_waiting:
            bundle = await spool.take()
            assert bundle is not None
            taken.append(bundle)
            await spool.release(bundle)
    assert [bundle.trigger.sequence for bundle in taken] == [1, 2, 3, 4, 9]
    assert [bundle.trigger.n_stones for bundle in taken] == [1, 1, 1, 1, 5]
    assert len({bundle.name for bundle in taken}) == 5
    assert isinstance(taken[0].content, Path)
    assert {bundle.content for bundle in taken[1:]} == {Loss(reason=LossReason.STORE_HELD, detail=trouble)}


async def test_losses_that_were_only_counted_come_out_at_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(spool_module, "MAX_LOSSES", 1)
    spool = Spool(BundleFiles(tmp_path), max_bundles=1, camera_ids=CAMERAS, store_trouble=lambda: "held")
    async with writing(spool):
        for sequence in range(1, 6):
            spool.offer(bundle_of(sequence))
        for sequence in range(6, 9):
            spool.offer(bundle_of(sequence, cameras=()))
    taken = await take_all(spool)
    found = [(bundle.content.reason, bundle.trigger.n_stones) for bundle in taken[1:]]
    assert found == [("store_held", 1), ("store_held", 3), ("no_frames", 3)]


async def test_a_loss_whose_trigger_has_its_row_is_never_only_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(spool_module, "MAX_LOSSES", 1)
    spool = Spool(BundleFiles(tmp_path), max_bundles=1, camera_ids=CAMERAS)  # its store is not held
    names = [bundle_of(sequence).name for sequence in range(1, 6)]
    async with writing(spool):
        for sequence in range(1, 6):
            spool.offer(bundle_of(sequence))
    assert [bundle.name for bundle in await take_all(spool)] == names


async def test_a_bundle_without_any_frame_is_lost_and_takes_no_room(tmp_path: Path):
    spool = Spool(BundleFiles(tmp_path), max_bundles=1, camera_ids=CAMERAS)
    async with writing(spool):
        spool.offer(bundle_of(1, cameras=()))
        spool.offer(bundle_of(2))
    first, second = await take_all(spool)
    assert first.content == Loss(reason="no_frames", detail="no frame")
    assert isinstance(second.content, Path)


async def test_a_bundle_of_a_stone_that_fell_while_no_daemon_ran_says_so(tmp_path: Path):
    spool = Spool(BundleFiles(tmp_path), max_bundles=1, camera_ids=CAMERAS)
    async with writing(spool):
        spool.offer(replace(bundle_of(1, cameras=()), missing=dict.fromkeys(CAMERAS, MissingReason.DOWN)))
    (bundle,) = await take_all(spool)
    assert isinstance(bundle.content, Loss)
    assert bundle.content.reason == "down"


async def test_equal_sequences_do_not_overwrite_each_other(tmp_path: Path):
    spool = Spool(BundleFiles(tmp_path), max_bundles=2, camera_ids=CAMERAS)
    async with writing(spool):
        spool.offer(bundle_of(1, kind=BundleKind.BACKGROUND))
        spool.offer(bundle_of(1))
    assert [bundle.is_background for bundle in await take_all(spool)] == [True, False]
    assert len(file_names(tmp_path)) == 2


async def test_a_deleted_folder_is_made_anew_and_costs_no_bundle_after_it(tmp_path: Path):
    folder = tmp_path / "7"
    spool = Spool(BundleFiles(folder), max_bundles=20, camera_ids=CAMERAS)
    assert spool.trouble is None
    async with writing(spool):
        for first in (1, 11):
            for sequence in range(first, first + 10):
                spool.offer(bundle_of(sequence))
            for _ in range(10):
                bundle = await spool.take()
                assert bundle is not None
                assert isinstance(bundle.content, Path)
                await asyncio.to_thread(read_bundle, bundle.content, CAMERAS)
                await spool.release(bundle)
            await asyncio.to_thread(shutil.rmtree, folder)
        assert spool.overflows == 0
        assert spool.trouble == "its folder was deleted, and made anew"
        for sequence in range(21, 42):
            spool.offer(bundle_of(sequence))
        assert spool.trouble == (
            "its folder was deleted, and made anew, 1 stones lost since the start (20 bundles were waiting)"
        )


async def test_a_spool_that_cannot_be_written_loses_bundles_not_the_daemon(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    (tmp_path / "gone").touch()
    spool = Spool(BundleFiles(tmp_path / "gone"), max_bundles=1, camera_ids=CAMERAS)
    async with writing(spool):
        spool.offer(bundle_of(1))
    (bundle,) = await take_all(spool)
    assert isinstance(bundle.content, Loss)
    assert bundle.content.reason == "queue_full"
    assert "Not a directory" in bundle.content.detail
    assert spool.trouble == "1 stones lost since the start (spool: Not a directory)"
    assert spool.n_queued == 0
    assert "cannot be written" in caplog.text


def file_names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())
