"""The daemon's end of the process that the cameras' library runs in."""

import logging
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any

from drivers import gvcp
from drivers.camera_process.frame_memory import MAX_HELD, FilledSlots
from drivers.camera_process.messages import (
    Address,
    Call,
    CameraSettings,
    Delivered,
    Doing,
    FrameHere,
    Heartbeat,
    Message,
    Opened,
    Reply,
    SlotsFree,
    connection,
    receive,
    send,
)
from drivers.errors import CameraUnavailableError, LossCause
from drivers.interfaces import CameraLost, CameraProcessStatus, CameraVitals, ProcessState
from drivers.outlet import Outlet
from pipeline.frames import CameraId, Frame

log = logging.getLogger(__name__)

CALL_S = 20.0
"""Longest call; to close a dead camera takes 8 s. A process that takes longer hangs, and is killed."""
SILENT_S = 0.7
"""Age of the latest heartbeat from which health names the process: three triggers without an image take longer."""
HUNG_S = 2.0
"""Time without a heartbeat after which the process hangs, and is killed; the next one is started at once."""
LISTEN_S = 0.1
"""Longest wait for a message; one that took longer was the daemon's or the host's, which stood still."""
RECENT_S = 60.0
"""Time for which a process that was replaced is reported."""
SERVER = "drivers.camera_process.server"
STABLE_S = 10.0
"""A process that lived shorter is not replaced before a camera is opened: its callers wait longer each time."""

Result = CameraVitals | None


class Pulse:
    """The heartbeats of one process, from its first one on."""

    def __init__(self) -> None:
        self._heard_s: float | None = None  # when the latest came
        self._waited_s = 0.0  # for the next one

    def beat(self, now_s: float) -> None:
        """Note a heartbeat."""
        self._heard_s, self._waited_s = now_s, 0.0

    def wait(self, waited_s: float) -> None:
        """Note the time waited for a message: while the host stood still, the process cannot be judged."""
        self._waited_s += min(waited_s, LISTEN_S)

    def is_silent(self, now_s: float) -> bool:
        """True when no heartbeat came for longer than `SILENT_S`, so that images may be missing."""
        return self._heard_s is not None and now_s - self._heard_s > SILENT_S

    @property
    def is_lost(self) -> bool:
        """Whether the process hangs, and is to be killed."""
        return self._heard_s is not None and self._waited_s > HUNG_S


class CameraProcess:
    """Starts the process with the first camera that is opened, and again when it has died, until `close`.

    `factory`, as `module:name`, makes each camera there: of its settings, of the memory that it receives into, and of
    where it was found the last time. All cameras are lost with the process, and those that were armed are told of.
    Thread-safe.
    """

    def __init__(self, factory: str) -> None:
        self._factory = factory
        self._lock = threading.Lock()
        self._outlets: dict[CameraId, Outlet] = {}
        self._found: dict[CameraId, Any] = {}  # the last time
        self._life: _Life | None = None
        self._is_closed = False
        self._pulse = Pulse()  # of the process that sent the latest heartbeat
        self._n_replaced = 0
        self._last_end: tuple[str, float] | None = None  # of a process that ended by itself: why, and when

    @property
    def pid(self) -> int | None:
        """Number of the process, None while there is none."""
        return None if (life := self._life) is None else life.process.pid

    def status(self) -> CameraProcessStatus:
        """Return the state of the process; never blocks."""
        now_s, ended = time.monotonic(), self._last_end
        if self._pulse.is_silent(now_s) and not self._is_closed:
            state, trouble = (
                ProcessState.SILENT,
                "the process of the cameras sends no heartbeat: no image comes",
            )
        elif ended is not None and now_s - ended[1] < RECENT_S:
            state, trouble = ProcessState.REPLACED, ended[0]
        else:
            return CameraProcessStatus(replaced=self._n_replaced)
        return CameraProcessStatus(state=state, replaced=self._n_replaced, trouble=trouble)

    def register(self, camera: CameraId, outlet: Outlet) -> None:
        """Deliver a camera's events there."""
        self._outlets[camera] = outlet

    def call(self, settings: CameraSettings, doing: Doing) -> Result:
        """Call an operation of a camera in the process, which only an opening starts.

        Raises
        ------
        CameraUnavailableError
            The camera cannot do it, or the process died or had to be killed meanwhile.
        """
        with self._lock:
            if self._life is None and doing is Doing.OPEN and not self._is_closed:
                self._start()
            life = self._life
            if life is None:
                raise CameraUnavailableError(settings.id, "is not open")
            called = life.call(settings, doing, self._found.get(settings.id))
        try:
            return called.result(CALL_S)
        except TimeoutError:
            log.error("the process of the cameras hangs camera=%s doing=%s", settings.id, doing)
            life.process.kill()
            problem = f"took more than {CALL_S:g} s to {doing}"
            raise CameraUnavailableError(settings.id, problem, LossCause.PROCESS_ENDED) from None

    def close(self) -> None:
        """End the process, which closes the cameras that are open."""
        with self._lock:
            self._is_closed = True
            life = self._life
        if life is not None:
            life.end.shutdown(socket.SHUT_WR)
            life.listener.join(CALL_S)
            life.process.kill()
            life.listener.join()

    def _start(self) -> None:
        """Start a process; the lock is held."""
        here, there = connection()
        with there:
            command = [sys.executable, "-P", "-m", SERVER, str(there.fileno()), self._factory]
            process = subprocess.Popen(  # noqa: S603 - our own module
                command, pass_fds=[there.fileno()], stdin=subprocess.DEVNULL
            )
        self._life = _Life(process, here, self._listen)

    def _listen(self, life: "_Life") -> None:
        """Receive messages of the process until it ends, then start another one."""
        while (received := life.next()) is not None:
            message, files = received
            match message:
                case FrameHere():
                    self._outlets[message.camera].deliver(life.frame(message))
                case Delivered(camera=camera, event=event):
                    self._outlets[camera].deliver(event)
                case Opened(camera=camera, found=found):
                    life.opened(message, files[0])
                    if found is not None:
                        self._found[camera] = found
                case Reply():
                    life.reply(message)
                case Heartbeat():
                    life.pulse.beat(time.monotonic())
                    self._pulse = life.pulse
            life.return_slots()
        exit_code = life.process.wait()
        lived_s = time.monotonic() - life.started_s
        reason = f"the process of the cameras ended ({_name(exit_code)})"
        if life.has_hung:
            reason = f"the process of the cameras hung, without a heartbeat for {HUNG_S:g} s, and was killed"
        if not self._is_closed:
            log.error("%s after_s=%.1f", reason, lived_s)
            self._n_replaced += 1
            self._last_end = reason, time.monotonic()
            found = [each for each in self._found.values() if isinstance(each, gvcp.DiscoveredCamera)]
            gvcp.release_control([each.address for each in found], [*life.sockets])
        with self._lock:
            self._life = None
            life.end.close()
            if not self._is_closed and lived_s >= STABLE_S:
                self._start()
        life.fail_calls(reason)
        for camera, outlet in self._outlets.items():
            outlet.deliver(
                CameraLost(
                    camera=camera,
                    received_ns=time.monotonic_ns(),
                    reason=reason,
                    cause=LossCause.PROCESS_ENDED,
                )
            )


