"""Cameras of a library in their process: what a driver must do there, and is told where it does not."""

import socket
import threading
from contextlib import closing
from types import SimpleNamespace
from typing import Any

from drivers.camera_process.messages import Call, Doing, Heartbeat, Reply, connection, receive, send
from drivers.camera_process.server import serve
from drivers.errors import CameraUnavailableError
from pipeline.frames import CameraId

SETTINGS = SimpleNamespace(id=CameraId("c01"), n_buffers=2)


class WithoutMemory:
    """A driver that opens without taking memory for images."""

    def __init__(self, settings: Any, allocate: object, last: object) -> None:
        self.id, self.found, self.is_closed = settings.id, None, False

    def open(self) -> None:
        self.is_closed = False

    def close(self) -> None:
        self.is_closed = True


def test_a_driver_that_takes_no_memory_is_refused_by_name_and_the_process_serves_on() -> None:
    made = []

    def make(*given: Any) -> Any:
        made.append(WithoutMemory(*given))
        return made[-1]

    here, there = connection()
    serving = threading.Thread(target=serve, args=(there, make))
    serving.start()
    with closing(there), closing(here):
        for number in (1, 2):
            send(here, Call(number=number, settings=SETTINGS, doing=Doing.OPEN, last=None))
            reply = answer(here)
            assert reply.number == number
            assert isinstance(reply.result, CameraUnavailableError)
            assert "c01: its driver took no memory" in str(reply.result)
            assert made[0].is_closed
        here.shutdown(socket.SHUT_RDWR)
        serving.join()


def answer(end: Any) -> Reply:
    while True:
        received = receive(end)
        assert received is not None
        if isinstance(received[0], Reply):
            return received[0]
        assert isinstance(received[0], Heartbeat)
