"""Between a device's thread and whoever armed the device."""

import threading

from drivers.interfaces import DeviceEvent, EventSink


class Outlet:
    """Where a device's sink is plugged in; once `unplug` returns nothing more is delivered."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sink: EventSink | None = None

    @property
    def is_plugged(self) -> bool:
        return self._sink is not None

    def plug(self, sink: EventSink) -> None:
        with self._lock:
            self._sink = sink

    def unplug(self) -> None:
        with self._lock:
            self._sink = None

    def deliver(self, event: DeviceEvent) -> None:
        with self._lock:
            if self._sink is not None:
                self._sink.deliver(event)
