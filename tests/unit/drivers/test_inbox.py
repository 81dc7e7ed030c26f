import asyncio
import threading
import time
from itertools import pairwise

import numpy as np
import pytest
from support.recordings import CAMERAS

from drivers.inbox import RESERVE, EventInbox
from drivers.interfaces import FrameLost, PlaybackEnded
from pipeline.frames import Frame, Trigger

PIXEL = np.zeros((1, 1), np.uint8)


def frame(number: int, camera: int = 0) -> Frame:
    return Frame(camera=CAMERAS[camera], image=PIXEL.copy(), frame_id=number, device_ns=0, received_ns=number)


def trigger(number: int) -> Trigger:
    return Trigger(sequence=number, received_ns=number, device_ns=0, utc="2026-01-01T00:00:00Z")


async def test_events_come_out_in_the_order_of_delivery() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=8)
    events = [trigger(0), frame(1), PlaybackEnded(received_ns=2)]
    assert all(inbox.deliver(event) for event in events)
    assert [await inbox.get() for _ in events] == events


async def test_get_gives_up_in_time() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=8)
    inbox.deliver(trigger(0))
    assert await inbox.get(timeout_s=0) is not None
    started_s = time.monotonic()
    assert await inbox.get(timeout_s=0.05) is None  # not woken by the event already taken
    assert time.monotonic() - started_s >= 0.045


async def test_get_wakes_up_for_another_thread() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=8)
    getting = asyncio.create_task(inbox.get(timeout_s=10))
    await asyncio.sleep(0)
    thread = threading.Thread(target=inbox.deliver, args=(trigger(7),))
    thread.start()
    assert await getting == trigger(7)
    thread.join()


async def test_waiting_can_be_cancelled() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=8)
    getting = asyncio.create_task(inbox.get(timeout_s=10))
    await asyncio.sleep(0)
    getting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await getting


async def test_a_full_inbox_refuses_and_counts_frames_before_triggers() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=3)
    assert [inbox.deliver(frame(number)) for number in range(5)] == [True] * 3 + [False] * 2
    assert not inbox.deliver(FrameLost(camera=CAMERAS[0], received_ns=0, reason="incomplete"))
    assert [inbox.deliver(trigger(number)) for number in range(RESERVE + 1)] == [True] * RESERVE + [False]
    assert inbox.refused == {"Frame": 2, "FrameLost": 1, "Trigger": 1}
    await inbox.get()
    assert not inbox.deliver(frame(9))  # the reserve is still in use
    for _ in range(RESERVE):
        await inbox.get()
    assert inbox.deliver(frame(9))


async def test_nothing_is_lost_between_many_threads_and_the_loop() -> None:
    inbox = EventInbox(asyncio.get_running_loop(), capacity=50)
    n_each = 500
    refused = [0] * len(CAMERAS)

    def produce(camera: int) -> None:
        for number in range(n_each):
            refused[camera] += not inbox.deliver(frame(number, camera))

    threads = [threading.Thread(target=produce, args=(camera,)) for camera in range(len(CAMERAS))]
    for thread in threads:
        thread.start()
    taken: dict[str, list[int]] = {camera: [] for camera in CAMERAS}
    while (event := await inbox.get(timeout_s=0.2)) is not None or any(
        thread.is_alive() for thread in threads
    ):
        assert event is None or isinstance(event, Frame)
        if event is not None:
            taken[event.camera].append(event.frame_id)
    for thread in threads:
        thread.join()
    assert sum(map(len, taken.values())) + sum(refused) == n_each * len(CAMERAS)
    assert inbox.refused.get("Frame", 0) == sum(refused)
    for ids in taken.values():
        assert all(earlier < later for earlier, later in pairwise(ids))


async def test_whoever_waits_is_woken() -> None:
    """The loop is woken for one of several events; it waits in between as often as not."""
    inbox = EventInbox(asyncio.get_running_loop(), capacity=5000)
    pauses_s = np.random.default_rng(1).exponential(2e-5, 2000)

    def produce(camera: int) -> None:
        for number, pause_s in enumerate(pauses_s.tolist()):
            inbox.deliver(frame(number, camera))
            time.sleep(pause_s)

    threads = [threading.Thread(target=produce, args=(camera,)) for camera in range(2)]
    for thread in threads:
        thread.start()
    for _ in range(2 * len(pauses_s)):
        assert await inbox.get(timeout_s=5) is not None
    for thread in threads:
        thread.join()


async def test_a_closed_loop_refuses() -> None:
    loop = asyncio.new_event_loop()
    inbox = EventInbox(loop, capacity=3)
    loop.close()
    assert not inbox.deliver(trigger(0))
    with pytest.raises(ValueError, match="capacity must be at least 1"):
        EventInbox(loop, capacity=0)
