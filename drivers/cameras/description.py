"""Read the GenICam XML that every camera carries, without Aravis and without taking control.

Aravis can read it too, but hands Python the text without its end, and takes control of a camera that is not in use.
"""

import io
import re
import socket
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import suppress
from ipaddress import IPv4Address

from drivers.errors import CameraUnavailableError
from drivers.gvcp import ACK_HEADER, ACK_REQUIRED, GVCP_PORT, HEADER, KEY, READ_MEMORY, READ_MEMORY_ACK

ANSWER_S = 0.2
"""Time-out of one request."""
N_ATTEMPTS = 5
"""How often a request is sent before the camera counts as gone."""
MAX_XML_BYTES = 16 << 20
"""Largest description, zipped and unzipped; those of cameras have some megabytes at most."""

_MAX_BYTES = 536
"""Largest number of bytes of memory in an acknowledgement of 576 bytes."""
_URL_REGISTERS = (0x200, 0x400)
_URL_BYTES = 512
_LOCAL = re.compile(r"local:(?:///)?([^;?]+);([0-9a-f]+);([0-9a-f]+)", re.IGNORECASE)
"""URL of a file in the camera's memory: its name, address and number of bytes, both in hexadecimal."""


def genicam_xml(address: str) -> str:
    """Return the GenICam XML of the camera at an IPv4 address, also while another application controls it.

    Raises
    ------
    CameraUnavailableError
        No camera answers there, or it carries no XML.
    """
    camera = f"camera at {address}"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        control.settimeout(ANSWER_S)
        try:
            control.connect((str(IPv4Address(address)), GVCP_PORT))
            urls = [_text(_read_memory(control, start, _URL_BYTES)) for start in _URL_REGISTERS]
            for url in urls:
                if match := _LOCAL.match(url):
                    name, start, n_bytes = match[1], int(match[2], 16), int(match[3], 16)
                    _require_size(n_bytes)
                    return _unzipped(name, _read_memory(control, start, n_bytes))
        except (OSError, ValueError, LookupError, zipfile.BadZipFile, zlib.error, struct.error) as err:
            problem = f"does not give its GenICam XML: {err or 'no answer'}"
            raise CameraUnavailableError(camera, problem) from err
    raise CameraUnavailableError(
        camera, f"carries no GenICam XML, but points to {' and '.join(filter(None, urls))}"
    )


def _unzipped(name: str, content: bytes) -> str:
    if name.lower().endswith(".zip"):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            name = archive.namelist()[0]
            _require_size(archive.getinfo(name).file_size)  # no more is unzipped
            content = archive.read(name)
    return content.decode().rstrip("\0")


def _require_size(n_bytes: int) -> None:
    if n_bytes > MAX_XML_BYTES:
        raise ValueError(f"it would have {n_bytes} bytes, more than {MAX_XML_BYTES}")


def _read_memory(control: socket.socket, start: int, n_bytes: int) -> bytes:
    return b"".join(_read_blocks(control, start, n_bytes))[:n_bytes]


def _read_blocks(control: socket.socket, start: int, n_bytes: int) -> Iterator[bytes]:
    for request_id, offset in enumerate(range(0, n_bytes, _MAX_BYTES), start=1):
        words = -(-min(_MAX_BYTES, n_bytes - offset) // 4)
        body = struct.pack(">IxxH", start + offset, 4 * words)
        yield _request(control, HEADER.pack(KEY, ACK_REQUIRED, READ_MEMORY, len(body), request_id) + body)


def _request(control: socket.socket, command: bytes) -> bytes:
    """Send a command to read memory and return the data; raises `OSError` when it never comes or is refused."""
    wanted = (READ_MEMORY_ACK, HEADER.unpack_from(command)[4])
    for _ in range(N_ATTEMPTS):
        control.send(command)
        with suppress(TimeoutError):
            while True:
                datagram = control.recv(2048)
                status, acknowledged, _, request_id = ACK_HEADER.unpack_from(datagram)
                if (acknowledged, request_id) != wanted:
                    continue  # late, of an earlier command, or a pending acknowledgement
                if status:
                    raise OSError(f"it refuses to be read (status 0x{status:04x})")
                return datagram[ACK_HEADER.size + 4 :]
    raise TimeoutError


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("latin-1").strip()
