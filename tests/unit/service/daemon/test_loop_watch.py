"""The wall clock is set while the loop is watched; both clocks are the test's."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
from support.eventually import PATIENCE_S

from service.daemon import loop_watch
from service.daemon.loop_watch import STEP_REMEMBERED_S, LoopWatch

HOUR_S = 3600.0
NOVEMBER_2026_S = 1_795_000_000.0


class Clocks:
    """In the place of the module `time`: the wall clock is ahead of the monotonic one by what the test says."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.ahead_s = NOVEMBER_2026_S
        self.n_asked = 0

    def monotonic(self) -> float:
        self.n_asked += 1
        return self.now_s

    def time(self) -> float:
        return self.now_s + self.ahead_s

    async def looked_at(self) -> None:
        """Return when the watch has looked at the clocks as they are now."""
        n_asked = self.n_asked + 10
        async with asyncio.timeout(PATIENCE_S):
            while self.n_asked < n_asked:  # noqa: ASYNC110 - the watch knows of no one
                await asyncio.sleep(0.001)


@pytest.fixture
def clocks(monkeypatch: pytest.MonkeyPatch) -> Clocks:
    clocks = Clocks()
    monkeypatch.setattr(loop_watch, "time", clocks)
    monkeypatch.setattr(loop_watch, "PERIOD_S", 0.001)
    return clocks


@asynccontextmanager
async def watched(clocks: Clocks) -> AsyncIterator[LoopWatch]:
    watch = LoopWatch()
    running = asyncio.create_task(watch.run())
    await clocks.looked_at()
    yield watch
    running.cancel()
    await asyncio.wait([running])


@pytest.mark.parametrize("step_s", [HOUR_S, -HOUR_S])
async def test_an_hour_step_is_told_for_an_hour_and_delays_nothing(clocks: Clocks, step_s: float) -> None:
    async with watched(clocks) as watch:
        assert watch.clock_step_s() is None
        clocks.ahead_s += step_s
        await clocks.looked_at()
        assert watch.clock_step_s() == pytest.approx(step_s)
        assert watch.worst_ms() <= 0
        clocks.now_s += STEP_REMEMBERED_S + 1
        assert watch.clock_step_s() is None


async def test_setting_a_clock_that_was_not_set_is_no_step(clocks: Clocks) -> None:
    clocks.ahead_s = 42.0  # 1970
    async with watched(clocks) as watch:
        clocks.ahead_s = NOVEMBER_2026_S
        await clocks.looked_at()
        assert watch.clock_step_s() is None
        clocks.ahead_s += HOUR_S
        await clocks.looked_at()
        assert watch.clock_step_s() == pytest.approx(HOUR_S)
