"""A process of their own for the cameras: it dies, hangs or is left alone, and what it has delivered remains."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Iterator
from math import inf
from pathlib import Path

import numpy as np
import pytest
from support.eventually import PATIENCE_S, eventually
from support.gige import GigeRig, design, gige_rig, powered, settings_for
from support.recordings import CAMERAS, tagged_image
from support.sinks import Collector

from drivers.camera_process import process as camera_process
from drivers.camera_process.frame_memory import MAX_HELD, ON_THE_WAY
from drivers.camera_process.process import CameraProcess
from drivers.cameras.aravis import AravisCamera
from drivers.errors import CameraUnavailableError, LossCause
from drivers.factory import ARAVIS
from drivers.interfaces import CameraLost, CameraProcessStatus, ProcessState
from pipeline.frames import Frame


@pytest.fixture
def process() -> Iterator[CameraProcess]:
    process = CameraProcess(ARAVIS)
    yield process
    process.close()


@pytest.fixture
def rig(process: CameraProcess) -> Iterator[GigeRig]:
    with gige_rig(CAMERAS, process) as rig:
        for camera in rig.cameras.values():
            camera.open()
        yield rig


def armed(rig: GigeRig) -> list[Collector]:
    sinks = [Collector() for _ in rig.cameras]
    for camera, sink in zip(rig.cameras.values(), sinks, strict=True):
        camera.arm(sink)
    return sinks


def test_its_death_loses_all_cameras_and_the_next_process_has_them_at_once(
    rig: GigeRig, process: CameraProcess
) -> None:
    sinks = armed(rig)
    rig.fire()
    before = [sink.next() for sink in sinks]
    died = process.pid
    assert died is not None
    os.kill(died, signal.SIGABRT)
    for sink in sinks:
        lost = sink.next()
        assert isinstance(lost, CameraLost)
        assert lost.cause is LossCause.PROCESS_ENDED
        assert "ended (SIGABRT)" in lost.reason
    for camera, frame in zip(rig.cameras.values(), before, strict=True):
        assert isinstance(frame, Frame)
        assert np.array_equal(frame.image, tagged_image(0, camera.id))
        with pytest.raises(CameraUnavailableError, match="is not open"):
            camera.examine()
        camera.close()
        camera.open()  # not "in use by another application": control was given back for the dead process
    assert process.pid != died
    again = armed(rig)
    rig.fire()
    for camera, sink in zip(rig.cameras.values(), again, strict=True):
        frame = sink.next()
        assert isinstance(frame, Frame)
        assert np.array_equal(frame.image, tagged_image(1, camera.id))


def test_a_call_under_way_fails_when_it_dies(rig: GigeRig, process: CameraProcess) -> None:
    (camera, *_) = rig.cameras.values()
    assert process.pid is not None
    os.kill(process.pid, signal.SIGSTOP)
    failed: list[CameraUnavailableError] = []

    def examine() -> None:
        with pytest.raises(CameraUnavailableError) as caught:
            camera.examine()
        failed.append(caught.value)

    call = threading.Thread(target=examine)
    call.start()
    os.kill(process.pid, signal.SIGKILL)
    call.join(PATIENCE_S)
    assert [error.cause for error in failed] == [LossCause.PROCESS_ENDED]


def test_one_that_hangs_is_killed(
    rig: GigeRig, process: CameraProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    (sink, *_) = armed(rig)
    (camera, *_) = rig.cameras.values()
    monkeypatch.setattr(camera_process, "CALL_S", 0.2)
    assert process.pid is not None
    os.kill(process.pid, signal.SIGSTOP)
    with pytest.raises(CameraUnavailableError, match=r"took more than 0\.2 s to examine"):
        camera.examine()
    lost = sink.next()
    assert isinstance(lost, CameraLost)
    assert "SIGKILL" in lost.reason
    monkeypatch.undo()
    camera.close()
    camera.open()


@pytest.mark.full
def test_one_that_hangs_is_replaced_although_nothing_is_called_for(
    rig: GigeRig, process: CameraProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    sinks = armed(rig)
    hung = process.pid
    assert hung is not None
    eventually(lambda: process.status() == CameraProcessStatus())
    monkeypatch.setattr(camera_process, "HUNG_S", inf)
    os.kill(hung, signal.SIGSTOP)
    eventually(lambda: process.status().state is ProcessState.SILENT)
    assert process.status().trouble == "the process of the cameras sends no heartbeat: no image comes"
    monkeypatch.undo()
    for sink in sinks:
        lost = sink.next()
        assert isinstance(lost, CameraLost)
        assert (lost.cause, lost.reason) == (
            LossCause.PROCESS_ENDED,
            "the process of the cameras hung, without a heartbeat for 2 s, and was killed",
        )
    for camera in rig.cameras.values():
        camera.close()
        camera.open()
    assert process.pid != hung
    status = process.status()
    assert (status.state, status.replaced) == (ProcessState.REPLACED, 1)
    assert status.trouble == lost.reason


def test_images_are_not_copied_unless_many_are_held(rig: GigeRig) -> None:
    (sink, *_) = armed(rig)
    (camera, *_) = rig.cameras.values()
    frames = []
    n_stones = 8 + MAX_HELD + ON_THE_WAY + 4  # more than there is memory for
    for _ in range(n_stones):
        rig.fire()
        frames.append(sink.next())
    for number, frame in enumerate(frames):
        assert isinstance(frame, Frame)
        assert np.array_equal(frame.image, tagged_image(number, camera.id))
        assert not frame.image.flags.writeable
    is_copy = [isinstance(frame, Frame) and frame.image.base is None for frame in frames]
    assert is_copy == [False] * MAX_HELD + [True] * (n_stones - MAX_HELD)
    part = frames[0].image[2:, 3:]  # any view keeps the memory
    expected = part.copy()
    frames.clear()
    sink.events.clear()
    del frame
    for _ in range(n_stones):
        rig.fire()
        sink.next()
        sink.events.clear()
    assert np.array_equal(part, expected)


def test_it_ends_with_its_daemon_and_leaves_the_cameras_to_the_next_one() -> None:
    with powered(design()) as simulated:
        program = f"""
            import time
            from support.gige import design, settings_for
            from support.sinks import Collector
            from drivers.camera_process.camera import RemoteCamera
            from drivers.camera_process.process import CameraProcess
            from drivers.factory import ARAVIS
            process = CameraProcess(ARAVIS)
            camera = RemoteCamera(settings_for(design(), address={simulated.design.address!r}), process)
            camera.open()
            camera.arm(Collector())
            print(process.pid, flush=True)
            time.sleep(60)
        """
        tests = Path(__file__).parents[1]
        daemon = subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(program)],
            stdout=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": f"{tests}{os.pathsep}{tests.parent}"},
        )
        with daemon:
            assert daemon.stdout is not None
            pid = int(daemon.stdout.readline())
            assert Path(f"/proc/{pid}/comm").read_text() == "stonefall-cams\n"
            daemon.send_signal(signal.SIGKILL)
        eventually(lambda: not Path(f"/proc/{pid}").exists())
        camera = AravisCamera(settings_for(design()))
        camera.open()
        camera.close()
        events = [entry.event for entry in simulated.log]
        assert not any(event.startswith("heartbeat of") for event in events)  # nobody had to wait for it
