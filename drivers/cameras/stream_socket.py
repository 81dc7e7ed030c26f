"""The socket a stream comes in by, which Aravis hides and gives enough room only when it is too late.

Aravis applies its own `socket-buffer-size` when the first packet is in: the default buffer loses two
frames in three, theirs one to three of the first (measured). This sets it before the camera sends.
"""

import os
import socket
import stat
from contextlib import suppress
from pathlib import Path

_SO_RCVBUFFORCE = 33
"""As SO_RCVBUF, beyond net.core.rmem_max, for those with CAP_NET_ADMIN."""


def widen_receive_buffer(local: tuple[str, int], wanted_bytes: int) -> int:
    """Give the UDP socket of this process with that local address and port room; returns what the kernel granted.

    Raises `LookupError` when there is no such socket.
    """
    with _own_socket(local) as stream:
        try:
            stream.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, wanted_bytes)
        except PermissionError:
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted_bytes)
        # the kernel doubles what it grants, for its own book-keeping
        return stream.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2


def _own_socket(local: tuple[str, int]) -> socket.socket:
    """Duplicate of the descriptor; closing it leaves the stream's own open."""
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
