"""The part of GigE Vision's control protocol (GVCP) that Aravis cannot do: quick discovery and action commands.

Discovery by Aravis takes a second, opening an address where no camera answers blocks all cameras for 2.5 s, and
there is no action command. Layouts as in Aravis' `arvgvcpprivate.h` and Wireshark's `packet-gvcp.c`, big-endian.
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
"""Flag of a command: the device shall acknowledge it."""
SCHEDULED = 0x80
"""Flag of an action command: it carries the time at which to act."""
DISCOVERY, DISCOVERY_ACK = 0x02, 0x03
WRITE_REGISTER = 0x82
READ_MEMORY, READ_MEMORY_ACK = 0x84, 0x85
ACTION, ACTION_ACK = 0x100, 0x101
HEADER = struct.Struct(">BBHHH")
"""Header of a command: key, flags, command, bytes that follow, request id."""
ACK_HEADER = struct.Struct(">HHHH")
"""Header of an acknowledgement: status, command, bytes that follow, request id."""
CONTROL_PRIVILEGE = 0xA00
"""Bootstrap register of every camera: its control privilege, 0 when no application has it."""
DISCOVERY_BYTES = 0xF8
"""Size of a discovery acknowledgement's body: a copy of the device's first registers."""
PROBE_S = 0.5
"""How long a camera may take to answer a probe: one does in 1 ms, but this machine may be busy when it arrives."""

_MAC = slice(0x0A, 0x10)
_VENDOR, _MODEL, _VERSION = slice(0x48, 0x68), slice(0x68, 0x88), slice(0x88, 0xA8)
_SERIAL, _USER_NAME = slice(0xD8, 0xE8), slice(0xE8, 0xF8)

_SIOCGIFCONF = 0x8912
_IFCONF = struct.Struct("iP")  # bytes, pointer
_IFREQ = struct.Struct("20x4s16x")  # name, family and port; IPv4 address; rest of the union


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoveredCamera:
    """A camera's answer to discovery, which it gives to any application, controlled or not."""

    address: str
    serial: str
    user_name: str
    vendor: str
    model: str
    version: str
    mac: str  # lower case, with colons


def probe(address: str, timeout_s: float = PROBE_S) -> DiscoveredCamera | None:
    """Return the camera at one IPv4 address, None when none answers in time.

    It is asked twice within `timeout_s`: one lost datagram does not make a camera dead.
    """
    peer = (str(IPv4Address(address)), GVCP_PORT)
    # OSError: the address refuses (a machine without a camera) or is unreachable
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        control.connect(peer)
        for request_id in (1, 2):
            control.send(_discovery_command(request_id))
            if device := next(_acknowledgements([control], timeout_s / 2), None):
                return device
    return None


def discover(interfaces: Sequence[str] | None = None, timeout_s: float = 0.5) -> list[DiscoveredCamera]:
    """Return the cameras that answer a broadcast within `timeout_s`, sorted by address.

    The broadcast leaves by all IPv4 addresses of this machine, or by `interfaces`.

    Raises
    ------
    OSError
        It cannot leave by an address in `interfaces`.
    """
    with ExitStack() as stack:
        sockets = []
        for address in interfaces or local_addresses():
            asking = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            asking.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            try:
                asking.bind((address, 0))  # also chooses the interface by which the broadcast leaves
                asking.sendto(_discovery_command(1), ("255.255.255.255", GVCP_PORT))
            except OSError as err:
                if not interfaces:
                    continue
                raise OSError(
                    f"no camera can be looked for out of {address}: {err.strerror}; "
                    f"this machine has {', '.join(local_addresses())}",
                ) from err
            sockets.append(asking)
        found = set(_acknowledgements(sockets, timeout_s))
    return sorted(found, key=lambda device: (IPv4Address(device.address), device.mac))


