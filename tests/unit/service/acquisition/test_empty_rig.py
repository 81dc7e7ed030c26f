import asyncio

import pytest
from support.eventually import PATIENCE_S

from drivers.errors import GateUnavailableError
from service.acquisition import empty_rig
from service.acquisition.empty_rig import EmptyRigParameters, expose_empty_rig


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(empty_rig, "POLL_S", 0.001)
    monkeypatch.setattr(empty_rig, "RETRY_S", 0.01)


async def test_it_fires_as_often_as_asked_and_only_while_nothing_falls():
    fired: list[float] = []
    asked: list[float] = []

    async def fire() -> None:
        fired.append(len(asked))

    def is_quiet(for_s: float) -> bool:
        asked.append(for_s)
        return len(asked) % 3 == 0

    await expose_empty_rig(EmptyRigParameters(at_start=3, every_s=0), fire, is_quiet)
    assert fired == [3, 6, 9]


async def test_a_gate_that_cannot_now_is_asked_again_and_logged_once(caplog: pytest.LogCaptureFixture):
    attempts = 0

    async def fire() -> None:
        nonlocal attempts
        attempts += 1
        if attempts <= 3 or attempts == 5:
            raise GateUnavailableError("light gate x", f"did not answer the {attempts}. time")

    await expose_empty_rig(EmptyRigParameters(at_start=2, every_s=0), fire, lambda for_s: True)
    assert attempts == 6
    assert [record.message for record in caplog.records] == [
        f"the empty rig cannot be exposed: light gate x: did not answer the {number}. time"
        for number in (1, 5)
    ]


async def test_later_it_waits_for_a_starved_rig():
    fired = asyncio.Event()
    wanted_s: list[float] = []

    async def fire() -> None:
        if wanted_s[-1] == empty_rig.QUIET_S:
            fired.set()

    def is_quiet(for_s: float) -> bool:
        wanted_s.append(for_s)
        return True

    parameters = EmptyRigParameters(at_start=1, every_s=1)
    task = asyncio.create_task(expose_empty_rig(parameters, fire, is_quiet))
    await asyncio.wait_for(fired.wait(), PATIENCE_S)
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)
