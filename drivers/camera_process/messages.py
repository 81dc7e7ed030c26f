"""Messages between the daemon and the process of the cameras, over a socket that keeps them apart."""

import pickle
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

from drivers.errors import CameraUnavailableError
from drivers.interfaces import CameraVitals, DeviceEvent
from pipeline.frames import CameraId

MAX_BYTES = 1 << 16
"""Of a message; the longest is an error with a traceback."""
HEARTBEAT_S = 0.25
"""Interval between two heartbeats of the process."""
Address = tuple[str, int]
"""IPv4 address and UDP port."""


class CameraSettings(Protocol):
    """What a camera is opened with, of any library; pickled."""

    @property
    def id(self) -> CameraId: ...

    @property
    def n_buffers(self) -> int: ...


class Doing(StrEnum):
    """Operations of a camera: methods of `HostedCamera`; `LIGHT` and `DARKEN` are its `light`."""

    OPEN = "open"
    ARM = "arm"
    EXAMINE = "examine"
    SOFTWARE_TRIGGER = "software_trigger"
    LIGHT = "light"
    DARKEN = "darken"
    DISARM = "disarm"
    CLOSE = "close"


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """To the process: do something with a camera."""

    number: int
    settings: CameraSettings
    doing: Doing
    last: Any  # where it was found the last time, of the library's own type; None: never


@dataclass(frozen=True, slots=True, kw_only=True)
class Opened:
    """From the process: a camera is open; the file of the memory that it receives into comes with the message."""

    camera: CameraId
    memory: int  # its number
    slot_bytes: int
    n_slots: int
    found: Any  # where it was found, for the next time
    sockets: Sequence[Address]  # all of the process; one of them is in control of this camera


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """From the process: a call is done."""

    number: int
    result: CameraVitals | CameraUnavailableError | None


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameHere:
    """From the process: a `Frame`, its image in a slot of the memory."""

    camera: CameraId
    memory: int
    slot: int
    size_px: tuple[int, int]
    frame_id: int
    device_ns: int
    received_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Delivered:
    """From the process: any other event."""

    camera: CameraId
    event: DeviceEvent


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """From the process, all the time: it runs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SlotsFree:
    """To the process: these images are released, their slots may be filled again."""

    slots: Sequence[tuple[CameraId, int, int]]  # with the number of the memory


Message = Call | Opened | Reply | FrameHere | Delivered | Heartbeat | SlotsFree


def connection() -> tuple[socket.socket, socket.socket]:
    """Return both ends of a new connection."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def send(end: socket.socket, message: Message, files: Sequence[int] = ()) -> None:
    """Send a message, with open files; raises `OSError` when the other end is gone."""
    socket.send_fds(end, [pickle.dumps(message)], list(files))


def receive(end: socket.socket) -> tuple[Message, list[int]] | None:
    """Return the next message and its files, to be closed by the caller; None when the other end is gone."""
    try:
        data, files, _, _ = socket.recv_fds(end, MAX_BYTES, 1)
    except ConnectionError:
        return None
    return (pickle.loads(data), files) if data else None  # noqa: S301 - from our own process
