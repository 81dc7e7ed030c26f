"""One device kept at work, with a device that fails as told."""

import asyncio
import logging
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise

import pytest
from support.eventually import PATIENCE_S
from support.sinks import Collector

from drivers.errors import CameraUnavailableError, LossCause
from drivers.interfaces import CameraVitals, EventSink
from service.acquisition import device_keeper
from service.acquisition.device_keeper import DeviceKeeper


class Device:
    """Writes down what it is asked; `problem` is what it answers."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.at_s: list[float] = []
        self.threads: set[str] = set()
        self.problem: str | None = None
        self.cause = LossCause.OTHER
        self.remarks: tuple[str, ...] = ()

    def _asked(self, what: str, *, may_fail: bool = False) -> None:
        self.calls.append(what)
        self.at_s.append(time.monotonic())
        self.threads.add(threading.current_thread().name)
        if may_fail and self.problem:
            raise CameraUnavailableError("c01", self.problem, self.cause)

    def open(self) -> None:
        self._asked("open", may_fail=True)

    def arm(self, sink: EventSink) -> None:
        self._asked("arm")

    def examine(self) -> CameraVitals:
        self._asked("examine", may_fail=True)
        return CameraVitals(temperature_c=40.0, remarks=self.remarks)

    def test_pulse(self) -> None: ...

    def disarm(self) -> None:
        self._asked("disarm")

    def close(self) -> None:
        self._asked("close")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_keeper, "BACK_OFF_S", (0.05, 0.1, 0.2))
    monkeypatch.setattr(device_keeper, "EXAMINE_EVERY_S", 0.02)


@asynccontextmanager
async def kept(device: Device, lost: list[str] | None = None) -> AsyncIterator[DeviceKeeper]:
    told = [] if lost is None else lost
    keeper = DeviceKeeper(
        "c01", device, examine=device.examine, on_lost=lambda reason, cause: told.append(reason)
    )
    async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as tasks:
        keeper.start(Collector(), tasks)
        await keeper.tried.wait()
        yield keeper
        await keeper.close()


async def until(condition) -> None:
    while not condition():  # noqa: ASYNC110 - what is waited for happens on another thread
        await asyncio.sleep(0.005)


async def test_it_is_opened_armed_examined_disarmed_and_closed_on_one_thread():
    device = Device()
    async with kept(device) as keeper:
        assert keeper.state == "armed"
        await until(lambda: device.calls.count("examine") >= 2)
        assert keeper.vitals.temperature_c == 40.0
        await keeper.disarm()
        assert device.calls[-1] == "disarm"
    assert device.calls[:3] == ["open", "arm", "examine"]
    assert (device.calls[-1], keeper.state) == ("close", "closed")
    assert len(device.threads) == 1


async def test_what_opening_changed_is_logged_once(caplog: pytest.LogCaptureFixture):
    caplog.set_level(logging.INFO)
    device = Device()
    device.remarks = ("ReverseX was True: put back to False", "has no FrameStart: FrameBurstStart is used")
    async with kept(device):
        await until(lambda: device.calls.count("examine") >= 3)
    messages = [record.getMessage() for record in caplog.records]
    assert messages == [f"{remark} device=c01" for remark in device.remarks]


async def test_a_device_that_does_not_answer_is_asked_less_and_less_often_and_logged_once(
    caplog: pytest.LogCaptureFixture,
):
    caplog.set_level(logging.INFO)
    device = Device()
    device.problem = "does not answer"
    async with kept(device) as keeper:
        assert (keeper.state, keeper.last_error) == ("lost", "does not answer")
        await until(lambda: device.calls.count("open") >= 4)
        opened_s = [at_s for call, at_s in zip(device.calls, device.at_s, strict=True) if call == "open"]
        gaps_s = [b - a for a, b in pairwise(opened_s)]
        assert gaps_s[0] >= 0.1
        assert gaps_s[1] >= 0.2
        device.problem = None
        await until(lambda: keeper.state == "armed")
        assert keeper.recoveries == 1
    messages = [record.message for record in caplog.records]
    assert messages[0] == "device lost: does not answer device=c01"
    assert messages[1].startswith("device back device=c01 after_s=")
    assert len(messages) == 2


async def test_one_cause_in_other_words_is_not_logged_again(caplog: pytest.LogCaptureFixture):
    caplog.set_level(logging.INFO)
    device = Device()
    device.problem, device.cause = "does not answer", LossCause.SILENT
    async with kept(device) as keeper:
        device.problem = "does not answer: cannot read register 0xa00"
        n_opened = device.calls.count("open")
        await until(lambda: device.calls.count("open") > n_opened)
        device.cause = LossCause.IN_USE
        await until(lambda: keeper.loss is not None and keeper.loss.cause is LossCause.IN_USE)
    lost = [record.message for record in caplog.records if "lost" in record.message]
    assert lost == [
        "device lost: does not answer device=c01",
        "device still lost: does not answer: cannot read register 0xa00 device=c01",
    ]


async def test_a_failed_examination_is_told_and_the_device_opened_anew():
    device, lost = Device(), []
    async with kept(device, lost) as keeper:
        device.problem = "control was lost"
        await until(lambda: keeper.state == "lost")
        assert lost == ["control was lost"]
        device.problem = None
        await until(lambda: keeper.recoveries == 1)
    assert device.calls.count("open") >= 2


async def test_a_device_that_is_lost_again_and_again_is_one_alarm(caplog: pytest.LogCaptureFixture):
    device = Device()
    async with kept(device) as keeper:
        for n_opened in range(2, 6):
            keeper.mark_lost("no image")
            await until(lambda n_opened=n_opened: device.calls.count("open") == n_opened)
            await until(lambda: keeper.state == "armed")
        opened_s = [at_s for call, at_s in zip(device.calls, device.at_s, strict=True) if call == "open"]
        assert opened_s[-1] - opened_s[-2] >= 0.2
    lost = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert len(lost) == 1


async def test_a_loss_while_it_is_being_armed_counts():
    device = Device()
    keeper = DeviceKeeper("gate", device)

    def arm_and_lose(sink: EventSink) -> None:
        device.arm = lambda sink: device.calls.append("arm")
        asyncio.run_coroutine_threadsafe(lose(), loop).result()

    async def lose() -> None:
        keeper.mark_lost("unplugged")

    loop = asyncio.get_running_loop()
    device.arm = arm_and_lose
    async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as tasks:
        keeper.start(Collector(), tasks)
        await keeper.tried.wait()
        assert keeper.state == "lost"
        await until(lambda: keeper.state == "armed")
        await keeper.close()
    assert device.calls.count("open") == 2


async def test_a_loss_that_others_saw_has_the_device_opened_anew():
    device = Device()
    async with kept(device) as keeper:
        keeper.mark_lost("unplugged")
        await until(lambda: device.calls.count("open") == 2)
        assert device.calls.index("close") < len(device.calls) - 1 - device.calls[::-1].index("open")


async def test_a_device_that_hangs_can_be_abandoned():
    is_over = threading.Event()

    class Hanging(Device):
        def open(self) -> None:
            is_over.wait()

    keeper = DeviceKeeper("gate", Hanging())
    try:
        async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as tasks:
            keeper.start(Collector(), tasks)
            await asyncio.sleep(0.05)
            keeper.abandon()
            await keeper.tried.wait()
            await keeper.disarm()
            await keeper.close()
    finally:
        is_over.set()
