"""A sink that keeps what devices deliver, for tests that wait for it."""

import threading
import time
from collections.abc import Callable
from typing import TypeVar

from drivers.interfaces import DeviceEvent

Kind = TypeVar("Kind")


class Collector:
    """Keeps every event, in the order of delivery; thread-safe."""

    def __init__(self) -> None:
        self._changed = threading.Condition(threading.RLock())
        self.events: list[DeviceEvent] = []

    def deliver(self, event: DeviceEvent) -> bool:
        with self._changed:
            self.events.append(event)
            self._changed.notify_all()
        return True

    def of(self, kind: type[Kind]) -> list[Kind]:
        with self._changed:
            return [event for event in self.events if isinstance(event, kind)]

    def wait(self, condition: Callable[[], bool], timeout_s: float = 10.0) -> None:
        """Return once `condition` holds; it is asked again after every event."""
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while not condition():
                assert self._changed.wait(deadline - time.monotonic()), f"only {self.events}"
