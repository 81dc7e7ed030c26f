"""The bootstrap registers of a GigE camera, at the same addresses in all of them: control, heartbeat, link, stream."""

from collections.abc import Sequence
from typing import Any

from drivers import gvcp
from drivers.cameras.aravis_library import aravis_errors
from drivers.cameras.genicam import Feature
from drivers.cameras.offers import was_put_back
from drivers.errors import CameraUnavailableError, LossCause, Told
from pipeline.frames import CameraId

HEARTBEAT_MS = 3000
"""Time without a sign of life after which a camera ends the control of a host, as after power-on. Debuggers set
minutes, for which it then waits for a dead process; below Aravis' interval of a second control is lost all the time."""

_LINK_SPEED_MBIT_S, _HEARTBEAT_MS, _STREAM_PORT = 0x670, 0x938, 0xD00
"""Addresses; the stream's port on the host is 0 without a stream."""
_CONTROL = 0x2
"""Value of the control privilege: its owner may write, others may read."""


class BootstrapRegisters:
    """Reads and writes the registers of an open camera; every failure is a `CameraUnavailableError`."""

    def __init__(self, camera: CameraId, device: Any) -> None:
        self._camera = camera
        self._device = device

    def link_mbit_s(self) -> int:
        """Return the speed of its link; raises for cameras from before GigE Vision 1.1, which do not say."""
        return self._read(_LINK_SPEED_MBIT_S)

    def require_controller(self, address: str) -> None:
        """Raise `CameraUnavailableError` if another application controls the camera at `address`."""
        if not self._device.is_controller():
            raise CameraUnavailableError(
                self._camera,
                f"is in use by another application at {address}; if it was a predecessor of this one, "
                f"killed, its heartbeat ends within {self._read(_HEARTBEAT_MS) / 1e3:g} s",
                LossCause.IN_USE,
            )

    def require_control(self, stream_port: int, *, is_known_lost: bool) -> None:
        """Raise `CameraUnavailableError` if the camera was restarted, or another application controls it."""
        is_known = not is_known_lost and self._read(gvcp.CONTROL_PRIVILEGE) != 0
        if not is_known or self._read(_STREAM_PORT) & 0xFFFF != stream_port:
            raise CameraUnavailableError(
                self._camera,
                "control was lost: the camera was restarted, or its heartbeat ended",
                LossCause.CONTROL_LOST,
            )
        try:
            # only the application in control may write this register
            self._write(gvcp.CONTROL_PRIVILEGE, _CONTROL, "keep it")
        except CameraUnavailableError as err:
            if err.cause is LossCause.SILENT:
                raise
            problem = f"control was lost: {err.problem}"
            raise CameraUnavailableError(self._camera, problem, LossCause.CONTROL_LOST) from err

    def put_heartbeat_back(self, configured: Sequence[Feature]) -> list[Told]:
        """Set the heartbeat timeout unless it is configured; return the remark if that changed it."""
        names = {"GevHeartbeatTimeout", "DeviceLinkHeartbeatTimeout"}
        before_ms = self._read(_HEARTBEAT_MS)
        if before_ms == HEARTBEAT_MS or names & {name for name, _ in configured}:
            return []
        self._write(_HEARTBEAT_MS, HEARTBEAT_MS, "set its heartbeat timeout")
        return [was_put_back("GevHeartbeatTimeout", before_ms, self._read(_HEARTBEAT_MS))]

    def _read(self, address: int) -> int:
        with aravis_errors(self._camera, f"read register 0x{address:x}"):
            return int(self._device.read_register(address))

    def _write(self, address: int, value: int, purpose: str) -> None:
        with aravis_errors(self._camera, purpose):
            self._device.write_register(address, value)
