"""The twin of a light gate that delivers the triggers of a recording.

Arming it starts the belt that plays the recording, disarming pauses it, closing ends the belt's thread.
"""

from drivers.errors import GateUnavailableError
from drivers.interfaces import EventSink
from drivers.replay.belt import ReplayBelt
from pipeline.frames import GateCount


class ReplayGate:
    """Delivers the recorded triggers, and `PlaybackEnded` after the last."""

    def __init__(self, belt: ReplayBelt) -> None:
        self._belt = belt
        self._is_open = False

    @property
    def warnings(self) -> tuple[str, ...]:
        return ()

    def resume(self, count: GateCount, n_known: int) -> None:
        """Do nothing: a recording stands still while no process plays it."""

    def open(self) -> None:
        self._is_open = True

    def arm(self, sink: EventSink) -> None:
        if not self._is_open:
            raise GateUnavailableError("gate", "is not open")
        self._belt.start(sink)

    def test_pulse(self) -> None:
        """Raise `GateUnavailableError`: a recording cannot expose."""
        raise GateUnavailableError("gate", "a recording has no rig to expose")

    def disarm(self) -> None:
        self._belt.pause()

    def close(self) -> None:
        self._belt.stop()
        self._is_open = False
