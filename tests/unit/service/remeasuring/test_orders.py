"""Stones that a cluster measures: what is ordered, what is taken, and what is not."""

import asyncio
import json
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from support.calibration_desk import open_desk
from support.remeasuring import AgainPool, add_old, remeasuring_of

from service.calibration.calibrations import Calibrations
from service.processing.measure_job import measure
from service.remeasuring import orders as module
from service.remeasuring.jobs import Hindrance, RemeasureError
from service.remeasuring.orders import Orders, read_context, read_order, write_record
from service.remeasuring.remeasuring import Remeasuring
from service.store import Store
from service.store.reads import particle


@pytest.fixture
def desk(tmp_path: Path) -> Calibrations:
    return open_desk(tmp_path / "desk")


@pytest.fixture
def again(store: Store, desk: Calibrations, tmp_path: Path) -> Iterator[Remeasuring]:
    remeasuring = remeasuring_of(store, desk, AgainPool(), tmp_path)
    yield remeasuring
    remeasuring.close()


@pytest.fixture
async def name(store: Store, session: int, desk: Calibrations, tmp_path: Path) -> str:
    return await add_old(store, session, 1, tmp_path, desk.rig_file.calibration_id)


async def ordered(orders: Orders, name: str) -> Path:
    folder = await orders.order(name)
    assert folder is not None
    return folder


async def measured_there(folder: Path, **fields: Any) -> None:
    """Do what the command does: measure what was ordered, and lay it into the order."""
    job = await asyncio.to_thread(read_order, folder)
    done = await AgainPool().run(partial(measure, job))
    await asyncio.to_thread(write_record, job, done.record.model_copy(update=fields))


async def test_what_was_measured_elsewhere_becomes_one_revision(
    store: Store, desk: Calibrations, again: Remeasuring, name: str
) -> None:
    first, second = [await ordered(again.orders, name) for _ in range(2)]  # of two commands
    job = await asyncio.to_thread(read_order, first)
    assert job.bundle_path == await store.raw_path(1)
    assert job.rig_file == desk.rig_file
    assert read_context(job).is_simulated
    before = await store.read(particle, name)
    assert before is not None
    for folder in (first, second):
        await measured_there(folder, volume_mm3=7.0, bundle=before["bundle"])
    delivered = await asyncio.gather(
        *(again.orders.deliver(name, folder.name, "anna") for folder in (first, second))
    )
    assert sorted(delivered) == [False, True]
    newest = await store.read(particle, name)
    assert newest is not None
    assert (newest["revision"], newest["volume_mm3"]) == (2, 7.0)
    assert (await store.folder(2) / "mesh.ply").is_file()
    assert not first.exists() and not second.exists()
    assert await again.orders.order(name) is None


async def assert_refused(again: Remeasuring, store: Store, name: str, order: str, why: Hindrance) -> str:
    with pytest.raises(RemeasureError) as refused:
        await again.orders.deliver(name, order, "anna")
    assert refused.value.kind is why
    newest = await store.read(particle, name)
    assert newest is not None and newest["revision"] == 1
    return str(refused.value)


@pytest.mark.parametrize(
    "wrong",
    [
        {"algorithm_version": "0"},
        {"calibration_id": "another"},
        {"bundle": "another"},
        {"dropped_views": {"c02": "damaged"}},
    ],
    ids=lambda wrong: next(iter(wrong)),
)
async def test_what_is_not_of_this_stone_or_not_sound_is_refused(
    store: Store, again: Remeasuring, name: str, wrong: dict[str, Any]
) -> None:
    before = await store.read(particle, name)
    assert before is not None
    folder = await ordered(again.orders, name)
    await measured_there(folder, **{"bundle": before["bundle"], **wrong})
    told = await assert_refused(again, store, name, folder.name, Hindrance.FAILED)
    assert name in told
    await assert_refused(again, store, name, folder.name, Hindrance.NO_ORDER)  # it was used


async def test_an_order_without_a_result_or_of_another_stone_is_refused(
    store: Store, session: int, desk: Calibrations, again: Remeasuring, name: str, tmp_path: Path
) -> None:
    other = await add_old(store, session, 2, tmp_path, desk.rig_file.calibration_id)
    folder = await ordered(again.orders, name)
    await assert_refused(again, store, other, folder.name, Hindrance.NO_ORDER)
    await assert_refused(again, store, name, "../other", Hindrance.NO_ORDER)
    await assert_refused(again, store, name, folder.name, Hindrance.FAILED)
    folder = await ordered(again.orders, name)
    await measured_there(folder)
    await asyncio.to_thread((folder / "out" / "record.json").write_text, json.dumps([1]))
    await assert_refused(again, store, name, folder.name, Hindrance.FAILED)


async def test_an_order_that_is_delivered_twice_at_once_is_taken_once(
    store: Store, again: Remeasuring, name: str
) -> None:
    before = await store.read(particle, name)
    assert before is not None
    folder = await ordered(again.orders, name)
    await measured_there(folder, bundle=before["bundle"])
    deliveries = [again.orders.deliver(name, folder.name, "anna") for _ in range(2)]
    taken, refused = await asyncio.gather(*deliveries, return_exceptions=True)
    assert taken is True
    assert isinstance(refused, RemeasureError) and refused.kind is Hindrance.NO_ORDER
    newest = await store.read(particle, name)
    assert newest is not None
    assert (newest["revision"], newest["mesh"]) == (2, "particles/2/mesh.ply")


async def test_orders_of_killed_commands_give_way(
    again: Remeasuring, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MAX_OPEN", 2)
    folders = [await ordered(again.orders, name) for _ in range(3)]
    assert [folder.exists() for folder in folders] == [False, True, True]
