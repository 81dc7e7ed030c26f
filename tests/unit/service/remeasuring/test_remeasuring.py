"""Which stones are measured again, with what, and what hinders it; without pixels."""

import asyncio
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.calibration_desk import open_desk
from support.outcomes import add, measured, result
from support.remeasuring import AgainPool, add_old, remeasuring_of
from support.rest import particle_files

from drivers.errors import RecordingError
from service.calibration.calibrations import Calibrations
from service.processing.worker_slot import JobLostError
from service.remeasuring.jobs import Hindrance, RemeasureError
from service.remeasuring.remeasuring import Remeasuring
from service.results.fields import RUSH, LossReason
from service.results.version import ALGORITHM_VERSION
from service.store import Store
from service.store.reads import particle


@pytest.fixture
def desk(tmp_path: Path) -> Calibrations:
    return open_desk(tmp_path / "desk")


@pytest.fixture
def pool() -> AgainPool:
    return AgainPool(fields={"volume_mm3": 7.0})


@pytest.fixture
def again(store: Store, desk: Calibrations, pool: AgainPool, tmp_path: Path) -> Iterator[Remeasuring]:
    remeasuring = remeasuring_of(store, desk, pool, tmp_path)
    yield remeasuring
    remeasuring.close()


async def test_a_stone_is_measured_once_more_and_not_twice(
    store: Store, session: int, desk: Calibrations, pool: AgainPool, again: Remeasuring, tmp_path: Path
) -> None:
    name = await add_old(store, session, 1, tmp_path, desk.rig_file.calibration_id)
    assert await asyncio.gather(again.measure(name, "anna"), again.measure(name, "bob")) == [True, False]
    (job,) = pool.jobs
    assert job.bundle_path == await store.raw_path(1)
    assert job.rig_file == desk.rig_file
    assert not job.out_dir.exists()
    newest = await store.read(particle, name)
    assert newest is not None
    assert (newest["revision"], newest["volume_mm3"]) == (2, 7.0)
    assert newest["algorithm_version"] == ALGORITHM_VERSION
    assert (await store.folder(2) / "mesh.ply").is_file()


async def test_a_stone_whose_refinement_was_left_out_in_a_rush_is_refined_afterwards(
    store: Store, session: int, desk: Calibrations, again: Remeasuring, tmp_path: Path
) -> None:
    record = measured(
        calibration_id=desk.rig_file.calibration_id,
        algorithm_version=ALGORITHM_VERSION,
        refinement_fallback=RUSH,
    )
    await add(store, session, 1, record, particle_files(tmp_path / "out"))
    first = await store.read(particle, 1)
    assert first is not None
    assert [await again.measure(first["id"], "anna") for _ in range(2)] == [True, False]


async def assert_hindered(again: Remeasuring, store: Store, name: str, why: Hindrance) -> None:
    before = store.last_seq
    with pytest.raises(RemeasureError) as refused:
        await again.measure(name, "anna")
    assert refused.value.kind is why
    assert store.last_seq == before
    newest = await store.read(particle, name)
    assert newest is None or newest["revision"] == 1


async def test_what_has_no_frames_stays(
    store: Store, session: int, desk: Calibrations, again: Remeasuring, tmp_path: Path
) -> None:
    name = await add_old(store, session, 1, tmp_path, desk.rig_file.calibration_id)
    await asyncio.to_thread((await store.raw_path(1)).unlink)
    await assert_hindered(again, store, name, Hindrance.NO_FRAMES)
    await assert_hindered(again, store, "aaaaaaaa-00000007", Hindrance.NO_FRAMES)


async def test_a_calibration_that_is_gone_is_replaced_by_no_other(
    store: Store, session: int, desk: Calibrations, again: Remeasuring, tmp_path: Path
) -> None:
    unknown = await add_old(store, session, 1, tmp_path, "unknown")
    await assert_hindered(again, store, unknown, Hindrance.NO_CALIBRATION)
    known = await add_old(store, session, 2, tmp_path, desk.rig_file.calibration_id)
    await asyncio.to_thread(desk.rig_file.path.unlink)
    await assert_hindered(again, store, known, Hindrance.NO_CALIBRATION)


async def test_what_was_compared_with_the_empty_rig_needs_a_background(
    store: Store, session: int, desk: Calibrations, pool: AgainPool, again: Remeasuring, tmp_path: Path
) -> None:
    calibration_id = desk.rig_file.calibration_id
    seen = await add_old(store, session, 1, tmp_path, calibration_id, segmenters={"c01": "background"})
    await assert_hindered(again, store, seen, Hindrance.NO_BACKGROUND)
    other = await add_old(store, session, 2, tmp_path, calibration_id, segmenters={"c01": "network"})
    assert await again.measure(other, "anna")
    assert pool.jobs[-1].background_path is None


