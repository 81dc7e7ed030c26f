"""The two rigs of rehearsals: a recording that is replayed, and sixteen simulated GigE cameras with a light gate."""

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.files.recording import open_recording
from drivers.gige_simulator.rig import RigDesign, SimulatedRig
from service.base.status import AcquisitionState, AcquisitionTarget, CheckStatus
from service.commands.rehearsal.rehearsed_daemon import RehearsalError, RehearsedDaemon

RECORDED_HZ = 4.0
LIVE_HZ = 3.0
SETTLED = (AcquisitionState.ARMED, AcquisitionState.HELD, AcquisitionState.DISARMED)
QUIET_S = 2.0
"""A stone that passed the gate so long ago has its images, or will have none."""


class ReplayedRig:
    """A recording in a loop; it plays while the daemon is armed."""

    def __init__(self, recording: Path, speed: float, *, is_looping: bool) -> None:
        self._recording, self._speed, self._is_looping = recording, speed, is_looping

    def settings(self) -> dict[str, Any]:
        """Return `[rig]` and what else of the configuration it needs."""
        recording = {"recording": str(self._recording), "loop": self._is_looping, "speed": self._speed}
        return {"rig": {"backend": "replay", **recording}}

    def flow(self, daemon: RehearsedDaemon) -> None:
        """Let stones fall."""
        daemon.ask("/acquisition", {"state": AcquisitionTarget.ARMED}, "PUT")

    def rest(self, daemon: RehearsedDaemon) -> None:
        """Let no more fall, and return when all that fell has been seen."""
        daemon.wait_for("/acquisition", lambda now: now["state"] in SETTLED)
        daemon.ask("/acquisition", {"state": AcquisitionTarget.DISARMED}, "PUT")
        daemon.wait_for("/acquisition", lambda now: now["state"] == AcquisitionState.DISARMED)

    def fault(self, request: Mapping[str, Any]) -> None:
        """Carry out a request as the control socket of `stonefall simulate` takes it."""
        raise RehearsalError(
            f"{request}: a replayed recording has no cameras to break: set is_gige in the script"
        )


class SimulatedGigeRig(SimulatedRig):
    """Cameras on loopback, a gate on a pseudo-terminal and a belt, in this process."""

    def __init__(self, recording: Path, speed: float, folder: Path) -> None:
        self._recording, self._gate = recording, folder / "gate"
        design = RigDesign(
            gate_link=self._gate,
            first_address=f"127.90.{os.getpid() % 251 + 1}.2",
            rate_hz=min(LIVE_HZ * speed, RECORDED_HZ),
            is_looping=True,
            only_stones=True,
        )
        super().__init__(design, open_recording(recording))

    def settings(self) -> dict[str, Any]:
        cameras = [
            {"id": camera.design.id, "serial": camera.design.serial, "address": camera.design.address}
            for camera in self.cameras.values()
        ]
        rig = {
            "backend": "aravis",
            "is_simulated": True,
            "calibration": str(self._recording / "rig.json"),
            "interfaces": ["127.0.0.1"],
            "gate": {"serial": {"port": str(self._gate)}},
            "cameras": cameras,
        }
        return {"rig": rig, "empty_rig": {"at_start": 2, "every_s": 0.0}}

    def flow(self, daemon: RehearsedDaemon) -> None:
        daemon.wait_for("/acquisition", lambda now: now["cameras_armed"] == len(self.cameras))
        daemon.wait_for(
            "/health", lambda health: health["checks"]["background"]["status"] == CheckStatus.PASS
        )
        self.belt.start()

    def rest(self, daemon: RehearsedDaemon) -> None:
        self.belt.stop()
        time.sleep(QUIET_S)

    def fault(self, request: Mapping[str, Any]) -> None:
        self._requests.answer(request)


Rig = ReplayedRig | SimulatedGigeRig
