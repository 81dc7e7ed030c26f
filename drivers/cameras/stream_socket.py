"""Enlarge the receive buffer of a stream's socket, which Aravis hides, before the camera sends.

Aravis applies its own `socket-buffer-size` only after the first packet, which loses one to three of the first
frames; the default buffer loses two frames in three (measured).
"""

import os
import socket
import stat
from contextlib import suppress
from pathlib import Path

_SO_RCVBUFFORCE = 33
"""Socket option like SO_RCVBUF, but beyond net.core.rmem_max; needs CAP_NET_ADMIN."""


def widen_receive_buffer(local: tuple[str, int], wanted_bytes: int) -> int:
    """Enlarge the buffer of this process's UDP socket at a local address and port; returns the bytes granted.

    Raises
    ------
    LookupError
        There is no such socket.
    """
    with _own_socket(local) as stream:
        try:
            stream.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, wanted_bytes)
        except PermissionError:
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted_bytes)
        # the kernel reports twice what it grants: half is for its own book-keeping
        return stream.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def _own_socket(local: tuple[str, int]) -> socket.socket:
    """Return a duplicate of the socket; closing it leaves the stream's own open."""
    for entry in Path("/proc/self/fd").iterdir():
        with suppress(OSError):  # closed meanwhile by another thread, or no socket
            fd = int(entry.name)
            if not stat.S_ISSOCK(os.fstat(fd).st_mode):
                continue
            found = socket.socket(fileno=os.dup(fd))
            if (found.family, found.type) == (
                socket.AF_INET,
                socket.SOCK_DGRAM,
            ) and found.getsockname() == local:
                return found
            found.close()
    raise LookupError(f"no UDP socket of this process is bound to {local[0]}:{local[1]}")
