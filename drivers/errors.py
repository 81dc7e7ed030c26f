"""What the drivers refuse.

::

    DriverError
    ├── RecordingError             a recording, bundle, rig or image file; names the file and the problem
    └── DeviceError                names the device
        ├── CameraUnavailableError
        └── GateUnavailableError
"""

from pathlib import Path


class DriverError(Exception):
    """Root of what the drivers raise on purpose."""


class RecordingError(DriverError):
    """A file is missing, damaged, truncated, foreign or contradicts its recording."""

    def __init__(self, path: Path, problem: str) -> None:
        super().__init__(path, problem)  # as given: workers send errors home pickled
        self.path = path
        self.problem = problem

    def __str__(self) -> str:
        return f"{self.path}: {self.problem}"


class DeviceError(DriverError):
    """A device cannot do what was asked."""

    def __init__(self, device: str, problem: str) -> None:
        super().__init__(device, problem)
        self.device = device
        self.problem = problem

    def __str__(self) -> str:
        return f"{self.device}: {self.problem}"


class CameraUnavailableError(DeviceError):
    """The camera is not there, or belongs to someone else."""


class GateUnavailableError(DeviceError):
    """The light gate is not there."""
