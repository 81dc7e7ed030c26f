"""One camera of a disarmed rig blinks for a person, with cameras that write down what they are asked."""

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest
from support.acquisition import CAMERAS, AcquisitionBench
from support.eventually import PATIENCE_S
from support.recordings import make_bundle, write_recording

from drivers.errors import CameraUnavailableError
from drivers.factory import ReplayBackend, build_devices
from drivers.interfaces import CameraVitals, EventSink
from pipeline.frames import CameraId
from service.acquisition import shown_camera
from service.base.status import AcquisitionState, AcquisitionTarget, NotDisarmedError

LONG_S = 60.0


class LampCamera:
    """A camera with a lamp; `problem` is what it answers."""

    def __init__(self, camera: CameraId) -> None:
        self.id = camera
        self.calls: list[str] = []
        self.problem: str | None = None
        self.is_lit = False

    def _ask(self, what: str) -> None:
        self.calls.append(what)
        if self.problem is not None:
            raise CameraUnavailableError(self.id, self.problem)

    def open(self) -> None:
        self._ask("open")

    def arm(self, sink: EventSink) -> None:
        assert not self.is_lit
        self._ask("arm")

    def examine(self) -> CameraVitals:
        self._ask("examine")
        return CameraVitals(serial=f"serial of {self.id}")

    def light(self, *, is_on: bool) -> None:
        self._ask("light" if is_on else "dark")
        self.is_lit = is_on

    def disarm(self) -> None: ...

    def close(self) -> None:
        self.calls.append("close")
        self.is_lit = False

    @property
    def is_open(self) -> bool:
        return "open" in self.calls and self.calls[-1] != "close"


class Bench(AcquisitionBench):
    """A rig of cameras with lamps."""

    def __init__(self, folder: Path) -> None:
        self.cameras = {camera: LampCamera(camera) for camera in CAMERAS}
        recording = write_recording(folder / "rec", [make_bundle(0)])
        devices = build_devices(ReplayBackend(recording=recording, pace="stepped"))
        super().__init__(replace(devices, cameras=self.cameras))


@pytest.fixture
async def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Bench]:
    monkeypatch.setattr(shown_camera, "BLINK_S", 0.01)
    bench = Bench(tmp_path)
    async with asyncio.timeout(PATIENCE_S), asyncio.TaskGroup() as tasks:
        tasks.create_task(bench.acquisition.run())
        yield bench
        bench.acquisition.stop()
    assert not any(camera.is_open or camera.is_lit for camera in bench.cameras.values())


async def test_it_blinks_for_its_time_and_is_closed_then(bench: Bench) -> None:
    camera = bench.cameras[CAMERAS[1]]
    vitals = await bench.acquisition.show_camera(CAMERAS[1], 0.2)
    assert vitals.serial == "serial of c02"
    assert camera.calls[:3] == ["open", "examine", "light"]
    await bench.until(lambda: camera.calls.count("light") >= 2)
    await bench.until(lambda: not camera.is_open)
    assert not any(bench.cameras[other].calls for other in (CAMERAS[0], CAMERAS[2]))


async def test_the_next_camera_ends_the_one_before(bench: Bench) -> None:
    first, second = (bench.cameras[name] for name in CAMERAS[:2])
    await bench.acquisition.show_camera(CAMERAS[0], LONG_S)
    await bench.acquisition.show_camera(CAMERAS[1], LONG_S)
    assert not first.is_open
    assert second.is_open


async def test_an_armed_rig_shows_no_camera_and_to_arm_it_ends_the_show(bench: Bench) -> None:
    shown = bench.cameras[CAMERAS[0]]
    await bench.acquisition.show_camera(CAMERAS[0], LONG_S)
    bench.acquisition.request(AcquisitionTarget.ARMED)
    with pytest.raises(NotDisarmedError, match="arming"):
        await bench.acquisition.show_camera(CAMERAS[1], LONG_S)
    await bench.until(lambda: bench.acquisition.state is AcquisitionState.ARMED)
    assert shown.calls.index("close") < shown.calls.index("arm")
    with pytest.raises(NotDisarmedError, match="armed"):
        await bench.acquisition.show_camera(CAMERAS[1], LONG_S)
    assert "light" not in bench.cameras[CAMERAS[1]].calls


@pytest.mark.parametrize("is_shown_before", [False, True])
async def test_a_camera_that_fails_is_closed_and_may_be_asked_again(
    bench: Bench, is_shown_before: bool
) -> None:
    camera = bench.cameras[CAMERAS[0]]
    if is_shown_before:
        await bench.acquisition.show_camera(CAMERAS[0], LONG_S)
        camera.problem = "does not answer"
        await bench.until(lambda: not camera.is_open)
    camera.problem = "does not answer"
    with pytest.raises(CameraUnavailableError, match="does not answer"):
        await bench.acquisition.show_camera(CAMERAS[0], LONG_S)
    await bench.until(lambda: camera.calls[-1] == "close")
    camera.problem = None
    await bench.acquisition.show_camera(CAMERAS[0], LONG_S)
    assert camera.is_open


async def test_a_caller_that_goes_away_leaves_no_camera_open(bench: Bench) -> None:
    camera = bench.cameras[CAMERAS[0]]
    asking = asyncio.create_task(bench.acquisition.show_camera(CAMERAS[0], 0.05))
    await bench.until(lambda: "open" in camera.calls)
    asking.cancel()
    await bench.until(lambda: camera.calls[-1] == "close")
