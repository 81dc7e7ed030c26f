"""The socket of a stream, which Aravis hides: its receive buffer is enlarged, and guarded, before the camera sends.

Aravis applies its own `socket-buffer-size` only after the first packet, which loses one to three of the first
frames; the default buffer loses two frames in three (measured).
"""

import os
import socket
import stat
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from drivers.cameras.stream_filter import Instruction, attach_filter

_SO_RCVBUFFORCE = 33
"""Socket option like SO_RCVBUF, but beyond net.core.rmem_max; needs CAP_NET_ADMIN."""


def prepare_socket(local: tuple[str, int], wanted_bytes: int, program: Sequence[Instruction]) -> int:
    """Give this process's UDP socket at a local address and port a packet filter and a larger buffer.

    Returns the bytes granted for the buffer.

    Raises
    ------
    LookupError
        There is no such socket.
    OSError
        The kernel refuses the filter.
    """
    with _own_socket(local) as stream:
        attach_filter(stream, program)
        try:
            stream.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, wanted_bytes)
        except PermissionError:
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted_bytes)
        # the kernel reports twice what it grants: half is for its own book-keeping
        return stream.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def udp_sockets() -> list[tuple[str, int]]:
    """Return the local IPv4 addresses and ports of this process's UDP sockets."""
    found = []
    for own in _own_sockets():
        with own:
            found.append(own.getsockname())
    return found


def _own_socket(local: tuple[str, int]) -> socket.socket:
    """Return a duplicate of the socket; closing it leaves the stream's own open."""
    for own in _own_sockets():
        if own.getsockname() == local:
            return own
        own.close()
    raise LookupError(f"no UDP socket of this process is bound to {local[0]}:{local[1]}")


def _own_sockets() -> Iterator[socket.socket]:
    """Yield duplicates of this process's UDP sockets, which the caller closes."""
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile by another thread, or no socket
            fd = int(entry.name)
            if not stat.S_ISSOCK(os.fstat(fd).st_mode):
                continue
            found = socket.socket(fileno=os.dup(fd))
            if (found.family, found.type) == (socket.AF_INET, socket.SOCK_DGRAM):
                yield found
            else:
                found.close()
