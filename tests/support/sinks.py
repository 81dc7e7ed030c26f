"""Sinks for tests of devices."""

import queue
import threading

from support.eventually import PATIENCE_S

from drivers.interfaces import DeviceEvent


class Collector:
    """Keeps what is delivered, and lets a test wait for it."""

    def __init__(self, *, accepts: bool = True) -> None:
        self.events: list[DeviceEvent] = []
        self.threads: set[str] = set()
        self._accepts = accepts
        self._arrived: queue.Queue[DeviceEvent] = queue.Queue()

    def deliver(self, event: DeviceEvent) -> bool:
        self.events.append(event)
        self.threads.add(threading.current_thread().name)
        self._arrived.put(event)
        return self._accepts

    def next(self, timeout_s: float = PATIENCE_S) -> DeviceEvent:
        return self._arrived.get(timeout=timeout_s)
