"""The daemon in this process, on a rig that hangs: it is noticed, and ends none the less."""

import asyncio
import os
import signal
import threading
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
from support.recordings import make_bundle, write_recording

from drivers.factory import Devices, ReplayBackend, build_devices
from drivers.interfaces import EventSink
from service.base.systemd import ServiceManager
from service.configuration.rig_settings import ReplayRigSettings
from service.configuration.settings import Settings, SpoolSettings, StoreSettings, WorkersSettings
from service.daemon import build, parts, run, session
from service.daemon.reloading import Configuration
from service.daemon.stopping import StopRequests
from service.store import open_store
from service.web.reader_process import ReaderProcess


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    recording = write_recording(tmp_path / "recording", [make_bundle(1)])
    return Settings(
        rig=ReplayRigSettings(recording=recording),
        spool=SpoolSettings(dir=tmp_path / "spool"),
        store=StoreSettings(dir=tmp_path / "state"),
        workers=WorkersSettings(slots=1),
        api=replace(Settings.model_fields["api"].default, port=0),
    )


class HangingGate:
    """Does not come back from `open` until the test is over; asks the daemon to stop meanwhile."""

    def __init__(self, n_signals: int) -> None:
        self.n_signals = n_signals
        self.is_over = threading.Event()

    warnings: tuple[str, ...] = ()

    def open(self) -> None:
        for _ in range(self.n_signals):
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.2)
        self.is_over.wait()

    def arm(self, sink: EventSink) -> None:
        raise AssertionError("armed although it was never opened")

    def disarm(self) -> None: ...

    def test_pulse(self) -> None: ...

    def close(self) -> None: ...


@dataclass(frozen=True)
class ListeningManager(ServiceManager):
    heard: list[str] = field(default_factory=list)

    def notify(self, *assignments: str) -> None:
        self.heard.extend(assignments)


@pytest.mark.parametrize(("n_signals", "disarm_s"), [(1, 0.5), (2, 60.0)])
@pytest.mark.full
async def test_a_rig_that_hangs_while_arming_does_not_keep_the_daemon(
    n_signals: int,
    disarm_s: float,
    settings: Settings,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
):
    gate = HangingGate(n_signals)

    def hanging(backend: ReplayBackend) -> Devices:
        return replace(build_devices(backend), gate=gate)

    monkeypatch.setattr(session, "build_devices", hanging)
    monkeypatch.setattr(parts, "DISARM_S", disarm_s)
    monkeypatch.setattr(build, "ACQUISITION_SILENCE_S", 0.1)
    manager = ListeningManager(watchdog_s=0.15)
    try:
        await asyncio.wait_for(run.run(settings, manager, Path("stonefall.toml")), 100)
    finally:
        gate.is_over.set()
    assert "READY=1" not in manager.heard
    assert "STOPPING=1" in manager.heard
    assert "no progress of acquisition" in caplog.text
    assert "the rig did not disarm in time" in caplog.text


async def test_only_who_looks_after_the_parts_calls_an_idle_one_alive(settings: Settings):
    store = await asyncio.to_thread(open_store, settings.store.dir)
    configured = Configuration(settings, Path("stonefall.toml"))
    built = await build.build(configured, store, ReaderProcess(), StopRequests())
    progress = built.watches.progress
    for part in ("acquisition", "processing"):
        progress.beat(part, time.monotonic() - 1000)
    assert progress.late(time.monotonic()) == progress.late(time.monotonic()) == ["acquisition", "processing"]
    built.acquisition.is_active = True  # whatever its state is
    assert built.watch() == ["acquisition"]
    built.acquisition.is_active = False
    assert built.watch() == progress.late(time.monotonic()) == []
    await asyncio.to_thread(store.close)
