"""How parts start and end: one after the other, in reverse order; and not in order when the daemon fails."""

import asyncio
from contextlib import AsyncExitStack

import pytest

from service.daemon.part import Part, Running, started


class Told:
    """Parts that say when they run, are closed and are cancelled."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def part(self, name: str) -> Part:
        async def run() -> None:
            self.said.append(f"{name} runs")
            try:
                await asyncio.Event().wait()
            finally:
                self.said.append(f"{name} ended")

        async def close(running: Running) -> None:
            assert not running.done()
            await asyncio.sleep(0)
            self.said.append(f"{name} closed")

        return Part(run=run, close=close)

    async def live(self, error: Exception | None = None) -> None:
        async with asyncio.TaskGroup() as tasks, AsyncExitStack() as running:
            for part in (self.part("a"), Part(), self.part("b")):
                await running.enter_async_context(started(part, tasks))
            await asyncio.sleep(0)
            if error is not None:
                raise error


async def test_parts_end_in_reverse_order_and_what_still_runs_is_cancelled() -> None:
    told = Told()
    await told.live()
    assert told.said == ["a runs", "b runs", "b closed", "b ended", "a closed", "a ended"]


async def test_when_the_daemon_fails_its_parts_are_ended_and_not_closed() -> None:
    told = Told()
    with pytest.raises(ExceptionGroup):
        await told.live(OSError("no disk"))
    assert sorted(told.said[2:]) == ["a ended", "b ended"]
