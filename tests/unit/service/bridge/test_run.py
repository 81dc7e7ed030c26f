"""Outlets fail alone and are started again; a signal ends all."""

import asyncio
import logging
import os
import signal
from pathlib import Path

import pytest

from service.base.errors import ServiceError, UsageError
from service.base.systemd import ServiceManager
from service.bridge import run
from service.bridge.contacts.settings import ModbusSettings
from service.bridge.plant import Plant
from service.bridge.settings import BridgeSettings, DaemonSettings


async def test_an_outlet_that_fails_is_started_again_and_others_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(run, "PAUSES_S", (0.01, 0.02))
    starts: list[int] = []
    lasting = asyncio.Event()
    failures = [ServiceError("the broker is away"), OSError("no route"), ZeroDivisionError(), None]

    async def failing(_: Plant) -> None:
        starts.append(len(starts))
        if starts[-1] < len(failures):
            if (failure := failures[starts[-1]]) is not None:
                raise failure
            return
        lasting.set()
        await asyncio.Event().wait()

    async def steady(_: Plant) -> None:
        await asyncio.Event().wait()

    plant = Plant("http://127.0.0.1:9", None, tmp_path, None)
    tasks = [
        asyncio.create_task(run.supervise(name, each, plant))
        for name, each in (("a", failing), ("b", steady))
    ]
    await lasting.wait()
    assert not any(task.done() for task in tasks)
    for task in tasks:
        task.cancel()
    await asyncio.wait(tasks)
    assert "a: the broker is away" in caplog.text
    assert "a: no route" in caplog.text
    assert "ZeroDivisionError" in caplog.text
    assert "a has ended by itself" in caplog.text
    assert "b" not in {
        record.args[0] for record in caplog.records if isinstance(record.args, tuple) and record.args
    }


async def test_a_signal_ends_it_though_no_daemon_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, unused_tcp_port: int
) -> None:
    told: list[str] = []
    monkeypatch.setattr(ServiceManager, "notify", lambda _, *texts: told.extend(texts))
    settings = BridgeSettings.model_construct(
        dir=tmp_path / "state", daemon=DaemonSettings(), modbus=ModbusSettings(port=unused_tcp_port)
    )
    running = asyncio.create_task(run.run(settings, ServiceManager()))
    while "READY=1" not in told:  # noqa: ASYNC110 - it has no event for it
        await asyncio.sleep(0.01)
    os.kill(os.getpid(), signal.SIGTERM)
    async with asyncio.timeout(run.END_S):
        await running
    assert told[-1] == "STOPPING=1"
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().remove_signal_handler(number)


async def test_two_bridges_do_not_share_a_folder(tmp_path: Path) -> None:
    settings = BridgeSettings.model_construct(dir=tmp_path, daemon=DaemonSettings(), modbus=ModbusSettings())
    with run._locked(tmp_path), pytest.raises(UsageError, match="is that of a bridge that runs"):
        await run.run(settings, ServiceManager())