def local_addresses() -> list[str]:
    """Return the IPv4 addresses of this machine's interfaces, loopback included."""
    room = array.array("B", bytes(_IFREQ.size * 256))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = _IFCONF.pack(len(room), room.buffer_info()[0])
        used, _ = _IFCONF.unpack(fcntl.ioctl(any_socket, _SIOCGIFCONF, request))
    return [socket.inet_ntoa(packed) for (packed,) in _IFREQ.iter_unpack(room[:used])]


def release_control(cameras: Sequence[str], sockets: Sequence[tuple[str, int]]) -> None:
    """Release a dead process's control of cameras, from its sockets: otherwise they wait for the end of its heartbeat.

    Control belongs to the address and port that took it (GigE Vision 2.0, 10.4), not to the process; other writers
    are refused. Nothing is acknowledged; an address that another socket has taken meanwhile is left out.
    """
    command = HEADER.pack(KEY, 0, WRITE_REGISTER, 8, 0xFFFF) + struct.pack(">II", CONTROL_PRIVILEGE, 0)
    for local in sockets:
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as dead:
            dead.bind(local)
            for camera in cameras:
                dead.sendto(command, (camera, GVCP_PORT))


def action_command(
    *, device_key: int, group_key: int, group_mask: int, request_id: int, at_ns: int | None = None
) -> bytes:
    """Return the datagram that makes all cameras with both keys and a bit of the mask act, without acknowledgement.

    They act at once, or at `at_ns` of their common clock (PTP). `request_id` (1 to 65535) must differ from that of
    the command before.
    """
    if not 0 < request_id <= 0xFFFF:
        raise ValueError(f"request_id must be 1 to 65535, not {request_id}")
    body = struct.pack(">III", device_key, group_key, group_mask)
    if at_ns is not None:
        body += struct.pack(">Q", at_ns)
    flags = 0 if at_ns is None else SCHEDULED
    return HEADER.pack(KEY, flags, ACTION, len(body), request_id) + body


def decoded(text: bytes) -> str:
    """Return a text of a camera: UTF-8, the last character of which the field may have cut, or else Latin-1."""
    try:
        return text.decode()
    except UnicodeDecodeError as err:
        is_cut = err.end == len(text) and err.reason == "unexpected end of data" and err.start > 0
        return text[: err.start].decode() if is_cut else text.decode("latin-1")


def _discovery_command(request_id: int) -> bytes:
    return HEADER.pack(KEY, ACK_REQUIRED, DISCOVERY, 0, request_id)


def _acknowledgements(sockets: Sequence[socket.socket], timeout_s: float) -> Iterator[DiscoveredCamera]:
    """Yield the cameras that answer on these sockets within `timeout_s`; other datagrams are skipped."""
    deadline_s = time.monotonic() + timeout_s
    with selectors.PollSelector() as selector:  # select() fails for descriptors above 1023
        for udp_socket in sockets:
            selector.register(udp_socket, selectors.EVENT_READ, udp_socket)
        left_s = timeout_s
        while left_s > 0:
            # once it is negative, the sockets are read a last time: this thread may have had no core meanwhile
            left_s = deadline_s - time.monotonic()
            for key, _ in selector.select(max(left_s, 0)):
                with suppress(BlockingIOError):  # the kernel dropped the datagram: its checksum was wrong
                    datagram, (address, _) = key.data.recvfrom(2048, socket.MSG_DONTWAIT)
                    if device := _parse_acknowledgement(datagram, address):
                        yield device


def _parse_acknowledgement(datagram: bytes, address: str) -> DiscoveredCamera | None:
    body = datagram[ACK_HEADER.size :]
    if len(body) < DISCOVERY_BYTES or ACK_HEADER.unpack_from(datagram)[:2] != (0, DISCOVERY_ACK):
        return None

    def text(field: slice) -> str:
        return decoded(body[field].split(b"\0")[0]).strip()

    return DiscoveredCamera(
        address=address,  # the sender's, at which it can be reached, whatever its registers say
        serial=text(_SERIAL),
        user_name=text(_USER_NAME),
        vendor=text(_VENDOR),
        model=text(_MODEL),
        version=text(_VERSION),
        mac=body[_MAC].hex(":"),
    )
