"""The process `stonefall-cams`: it does what the daemon calls for, with the library of the cameras.

Started by `CameraProcess` with the number of its end of the connection and the name of what makes a camera. When the
other end is gone, killed or not, it closes all cameras, so that the next process need not wait until their
heartbeats end, and ends itself.
"""

import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from drivers.camera_process.frame_memory import MAX_HELD, ON_THE_WAY, SlotsToFill
from drivers.camera_process.messages import (
    HEARTBEAT_S,
    Call,
    CameraSettings,
    Delivered,
    Doing,
    FrameHere,
    Heartbeat,
    Opened,
    Reply,
    SlotsFree,
    receive,
    send,
)
from drivers.cameras.frame_reader import Allocate
from drivers.cameras.stream_socket import udp_sockets
from drivers.errors import CameraUnavailableError
from drivers.interfaces import Camera, CameraVitals, DeviceEvent
from pipeline.frames import CameraId, Frame

PROCESS_NAME = "stonefall-cams"
"""Name of the process in `ps` and `top`, which show 15 characters."""
MAX_CALLS = 64
"""Calls at the same time, each of which may block for seconds."""


class HostedCamera(Camera, Protocol):
    """A camera of the library that runs here."""

    @property
    def found(self) -> Any:
        """Where it was found when it was opened, pickled; it may be looked for there first the next time."""
        ...

    def software_trigger(self) -> None:
        """Expose now; raises `CameraUnavailableError`."""
        ...


Factory = Callable[[CameraSettings, Allocate, Any], HostedCamera]
"""Makes a camera of its settings, of memory for its buffers, taken while it opens, and of where it was found last."""


def main() -> None:
    """Serve until the daemon is gone."""
    Path("/proc/self/comm").write_text(PROCESS_NAME)
    for number in (
        signal.SIGINT,
        signal.SIGTERM,
    ):  # meant for the daemon, which ends this process in its turn
        signal.signal(number, signal.SIG_IGN)
    module, _, name = sys.argv[2].partition(":")
    serve(socket.socket(fileno=int(sys.argv[1])), getattr(import_module(module), name))


def serve(end: socket.socket, make: Factory) -> None:
    """Do what is called for over this end of a connection until the other one is closed; then close all cameras."""
    cameras: dict[CameraId, ServedCamera] = {}
    threading.Thread(target=beat, args=(end,), name="heartbeat", daemon=True).start()
    with ThreadPoolExecutor(MAX_CALLS, "call") as calls:
        while (received := receive(end)) is not None:
            match received[0]:
                case Call() as call:
                    if (name := call.settings.id) not in cameras:
                        cameras[name] = ServedCamera(call, end, make)
                    calls.submit(cameras[name].answer, call)
                case SlotsFree(slots=slots):
                    for name, memory, slot in slots:
                        cameras[name].free(memory, slot)
        for camera in cameras.values():
            calls.submit(camera.device.close)


def beat(end: socket.socket) -> None:
    """Send heartbeats as long as this process runs and the daemon is there, also while cameras are being closed."""
    with suppress(OSError):
        while True:
            send(end, Heartbeat())
            time.sleep(HEARTBEAT_S)


class ServedCamera:
    """A camera with the memory that it receives into, and the sink that sends its events to the daemon."""

    def __init__(self, first: Call, end: socket.socket, make: Factory) -> None:
        self.device = make(first.settings, lambda n_bytes: self._slots.take(n_bytes), first.last)
        self._n_slots = first.settings.n_buffers + MAX_HELD + ON_THE_WAY
        self._end = end
        self._slots = SlotsToFill(self._n_slots)  # those of the latest opening
        self._memory = 0  # their number

    def answer(self, call: Call) -> None:
        """Do what is called for, and reply."""
        result: CameraVitals | CameraUnavailableError | None = None
        try:
            match call.doing:
                case Doing.OPEN:
                    self._open()
                case Doing.ARM:
                    self.device.arm(self)
                case Doing.EXAMINE:
                    result = self.device.examine()
                case Doing.SOFTWARE_TRIGGER:
                    self.device.software_trigger()
                case Doing.LIGHT:
                    self.device.light(is_on=True)
                case Doing.DARKEN:
                    self.device.light(is_on=False)
                case Doing.DISARM:
                    self.device.disarm()
                case Doing.CLOSE:
                    self.device.close()
        except CameraUnavailableError as err:
            result = err
        except Exception:  # noqa: BLE001 - the daemon waits for a reply
            result = CameraUnavailableError(self.device.id, traceback.format_exc())
        with suppress(OSError):  # the daemon is gone
            send(self._end, Reply(number=call.number, result=result))

    def deliver(self, event: DeviceEvent) -> bool:
        """Send the event to the daemon; `False` when it is gone."""
        try:
            if isinstance(event, Frame):
                send(self._end, self._whereabouts(event))
            else:
                send(self._end, Delivered(camera=self.device.id, event=event))
        except OSError:
            return False
        return True

    def free(self, memory: int, slot: int) -> None:
        """Let a slot be taken again, unless the camera was opened anew since."""
        if memory == self._memory:
            self._slots.free(slot)

    def _open(self) -> None:
        """Open the camera with memory of its own, and report it to the daemon."""
        self.device.close()
        self._slots.file.close()
        self._slots = SlotsToFill(self._n_slots)
        self._memory += 1
        self.device.open()
        if not self._slots.slot_bytes:
            self.device.close()
            self._slots.file.close()
            raise CameraUnavailableError(self.device.id, "its driver took no memory for images in open()")
        opened = Opened(
            camera=self.device.id,
            memory=self._memory,
            slot_bytes=self._slots.slot_bytes,
            n_slots=self._n_slots,
            found=self.device.found,
            sockets=udp_sockets(),
        )
        send(self._end, opened, [self._slots.file.fileno()])

    def _whereabouts(self, frame: Frame) -> FrameHere:
        height_px, width_px = frame.image.shape
        return FrameHere(
            camera=frame.camera,
            memory=self._memory,
            slot=self._slots.slot_of(frame.image),
            size_px=(width_px, height_px),
            frame_id=frame.frame_id,
            device_ns=frame.device_ns,
            received_ns=frame.received_ns,
        )


if __name__ == "__main__":
    main()
