"""The description of its features that every camera carries, read without Aravis and without control.

Aravis has it too, but hands Python a text without its end, and takes control of a camera nobody uses.
"""

import io
import re
import socket
import struct
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from ipaddress import IPv4Address

from drivers.errors import CameraUnavailableError
from drivers.gvcp import ACK_HEADER, ACK_REQUIRED, GVCP_PORT, HEADER, KEY, READ_MEMORY, READ_MEMORY_ACK

ANSWER_S = 0.2
N_QUESTIONS = 5
"""How often the same is asked before the camera counts as gone."""

_MAX_BYTES = 536
"""Most that fits into an answer of 576 bytes."""
_URLS = (0x200, 0x400)
_URL_BYTES = 512
_LOCAL = re.compile(r"local:(?:///)?([^;?]+);([0-9a-f]+);([0-9a-f]+)", re.IGNORECASE)
"""Name of the file, where it begins and how many bytes it has, in hexadecimal."""


def genicam_xml(address: str) -> str:
    """Return the GenICam XML of the camera at this IPv4 address, whoever uses it.

    Raises `CameraUnavailableError` when nobody answers there, or what answers carries none.
    """
    camera = f"camera at {address}"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        control.settimeout(ANSWER_S)
        try:
            control.connect((str(IPv4Address(address)), GVCP_PORT))
            urls = [_text(_memory(control, start, _URL_BYTES)) for start in _URLS]
            for url in urls:
                if match := _LOCAL.match(url):
                    name, start, n_bytes = match[1], int(match[2], 16), int(match[3], 16)
                    return _unpacked(name, _memory(control, start, n_bytes))
        except (OSError, zipfile.BadZipFile, UnicodeDecodeError) as err:
            problem = f"does not give its GenICam XML: {err or 'no answer'}"
            raise CameraUnavailableError(camera, problem) from err
    raise CameraUnavailableError(
        camera, f"carries no GenICam XML, but points to {' and '.join(filter(None, urls))}"
    )


def _unpacked(name: str, content: bytes) -> str:
    if name.lower().endswith(".zip"):
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            content = archive.read(archive.namelist()[0])
    return content.decode().rstrip("\0")


def _memory(control: socket.socket, start: int, n_bytes: int) -> bytes:
    data = b"".join(_pieces(control, start, n_bytes))
    return data[:n_bytes]


def _pieces(control: socket.socket, start: int, n_bytes: int) -> Iterator[bytes]:
    for request_id, offset in enumerate(range(0, n_bytes, _MAX_BYTES), start=1):
        words = -(-min(_MAX_BYTES, n_bytes - offset) // 4)
        body = struct.pack(">IxxH", start + offset, 4 * words)
        yield _answer(control, HEADER.pack(KEY, ACK_REQUIRED, READ_MEMORY, len(body), request_id) + body)


def _answer(control: socket.socket, question: bytes) -> bytes:
    """Data at the address asked for; raises `OSError` when it never comes or is refused."""
    wanted = (READ_MEMORY_ACK, HEADER.unpack_from(question)[4])
    for _ in range(N_QUESTIONS):
        control.send(question)
        with suppress(TimeoutError):
            while True:
                datagram = control.recv(2048)
                status, command, _, request_id = ACK_HEADER.unpack_from(datagram)
                if (command, request_id) != wanted:
                    continue  # an answer of before, or a request for patience
                if status:
                    raise OSError(f"it refuses to be read (status 0x{status:04x})")
                return datagram[ACK_HEADER.size + 4 :]
    raise TimeoutError


def _text(field: bytes) -> str:
    return field.split(b"\0")[0].decode("latin-1").strip()
