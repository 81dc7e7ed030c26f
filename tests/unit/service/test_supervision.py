import asyncio
import logging

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.supervision import FailureLog, Heartbeats, RestartPolicy, supervise

POLICY = RestartPolicy(delays_s=(1, 2, 5), budget=4, window_s=100)
AT_ONCE = RestartPolicy(delays_s=(0,), budget=3, window_s=100)


def test_back_off_grows_with_failures_and_ends_with_the_budget():
    failures = FailureLog(POLICY)
    assert [failures.next_delay_s(now_s) for now_s in (0, 10, 20, 30, 40)] == [1, 2, 5, 5, None]


def test_failures_older_than_the_window_are_forgiven():
    failures = FailureLog(POLICY)
    assert [failures.next_delay_s(now_s) for now_s in (0, 10, 20, 30, 111)] == [1, 2, 5, 5, 5]
    assert failures.next_delay_s(1000) == 1


@given(st.lists(st.floats(0, 50), max_size=30))
def test_never_more_restarts_than_the_budget_within_a_window(steps_s: list[float]):
    failures = FailureLog(POLICY)
    now_s, restarts = 0.0, []
    for step_s in steps_s:
        now_s += step_s
        if failures.next_delay_s(now_s) is not None:
            restarts.append(now_s)
            assert sum(time_s > now_s - POLICY.window_s for time_s in restarts) <= POLICY.budget


async def no_pause(_error: Exception, _delay_s: float) -> None: ...


async def pause(_error: Exception, delay_s: float) -> None:
    await asyncio.sleep(delay_s)


class Flaky:
    def __init__(self, failures: int, error: type[Exception] = OSError) -> None:
        self.failures = failures
        self.error = error
        self.runs = 0
        self.has_run = asyncio.Event()

    async def __call__(self) -> None:
        self.runs += 1
        self.has_run.set()
        if self.runs <= self.failures:
            raise self.error("camera c03 is gone")


async def test_an_expected_failure_is_restarted_and_logged_once(caplog: pytest.LogCaptureFixture):
    session = Flaky(3)
    await supervise("acquisition", session, OSError, AT_ONCE, no_pause)
    assert session.runs == 4
    errors = [record for record in caplog.records if record.levelno >= logging.ERROR]
    assert [record.message for record in errors] == ["acquisition failed: camera c03 is gone restart_in_s=0"]


async def test_a_used_up_budget_lets_the_failure_through():
    session = Flaky(9)
    with pytest.raises(OSError, match="c03"):
        await supervise("acquisition", session, OSError, AT_ONCE, no_pause)
    assert session.runs == 4


async def test_a_bug_is_not_restarted():
    session = Flaky(9, error=KeyError)
    with pytest.raises(KeyError):
        await supervise("acquisition", session, OSError, AT_ONCE, no_pause)
    assert session.runs == 1


async def test_cancellation_passes_through_while_waiting_to_restart():
    session = Flaky(9)
    slow = RestartPolicy(delays_s=(60,), budget=3, window_s=100)
    task = asyncio.create_task(supervise("acquisition", session, OSError, slow, pause))
    await session.has_run.wait()
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task


def test_late_parts_are_named():
    heartbeats = Heartbeats({"acquisition": 2, "processing": 10})
    assert heartbeats.late(0) == []
    heartbeats.beat("acquisition", 0)
    heartbeats.beat("processing", 0)
    assert heartbeats.late(2) == []
    assert heartbeats.late(5) == ["acquisition"]
    assert heartbeats.late(11) == ["acquisition", "processing"]
    heartbeats.beat("acquisition", 11)
    assert heartbeats.late(11) == ["processing"]
