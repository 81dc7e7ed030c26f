"""Retention on the disk: what rows say is removed, is; what no row names is never deleted."""

import asyncio
from collections.abc import AsyncIterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from support.eventually import eventually
from support.outcomes import add, measured
from support.recordings import SOURCE, make_bundle
from support.rest import particle_files
from support.stores import folder_of

from service.daemon.retaining import LowThread, Retaining
from service.recording.recordings import RecordingRequest, Recordings, RecordingsSettings
from service.store import Store, open_store
from service.store.reads import results_after
from service.store.retention import Disk, RetentionLimits, mark_files
from service.store.sweep import sweep

WIDE = Disk(total_bytes=10**12, free_bytes=10**11)


def later() -> datetime:
    return datetime.now(UTC) + timedelta(days=40)


@pytest.fixture
async def recordings(tmp_path: Path) -> AsyncIterator[Recordings]:
    recordings = Recordings(tmp_path / "recordings", SOURCE, RecordingsSettings(reserve_gb=0.0), {})
    yield recordings
    await recordings.close()


async def fill(store: Store, tmp_path: Path, n: int) -> list[Path]:
    """Store results with files; return their folders."""
    session = await store.begin_session({})
    for number in range(1, n + 1):
        await add(store, session, number, measured(), particle_files(tmp_path / "out"))
    names = [item["id"] for item in (await store.read(results_after, 0, n)).items]
    return [folder_of(store.dir, name) for name in names]


def retaining(store: Store, recordings: Recordings, limits: RetentionLimits, sure: bool = True) -> Retaining:
    return Retaining(
        store, recordings, limits, is_clock_sure=lambda: sure, disk_of=lambda folder: WIDE, now=later
    )


async def test_it_runs_until_nothing_is_due(store: Store, recordings: Recordings, tmp_path: Path) -> None:
    folders = await fill(store, tmp_path, 3)
    task = asyncio.create_task(retaining(store, recordings, RetentionLimits(files_days=30)).run())
    await asyncio.to_thread(eventually, lambda: not any(folder.exists() for folder in folders))
    task.cancel()
    await asyncio.wait([task])


async def test_a_kill_between_row_and_files_is_made_up_for(
    state_dir: Path, recordings: Recordings, tmp_path: Path
) -> None:
    limits = RetentionLimits(files_days=30)
    with await asyncio.to_thread(open_store, state_dir) as store:
        folders = await fill(store, tmp_path, 2)
        await store.write(mark_files, limits, WIDE, later())
    with await asyncio.to_thread(open_store, state_dir) as store, LowThread() as thread:
        assert all(folder.exists() for folder in folders)
        await retaining(store, recordings, RetentionLimits()).step(thread)
        assert not any(folder.exists() for folder in folders)


async def test_nothing_goes_for_its_age_while_the_clock_is_in_doubt(
    store: Store, recordings: Recordings, tmp_path: Path
) -> None:
    folders = await fill(store, tmp_path, 2)
    limits = RetentionLimits(files_days=30, results_days=30)
    with LowThread() as thread:
        assert not await retaining(store, recordings, limits, sure=False).step(thread)
    assert all(folder.exists() for folder in folders)


@pytest.mark.parametrize(("days", "kept"), [(0.0, ["r1"]), (30.0, [])])
async def test_recordings_go_only_if_the_settings_say_so(
    store: Store, recordings: Recordings, days: float, kept: list[str]
) -> None:
    await recordings.start(RecordingRequest(name="r1", count=100))
    recordings.offer(make_bundle(1))
    await recordings.stop("r1")
    daemon = retaining(store, recordings, RetentionLimits(recordings_days=days))
    with LowThread() as thread:
        await daemon.look(thread)
    assert [status.name for status in await recordings.all()] == kept
    assert (daemon.facts.recordings_bytes > 0) == bool(kept)


async def test_the_sweep_deletes_what_was_removed_and_moves_what_is_in_doubt_aside(
    store: Store, recordings: Recordings, tmp_path: Path
) -> None:
    first, second = await fill(store, tmp_path, 2)
    limits = RetentionLimits(max_files_gb=1e-9)
    with LowThread() as thread:
        await retaining(store, recordings, limits).step(thread)
    assert not first.exists()
    first.mkdir()  # by a client that had asked for a picture
    (first / "preview-480.png").touch()
    unknown = second.parent / f"00000000-{1:08d}"
    unknown.mkdir()
    twice = store.particles_dir / second.name
    twice.mkdir()
    coming = second.parent / f"{second.name[:8]}-{3:08d}"  # the next result, whose row is not there yet
    coming.mkdir()
    await asyncio.to_thread(sweep, store.dir, lambda: True)
    assert not first.exists()
    assert coming.exists()
    moved = {path.name for path in store.dir.glob("aside/*-strays/particles/*")}
    assert moved == {unknown.name, second.name}
    assert len(store.incidents) == 1
    await asyncio.to_thread(sweep, store.dir, lambda: True)
    assert len(store.incidents) == 1


async def test_a_store_with_all_folders_side_by_side_goes_on(
    state_dir: Path, recordings: Recordings, tmp_path: Path
) -> None:
    with await asyncio.to_thread(open_store, state_dir) as store:
        folders = await fill(store, tmp_path, 2)
        await store.write(
            lambda connection: connection.execute("UPDATE files SET folder = substr(folder, 12)")
        )
        for folder in folders:
            folder.rename(store.particles_dir / folder.name)
    with await asyncio.to_thread(open_store, state_dir) as store:
        await asyncio.to_thread(sweep, store.dir, lambda: True)
        assert store.incidents == []
        assert (await store.raw_path(2)).exists()
        with LowThread() as thread:
            await retaining(store, recordings, RetentionLimits(files_days=1)).step(thread)
        assert not any((store.particles_dir / folder.name).exists() for folder in folders)