async def test_a_background_is_held_while_its_version_is_removed(
    store: Store, session: int, desk: Calibrations, pool: AgainPool, tmp_path: Path
) -> None:
    versions = [tmp_path / f"background-{number}" for number in (1, 2)]
    for version in versions:
        await asyncio.to_thread(version.mkdir)
        await asyncio.to_thread((version / "c01.npy").write_text, version.name)
    in_use = versions[0]
    again = remeasuring_of(store, desk, pool, tmp_path, lambda: in_use)
    for number, version in ((1, 0), (2, 0), (3, 1)):
        name = await add_old(store, session, number, tmp_path, desk.rig_file.calibration_id)
        in_use = versions[version]
        await again.measure(name, "anna")
    paths = [job.background_path for job in pool.jobs]
    assert paths[0] is not None and paths[2] is not None
    assert paths[0] == paths[1] != paths[2]
    await asyncio.to_thread(shutil.rmtree, versions[1])
    assert (paths[2] / "c01.npy").read_text() == "background-2"
    assert not paths[0].exists()  # only one is held
    again.close()


@pytest.mark.parametrize(
    "error",
    [JobLostError(LossReason.WORKER_CRASH, "it died"), RecordingError(Path("bundle.tiff"), "is damaged")],
    ids=lambda error: type(error).__name__,
)
async def test_a_failure_leaves_the_result_and_the_next_stone_is_measured(
    store: Store,
    session: int,
    desk: Calibrations,
    pool: AgainPool,
    again: Remeasuring,
    tmp_path: Path,
    error: Exception,
) -> None:
    names = [await add_old(store, session, n, tmp_path, desk.rig_file.calibration_id) for n in (1, 2)]
    pool.error = error
    await assert_hindered(again, store, names[0], Hindrance.FAILED)
    pool.error = None
    assert await again.measure(names[1], "anna")


async def test_closing_ends_what_is_measured(
    store: Store,
    session: int,
    desk: Calibrations,
    pool: AgainPool,
    again: Remeasuring,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    name = await add_old(store, session, 1, tmp_path, desk.rig_file.calibration_id)
    begun = asyncio.Event()

    async def hang(call: object) -> None:
        begun.set()
        await pool.closing.wait()
        raise asyncio.CancelledError

    monkeypatch.setattr(pool, "run", hang)
    asking = asyncio.create_task(assert_hindered(again, store, name, Hindrance.FAILED))
    await begun.wait()
    again.close()
    await asking
    monkeypatch.undo()
    await assert_hindered(again, store, name, Hindrance.FAILED)  # and nothing begins any more
    assert pool.jobs == []


async def test_a_request_that_is_given_up_leaves_nothing_to_the_next(
    store: Store,
    session: int,
    desk: Calibrations,
    pool: AgainPool,
    again: Remeasuring,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    name = await add_old(store, session, 1, tmp_path, desk.rig_file.calibration_id)
    begun = asyncio.Event()

    async def hang(call: object) -> None:
        begun.set()
        await asyncio.Event().wait()

    monkeypatch.setattr(pool, "run", hang)
    asking = asyncio.create_task(again.measure(name, "anna"))
    await begun.wait()
    asking.cancel()
    await asyncio.wait([asking])
    assert pool.n_rests == 1
    monkeypatch.undo()
    assert await again.measure(name, "anna")


async def test_frames_that_were_damaged_since_make_no_result_worse(
    store: Store, session: int, desk: Calibrations, pool: AgainPool, again: Remeasuring, tmp_path: Path
) -> None:
    calibration_id = desk.rig_file.calibration_id
    name = await add_old(store, session, 1, tmp_path, calibration_id)
    pool.fields = {"dropped_views": {"c02": "damaged", "c03": "lost"}}
    await assert_hindered(again, store, name, Hindrance.FAILED)
    pool.fields = {"dropped_views": {"c03": "damaged"}}  # as it was when the stone fell
    assert await again.measure(name, "anna")


async def test_a_lost_stone_has_nothing_to_measure(store: Store, session: int, again: Remeasuring) -> None:
    await add(store, session, 1, result(outcome="lost", reason="crash"))
    record = await store.read(particle, 1)
    assert record is not None
    await assert_hindered(again, store, record["id"], Hindrance.NO_FRAMES)
