"""The real daemon on a simulated rig: sixteen small GigE cameras, a light gate, one belt."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from support.daemon_process import DaemonProcess
from support.eventually import PATIENCE_S

from drivers.files.recording import open_recording
from drivers.gige_simulator.camera import SimulatedCamera
from drivers.gige_simulator.rig import RigDesign, SimulatedRig
from drivers.gige_simulator.sources import SIGHT_MS
from pipeline.frames import CameraId
from service.configuration.camera_wire import BUFFER_BYTES

SPACING_S = 0.27


def own_address(number: int = 0) -> str:
    """First address of a loopback network that no other test process uses at the same time."""
    return f"127.{100 + number}.{os.getpid() % 251 + 1}.2"


def live_section(
    rig: SimulatedRig,
    folder: Path,
    recording: Path,
    *,
    more: str = "",
    by_address: bool = False,
    at_start: int = 2,
) -> str:
    """`[rig]` of a configuration; cameras are found by serial number, by broadcast on loopback."""
    cameras = "\n".join(
        f'[[rig.cameras]]\nid = "{camera.design.id}"\nserial = "{camera.design.serial}"'
        + (f'\naddress = "{camera.design.address}"' if by_address else "")
        + (f'\ntrigger = "{next(iter(camera.design.ways.sources))}"' if camera.design.personality else "")
        for camera in rig.cameras.values()
    )
    return f"""[rig]
backend = "aravis"
is_simulated = true
calibration = "{recording}/rig.json"
interfaces = ["127.0.0.1"]
{more}
[rig.gate.serial]
port = "{folder}/gate"
{cameras}
[empty_rig]
at_start = {at_start}
every_s = 0
"""


@contextmanager
def simulated_rig(
    folder: Path,
    recording: Path,
    *,
    rate_hz: float = 4.0,
    is_looping: bool = True,
    sight_ms: float = SIGHT_MS,
    number: int = 0,
    only_stones: bool = False,
    strobe_line: str | None = None,
    vendors: tuple[str, ...] = (),
    timer_ms: float = 0.0,
    gate_places: int = 8,
    uplink_bytes_s: float | None = None,
    uplink_buffer_bytes: int = BUFFER_BYTES,
) -> Iterator[SimulatedRig]:
    """The belt stands until it is started."""
    design = RigDesign(
        gate_link=folder / "gate",
        first_address=own_address(number),
        rate_hz=rate_hz,
        is_looping=is_looping,
        only_stones=only_stones,
        sight_ms=sight_ms,
        strobe_line=strobe_line,
        vendors=vendors,
        timer_ms=timer_ms,
        gate_places=gate_places,
        uplink_bytes_s=uplink_bytes_s,
        uplink_buffer_bytes=uplink_buffer_bytes,
    )
    with SimulatedRig(design, open_recording(recording)) as rig:
        yield rig


class LiveRig:
    """A rig and the daemon on it."""

    def __init__(self, rig: SimulatedRig, daemon: DaemonProcess) -> None:
        self.rig = rig
        self.daemon = daemon

    @property
    def stones(self) -> int:
        return int(self.rig.counters()["belt"]["stones"])

    def camera(self, camera: str) -> SimulatedCamera:
        return self.rig.cameras[CameraId(camera)]

    def status(self, camera: str) -> dict[str, Any]:
        return self.daemon.get(f"/cameras/{camera}")

    def acquisition(self) -> dict[str, Any]:
        return self.daemon.get("/acquisition")

    def results(self, after: int) -> list[dict[str, Any]]:
        return list(self.daemon.get(f"/results?after={after}&limit=1000")["items"])

    def last_seq(self) -> int:
        return int(self.daemon.get("/results?after=0&limit=1")["last_seq"])

    def fall(self, n_stones: int, spacing_s: float = SPACING_S) -> None:
        """Let so many stones fall; returns when the last one passed the gate."""
        goal = self.stones + n_stones
        while self.stones < goal:
            dropped = sum(self.rig.counters()["belt"][each] for each in ("stones", "empty"))
            self.rig.belt.drop_one()
            eventually(
                lambda dropped=dropped: (
                    sum(self.rig.counters()["belt"][each] for each in ("stones", "empty")) > dropped
                ),
                "the belt moves",
            )
            threading.Event().wait(spacing_s)

    def measure(self, n_stones: int, *, n_results: int | None = None) -> list[dict[str, Any]]:
        """Let so many stones fall, and return their outcomes."""
        before = self.last_seq()
        self.fall(n_stones)
        return self.wait_for_results(before, n_stones if n_results is None else n_results)

    def wait_for_results(
        self, after: int, n_results: int, timeout_s: float = PATIENCE_S
    ) -> list[dict[str, Any]]:
        eventually(
            lambda: len(self.results(after)) >= n_results and self.accounting()["in_progress"] == 0,
            f"{n_results} outcomes after {after}: {self.daemon.log[-3000:]}",
            timeout_s,
        )
        return self.results(after)

    def accounting(self) -> dict[str, Any]:
        return self.daemon.get("/accounting")

    def measure_until_whole(self, most: int = 8) -> None:
        """Let two stones fall, and more until one is measured by all views; at most so many.

        The first image of a camera whose clock was set is not believed, and a busy machine may lose another.
        """
        results = self.measure(2)
        while results[-1]["outcome"] != "measured" or results[-1]["dropped_views"]:
            assert len(results) < most, f"not whole: {results}"
            results += self.measure(1)

    def wait_until_whole(self, timeout_s: float = PATIENCE_S) -> None:
        """Return once every camera and the gate are at work."""
        eventually(
            lambda: (
                self.acquisition()["state"] == "armed"
                and self.acquisition()["cameras_armed"] == len(self.rig.cameras)
            ),
            f"all at work: {self.daemon.log[-3000:]}",
            timeout_s,
        )


@contextmanager
def live_rig(
    folder: Path,
    recording: Path,
    *,
    more: str = "",
    by_address: bool = False,
    is_looping: bool = True,
    sight_ms: float = SIGHT_MS,
    number: int = 0,
) -> Iterator[LiveRig]:
    """Armed, with all cameras, the empty rig seen."""
    with simulated_rig(folder, recording, is_looping=is_looping, sight_ms=sight_ms, number=number) as rig:
        section = live_section(rig, folder, recording, more=more, by_address=by_address)
        with DaemonProcess(folder, recording, rig=section) as daemon:
            daemon.hear("READY=1")
            live = LiveRig(rig, daemon)
            live.wait_until_whole()
            daemon.wait_for("/accounting", lambda counts: counts["backgrounds"] == 2)
            daemon.wait_for("/health", lambda health: health["checks"]["background"]["status"] == "pass")
            eventually(
                lambda: all(camera.counters.frames >= 2 for camera in rig.cameras.values()),
                "both exposures of the empty rig are over",
            )
            yield live


def eventually(condition: Callable[[], bool], what: str, timeout_s: float = PATIENCE_S) -> None:
    """Return once the condition holds."""
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, f"never: {what}"
        threading.Event().wait(0.02)
