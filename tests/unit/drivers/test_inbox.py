"""The inbox takes events from any thread, in order, and refuses instead of growing or blocking."""

import asyncio
import threading

import numpy as np
import pytest

from drivers.inbox import RESERVE, EventInbox
from drivers.interfaces import PlaybackEnded
from pipeline.frames import CameraId, Frame, Trigger


def frame(number: int, camera: str = "c01") -> Frame:
    image = np.zeros((2, 2), np.uint8)
    return Frame(camera=CameraId(camera), image=image, frame_id=number, device_ns=0, received_ns=number)


def trigger(number: int) -> Trigger:
    return Trigger(sequence=number, received_ns=number, device_ns=0, utc="2026-01-01T00:00:00Z")


async def test_events_of_many_threads_arrive_each_in_its_order() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=10_000)
    n_threads, n_events = 8, 500

    def produce(thread: int) -> None:
        for number in range(n_events):
            assert inbox.deliver(frame(number, f"c{thread}"))

    threads = [threading.Thread(target=produce, args=(thread,)) for thread in range(n_threads)]
    for thread in threads:
        thread.start()
    seen: dict[str, list[int]] = {f"c{thread}": [] for thread in range(n_threads)}
    for _ in range(n_threads * n_events):
        event = await inbox.get(timeout_s=10)
        assert isinstance(event, Frame)
        seen[event.camera].append(event.frame_id)
    for thread in threads:
        thread.join()
    assert all(numbers == list(range(n_events)) for numbers in seen.values())
    assert inbox.refused == {}


async def test_full_means_refused_and_counted_but_triggers_have_a_reserve() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=3)
    assert [inbox.deliver(frame(number)) for number in range(5)] == [True, True, True, False, False]
    assert inbox.deliver(trigger(1))
    assert inbox.refused == {"Frame": 2}
    for number in range(RESERVE - 1):
        assert inbox.deliver(trigger(number))
    assert not inbox.deliver(trigger(0))
    assert inbox.refused == {"Frame": 2, "Trigger": 1}
    assert isinstance(await inbox.get(), Frame)
    assert not inbox.deliver(frame(9)), "frames wait for their own room"


async def test_waiting_ends_with_an_event_or_in_time() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=1)
    assert await inbox.get(timeout_s=0.01) is None
    waiting = asyncio.create_task(inbox.get(timeout_s=10))
    await asyncio.sleep(0)
    producer = threading.Thread(target=inbox.deliver, args=(PlaybackEnded(received_ns=1),))
    producer.start()
    assert await waiting == PlaybackEnded(received_ns=1)
    producer.join()


async def test_waiting_can_be_cancelled() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=1)
    waiting = asyncio.create_task(inbox.get())
    await asyncio.sleep(0)
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting


async def test_capacity_is_checked() -> None:
    with pytest.raises(ValueError, match="capacity"):
        EventInbox(asyncio.get_running_loop(), capacity=0)
