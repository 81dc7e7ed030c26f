"""The thread that every live gate has: it reads the device and delivers to one sink."""

import threading
import time
from collections.abc import Callable

from drivers.errors import DeviceFault, GateUnavailableError, told
from drivers.files.times import utc_ago
from drivers.interfaces import DeviceEvent, EventSink, GateLost
from drivers.outlet import Outlet
from pipeline.frames import BundleKind, Trigger


def trigger_at(
    received_ns: int, sequence: int, *, device_ns: int = 0, kind: BundleKind = BundleKind.PARTICLE
) -> Trigger:
    """Return the trigger of an edge at `received_ns` of the host's clock; a gate without a clock has `device_ns` 0."""
    utc = utc_ago(time.monotonic_ns() - received_ns)
    return Trigger(sequence=sequence, received_ns=received_ns, device_ns=device_ns, utc=utc, kind=kind)


class GateThread:
    """Calls a function that reads the device, until it is stopped or fails; a failure is delivered once, as `GateLost`.

    `port` names the gate in errors.
    """

    def __init__(self, port: str) -> None:
        self._port = port
        self._outlet = Outlet()
        self._thread: threading.Thread | None = None
        self._stopping = threading.Event()
        self.failure: str | None = None
        """Why the gate was lost; None while it works."""

    @property
    def is_running(self) -> bool:
        """Whether it was started and not stopped; true also after the gate was lost."""
        return self._thread is not None

    def start(self, turn: Callable[[], None]) -> None:
        """Call `turn` again and again; each blocks for 0.1 s at most, `OSError` or `GateUnavailableError` ends all."""
        self._stopping.clear()
        self.failure = None
        self._thread = threading.Thread(
            target=self._run, args=(turn,), name=f"gate {self._port}", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Disarm and end the thread; idempotent."""
        self._outlet.unplug()
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def arm(self, sink: EventSink) -> None:
        """Deliver to `sink` from now on; raises `GateUnavailableError` unless the gate is open and not lost."""
        if self._thread is None:
            raise self.error("is not open")
        self._outlet.plug(sink)
        if self.failure is not None:  # checked last: a failure after this line is delivered
            self._outlet.unplug()
            raise self.error(self.failure)

    def disarm(self) -> None:
        """Deliver nothing more once this returns; idempotent."""
        self._outlet.unplug()

    @property
    def is_armed(self) -> bool:
        return self._outlet.is_plugged

    def deliver(self, event: DeviceEvent) -> None:
        """Deliver an event to the sink; dropped while the gate is disarmed."""
        self._outlet.deliver(event)

    def error(self, problem: str) -> GateUnavailableError:
        """Return an error that names the gate."""
        return GateUnavailableError(f"light gate {self._port}", problem)

    def _run(self, turn: Callable[[], None]) -> None:
        while not self._stopping.is_set():
            try:
                turn()
            except (OSError, GateUnavailableError) as err:
                gone = told(DeviceFault.GATE_GONE, reported=str(err))
                lost = err if isinstance(err, GateUnavailableError) else self.error(gone)
                self.failure = lost.problem
                self.deliver(GateLost(received_ns=time.monotonic_ns(), reason=lost.told))
                return
