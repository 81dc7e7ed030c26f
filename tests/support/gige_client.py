"""A GigE Vision application of raw sockets, independent of Aravis: asks, receives, remembers nothing."""

import itertools
import socket
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

GVCP_PORT = 3956
DISCOVERY, RESEND, ACTION = 0x02, 0x40, 0x100
READREG, WRITEREG, READMEM, WRITEMEM = 0x80, 0x82, 0x84, 0x86
CCP, SCP, SCPS, SCDA = 0xA00, 0xD00, 0xD04, 0xD18
LEADER, TRAILER, PAYLOAD = 1, 2, 3
NOT_IMPLEMENTED, INVALID_PARAMETER, INVALID_ADDRESS, WRITE_PROTECT, BAD_ALIGNMENT, ACCESS_DENIED, BUSY = (
    range(0x8001, 0x8008)
)
INVALID_HEADER, NO_REFERENCE_TIME, ACTION_LATE = 0x800E, 0x8013, 0x8016


class Application:
    """One control channel; every command is asked once and answered within a second."""

    def __init__(self, address: str, *, from_address: str = "127.0.0.1") -> None:
        self.address = address
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((from_address, 0))
        self.socket.settimeout(1.0)
        self._ids = itertools.count(1)

    def ask(self, command: int, body: bytes = b"", *, flags: int = 1) -> tuple[int, bytes]:
        """Status and what follows; pending acknowledgements are waited over. Raises `TimeoutError`."""
        request_id = next(self._ids)
        self.tell(command, body, flags=flags, request_id=request_id)
        while True:
            answer = self.socket.recv(2048)
            status, acknowledged, size, answered_id = struct.unpack_from(">HHHH", answer)
            if acknowledged == 0x89:
                continue
            assert (acknowledged, size, answered_id) == (command + 1, len(answer) - 8, request_id)
            return status, answer[8:]

    def tell(self, command: int, body: bytes = b"", *, flags: int = 0, request_id: int = 1) -> None:
        head = struct.pack(">BBHHH", 0x42, flags, command, len(body), request_id)
        self.socket.sendto(head + body, (self.address, GVCP_PORT))

    def read(self, address: int) -> int:
        status, body = self.ask(READREG, struct.pack(">I", address))
        assert status == 0, f"{status:#x}"
        return int.from_bytes(body, "big")

    def write(self, address: int, value: int) -> int:
        """Write a register; the status."""
        return self.ask(WRITEREG, struct.pack(">II", address, value))[0]

    def write_memory(self, address: int, data: bytes) -> int:
        return self.ask(WRITEMEM, struct.pack(">I", address) + data)[0]

    def read_memory(self, address: int, size: int) -> bytes:
        data = b""
        while len(data) < size:
            n_bytes = min(512, -(-(size - len(data)) // 4) * 4)
            status, body = self.ask(READMEM, struct.pack(">IHH", address + len(data), 0, n_bytes))
            assert status == 0, f"{status:#x}"
            data += body[4:]
        return data[:size]

    def take_control(self) -> None:
        assert self.write(CCP, 2) == 0

    def close(self) -> None:
        self.socket.close()


@contextmanager
def application(address: str) -> Iterator[Application]:
    opened = Application(address)
    try:
        yield opened
    finally:
        opened.close()


@dataclass
class ReceivedFrame:
    """Packets of one block as they came in."""

    block_id: int
    packets: dict[int, bytes] = field(default_factory=dict)  # by packet id, without header
    order: list[tuple[int, int]] = field(default_factory=list)  # (packet id, status)
    first_s: float = 0.0
    last_s: float = 0.0
    has_extended_ids: bool = False

    @property
    def trailer_id(self) -> int:
        return max(self.packets)

    @property
    def payload(self) -> bytes:
        return b"".join(self.packets[index] for index in range(1, self.trailer_id))

    @property
    def device_ns(self) -> int:
        return int(struct.unpack_from(">Q", self.packets[0], 4)[0])

    @property
    def size_px(self) -> tuple[int, int]:
        width, height = struct.unpack_from(">II", self.packets[0], 16)
        return width, height

    @property
    def image(self) -> NDArray[np.uint8]:
        width, height = self.size_px
        return np.frombuffer(self.payload, np.uint8)[: width * height].reshape(height, width)


class Receiver:
    """The stream's destination."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.socket.bind(("127.0.0.1", 0))
        self.port = int(self.socket.getsockname()[1])

    def packet(self, timeout_s: float = 1.0) -> bytes | None:
        self.socket.settimeout(timeout_s)
        try:
            return self.socket.recv(16384)
        except TimeoutError:
            return None

    def frame(self, timeout_s: float = 2.0, quiet_s: float = 0.15) -> ReceivedFrame | None:
        """Collect one block: until it is whole, or nothing more of it came for `quiet_s`."""
        frame: ReceivedFrame | None = None
        while packet := self.packet(timeout_s if frame is None else quiet_s):
            status, block_id, content, packet_id, body = _parsed(packet)
            if frame is None:
                frame = ReceivedFrame(block_id, first_s=time.monotonic(), has_extended_ids=packet[4] >= 0x80)
            assert block_id == frame.block_id, "packets of two frames at once"
            frame.order.append((packet_id, status))
            frame.last_s = time.monotonic()
            if status == 0:
                frame.packets[packet_id] = body
            is_whole = len(frame.packets) == max(frame.packets, default=0) + 1
            if content == TRAILER and is_whole:
                break
        return frame

    def close(self) -> None:
        self.socket.close()


def _parsed(packet: bytes) -> tuple[int, int, int, int, bytes]:
    status, block_id, word = struct.unpack_from(">HHI", packet)
    content = word >> 24
    if content & 0x80:
        block_id, packet_id = struct.unpack_from(">QI", packet, 8)
        return status, block_id, content & 0x7F, packet_id, packet[20:]
    return status, block_id, content, word & 0xFFFFFF, packet[8:]
