"""The connection between a device's thread and the sink that the device was armed with."""

import threading

from drivers.interfaces import DeviceEvent, EventSink


class Outlet:
    """Holds at most one sink; once `unplug` returns nothing more is delivered to it. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sink: EventSink | None = None

    @property
    def is_plugged(self) -> bool:
        return self._sink is not None

    def plug(self, sink: EventSink) -> None:
        """Deliver to `sink` from now on."""
        with self._lock:
            self._sink = sink

    def unplug(self) -> None:
        """Drop what is delivered from now on; waits for a delivery under way."""
        with self._lock:
            self._sink = None

    def deliver(self, event: DeviceEvent) -> None:
        """Hand an event to the sink; without a sink it is dropped."""
        with self._lock:
            if self._sink is not None:
                self._sink.deliver(event)
