"""GigE Vision's control protocol (GVCP) as far as the rig speaks it by itself: who is there, and expose now.

Aravis does the rest. It cannot do these two: its discovery takes a second, opening an address where
nobody answers blocks all cameras for 2.5 s, and it has no action command. Layouts as in Aravis'
`arvgvcpprivate.h` and Wireshark's `packet-gvcp.c`, big-endian.
"""

import array
import fcntl
import selectors
import socket
import struct
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from ipaddress import IPv4Address

GVCP_PORT = 3956
KEY = 0x42
"""First byte of every command."""
ACK_REQUIRED = 0x01
"""Flag: the device is to answer."""
SCHEDULED = 0x80
"""Flag of an action command: it carries the time at which to act."""
DISCOVERY, DISCOVERY_ACK = 0x02, 0x03
READ_MEMORY, READ_MEMORY_ACK = 0x84, 0x85
ACTION, ACTION_ACK = 0x100, 0x101
HEADER = struct.Struct(">BBHHH")
"""Of a command: key, flags, command, bytes that follow, request id."""
ACK_HEADER = struct.Struct(">HHHH")
"""Of an answer: status, command, bytes that follow, request id."""
DISCOVERY_BYTES = 0xF8
"""What a discovery answer holds: the first registers of the device."""

_MAC = slice(0x0A, 0x10)
_VENDOR, _MODEL, _VERSION = slice(0x48, 0x68), slice(0x68, 0x88), slice(0x88, 0xA8)
_SERIAL, _USER_NAME = slice(0xD8, 0xE8), slice(0xE8, 0xF8)

_SIOCGIFCONF = 0x8912
_IFCONF = struct.Struct("iP")  # bytes, pointer
_IFREQ = struct.Struct("20x4s16x")  # name, family and port; IPv4 address; rest of the union


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """What a camera tells anybody who asks."""

    address: str
    serial: str
    user_name: str
    vendor: str
    model: str
    version: str
    mac: str  # lower case, with colons


def probe(address: str, timeout_s: float = 0.1) -> Device | None:
    """Ask one IPv4 address; nothing when no camera answers in time.

    The question is put twice: one lost datagram does not make a camera dead.
    """
    peer = (str(IPv4Address(address)), GVCP_PORT)
    # refused: a machine without a camera; unreachable: not even that
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        control.connect(peer)
        for request_id in (1, 2):
            control.send(_discovery(request_id))
            if device := next(_answers([control], timeout_s / 2), None):
                return device
    return None


def discover(interfaces: Sequence[str] | None = None, timeout_s: float = 0.5) -> list[Device]:
    """Ask everybody by broadcast, out of all of this machine's IPv4 addresses or of those given; sorted by address.

    Raises `OSError` when nobody can be asked out of an address that was given.
    """
    with ExitStack() as stack:
        sockets = []
        for address in interfaces or local_addresses():
            asking = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            asking.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            try:
                asking.bind((address, 0))  # which also makes the broadcast leave there
                asking.sendto(_discovery(1), ("255.255.255.255", GVCP_PORT))
            except OSError as err:
                if not interfaces:
                    continue
                raise OSError(
                    f"no camera can be looked for out of {address}: {err.strerror}; "
                    f"this machine has {', '.join(local_addresses())}",
                ) from err
            sockets.append(asking)
        found = set(_answers(sockets, timeout_s))
    return sorted(found, key=lambda device: (IPv4Address(device.address), device.mac))


def local_addresses() -> list[str]:
    """IPv4 addresses of this machine's interfaces, loopback included."""
    room = array.array("B", bytes(_IFREQ.size * 256))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = _IFCONF.pack(len(room), room.buffer_info()[0])
        used, _ = _IFCONF.unpack(fcntl.ioctl(any_socket, _SIOCGIFCONF, request))
    return [socket.inet_ntoa(packed) for (packed,) in _IFREQ.iter_unpack(room[:used])]


def action_command(
    *, device_key: int, group_key: int, group_mask: int, request_id: int, at_ns: int | None = None
) -> bytes:
    """Datagram upon which every camera that holds both keys and a bit of the mask acts at once, unanswered.

    `at_ns` is the time to act on the cameras' common clock (PTP). `request_id` is not 0, and not the last one's.
    """
    if not 0 < request_id <= 0xFFFF:
        raise ValueError(f"request_id must be 1 to 65535, not {request_id}")
    body = struct.pack(">III", device_key, group_key, group_mask)
    if at_ns is not None:
        body += struct.pack(">Q", at_ns)
    flags = 0 if at_ns is None else SCHEDULED
    return HEADER.pack(KEY, flags, ACTION, len(body), request_id) + body


def _discovery(request_id: int) -> bytes:
    return HEADER.pack(KEY, ACK_REQUIRED, DISCOVERY, 0, request_id)


def _answers(sockets: Sequence[socket.socket], timeout_s: float) -> Iterator[Device]:
    """Cameras that answer on these sockets until the time is over; what is no answer is passed over."""
    deadline_s = time.monotonic() + timeout_s
    with selectors.PollSelector() as selector:  # select() knows no descriptor above 1023
        for each in sockets:
            selector.register(each, selectors.EVENT_READ, each)
        left_s = timeout_s
        while left_s > 0:
            left_s = deadline_s - time.monotonic()  # when it is over: what came while this thread had no core
            for key, _ in selector.select(max(left_s, 0)):
                with suppress(BlockingIOError):  # what came was damaged, and is gone
                    datagram, (address, _) = key.data.recvfrom(2048, socket.MSG_DONTWAIT)
                    if device := _device(datagram, address):
                        yield device


def _device(datagram: bytes, address: str) -> Device | None:
    body = datagram[ACK_HEADER.size :]
    if len(body) < DISCOVERY_BYTES or ACK_HEADER.unpack_from(datagram)[:2] != (0, DISCOVERY_ACK):
        return None

    def text(field: slice) -> str:
        return body[field].split(b"\0")[0].decode("latin-1").strip()

    return Device(
        address=address,  # where it answers from, which is where it can be spoken to
        serial=text(_SERIAL),
        user_name=text(_USER_NAME),
        vendor=text(_VENDOR),
        model=text(_MODEL),
        version=text(_VERSION),
        mac=body[_MAC].hex(":"),
    )