class _Life:
    """One process, from its start to its end."""

    def __init__(
        self, process: "subprocess.Popen[bytes]", end: socket.socket, listen: "Callable[[_Life], None]"
    ) -> None:
        self.process = process
        self.end = end
        self.started_s = time.monotonic()
        self.pulse = Pulse()
        self.has_hung = False
        self.sockets: set[Address] = set()
        self._calls: dict[int, tuple[CameraId, Future[Result]]] = {}
        self._n_calls = 0
        self._memory: dict[CameraId, tuple[int, FilledSlots]] = {}
        self._freed: deque[tuple[CameraId, int, int]] = deque()
        self._arrival = select.poll()
        self._arrival.register(end, select.POLLIN)
        self.listener = threading.Thread(target=listen, args=(self,), name="cameras", daemon=True)
        self.listener.start()

    def next(self) -> tuple[Message, list[int]] | None:
        """Return the next message of the process, None when it has ended; kill one that hangs."""
        has_arrived = False
        while not has_arrived:
            began_s = time.monotonic()
            has_arrived = bool(self._arrival.poll(1000 * LISTEN_S))
            self.pulse.wait(time.monotonic() - began_s)
            if self.pulse.is_lost and not self.has_hung:
                self.has_hung = True
                self.process.kill()
        return receive(self.end)

    def call(self, settings: CameraSettings, doing: Doing, last: Any) -> Future[Result]:
        """Call for something, not by two threads at the same time; the call fails with the process."""
        self._n_calls += 1
        called: Future[Result] = Future()
        self._calls[self._n_calls] = settings.id, called
        with suppress(OSError):  # it has just died
            send(self.end, Call(number=self._n_calls, settings=settings, doing=doing, last=last))
        return called

    def reply(self, reply: Reply) -> None:
        """End a call."""
        _, called = self._calls.pop(reply.number)
        if isinstance(reply.result, CameraUnavailableError):
            called.set_exception(reply.result)
        else:
            called.set_result(reply.result)

    def fail_calls(self, reason: str) -> None:
        """Fail all calls under way, once no other can be made."""
        for camera, called in self._calls.values():
            called.set_exception(CameraUnavailableError(camera, reason, LossCause.PROCESS_ENDED))

    def opened(self, opened: Opened, file: int) -> None:
        """See the memory of an open camera."""
        name, memory, freed = opened.camera, opened.memory, self._freed
        slots = FilledSlots(
            file, opened.slot_bytes, opened.n_slots, lambda slot: freed.append((name, memory, slot))
        )
        self._memory[name] = memory, slots
        self.sockets.update(opened.sockets)

    def frame(self, here: FrameHere) -> Frame:
        """Return the frame, its image where it is; a copy when many others are held."""
        _, slots = self._memory[here.camera]
        see = slots.image if slots.n_held < MAX_HELD else slots.copy
        return Frame(
            camera=here.camera,
            image=see(here.slot, here.size_px),
            frame_id=here.frame_id,
            device_ns=here.device_ns,
            received_ns=here.received_ns,
        )

    def return_slots(self) -> None:
        """Report released image buffers, those of replaced segments included."""
        freed = [self._freed.popleft() for _ in range(len(self._freed))]
        if freed:
            with suppress(OSError):
                send(self.end, SlotsFree(slots=freed))


def _name(exit_code: int) -> str:
    return signal.Signals(-exit_code).name if exit_code < 0 else f"exit code {exit_code}"
