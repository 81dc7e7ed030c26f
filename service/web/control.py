"""The running daemon, as the REST interface sees it.

The daemon implements `Control`; tests of the routes put a fake in its place. Nothing here blocks: the daemon's own
tasks query the devices, and this returns what they found last.
"""

from typing import Protocol, TypeVar

from service.base.camera_status import CameraStatus

T = TypeVar("T")


class Control(Protocol):
    """The parts of the daemon that routes use. Call every method on the event loop."""

    def part(self, kind: type[T]) -> T:
        """Return the part of this class, or its state now: the routes of a room ask for the class of that room."""
        ...

    def cameras(self) -> list[CameraStatus]:
        """Return the status of all cameras, in the order of the rig."""
        ...
