"""The errors that drivers raise.

::

    DriverError
    ├── RecordingError             a recording, bundle, rig or image file; names the file and the problem
    └── DeviceError                names the device, the problem and its cause
        ├── CameraUnavailableError
        └── GateUnavailableError
"""

from enum import StrEnum
from pathlib import Path


class LossCause(StrEnum):
    """Why a device cannot be used, for code that decides by it; the text beside it is for people."""

    SILENT = "silent"
    """It does not answer: no power, no cable, no switch, or the port of this machine is down."""
    WRONG_CAMERA = "wrong_camera"
    """Another camera answers at its address, or several match its settings."""
    IN_USE = "in_use"
    """Another application has control of it."""
    CONTROL_LOST = "control_lost"
    """It no longer knows this process: it was restarted, or its heartbeat ended."""
    WRONG_SETTINGS = "wrong_settings"
    """It is not set as configured, or cannot be."""
    PROCESS_ENDED = "process_ended"
    """The process that the cameras' library runs in has died, and with it the control of all cameras."""
    OTHER = "other"


class DriverError(Exception):
    """Root of the errors that drivers raise on purpose."""


class RecordingError(DriverError):
    """A file is missing, damaged, truncated, foreign or contradicts its recording."""

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(path, problem)  # the arguments of this class: pickle calls it with them
        self.path = path
        self.problem = problem

    def __str__(self) -> str:
        return f"{self.path}: {self.problem}"


class DeviceError(DriverError):
    """A device cannot do what was asked of it."""

    def __init__(self, device: str, problem: str, cause: LossCause = LossCause.OTHER) -> None:
        super().__init__(device, problem, cause)
        self.device = device
        self.problem = problem
        self.cause = cause

    def __str__(self) -> str:
        return f"{self.device}: {self.problem}"


class CameraUnavailableError(DeviceError):
    """The camera does not answer, is not the expected one, is in use, or is not set as configured."""


class GateUnavailableError(DeviceError):
    """The light gate does not answer, or cannot do what was asked of it."""
