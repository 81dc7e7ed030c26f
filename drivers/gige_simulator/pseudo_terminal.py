"""A serial port with nothing but software behind it, under a name that survives pulling the plug."""

import os
import select
import tty
from pathlib import Path

from drivers.errors import GateUnavailableError


class PseudoTerminal:
    """The device's end of a serial line; the host opens the symbolic link.

    There is no modem line (CTS, DSR, RI, CD) on a pseudo-terminal, and no baud rate. Not thread-safe.
    """

    def __init__(self, link: Path) -> None:
        self.link = link
        self._fd = -1

    @property
    def is_plugged(self) -> bool:
        return self._fd >= 0

    @property
    def is_opened(self) -> bool:
        """Whether a host has the port open."""
        if self._fd < 0:
            return False
        poll = select.poll()
        poll.register(self._fd, 0)
        return not poll.poll(0)  # POLLHUP while the other end is closed

    def fileno(self) -> int:
        """Readable when the host sent something, and as long as no host has the port open."""
        return self._fd

    def plug(self) -> None:
        """Appear under the link's name, if not there already.

        Raises
        ------
        GateUnavailableError
            The name is taken by something that is no symbolic link, or its folder cannot be written.
        """
        if self._fd >= 0:
            return
        if self.link.exists() and not self.link.is_symlink():
            raise GateUnavailableError(
                str(self.link), "exists and is no link of a simulated gate: name another"
            )
        self._fd, host_fd = os.openpty()
        tty.setraw(host_fd)  # else what the gate says before the host sets its mode comes back as an echo
        port = os.ttyname(host_fd)
        os.close(host_fd)
        os.set_blocking(self._fd, False)
        beside = self.link.with_name(f".{self.link.name}.new")
        try:
            beside.unlink(missing_ok=True)
            beside.symlink_to(port)
            beside.replace(self.link)  # at once: a host that looks finds the old port or the new one
        except OSError as err:
            self.unplug()
            raise GateUnavailableError(str(self.link), f"cannot be made: {err.strerror}") from err

    def unplug(self) -> None:
        """Disappear; a host that has the port open reads an error from now on."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
            self.link.unlink(missing_ok=True)

    def read(self) -> bytes:
        """What the host sent, maybe nothing."""
        if self._fd < 0:
            return b""
        try:
            return os.read(self._fd, 4096)
        except OSError:  # nothing there (EAGAIN), or nobody (EIO)
            return b""

    def write(self, data: bytes) -> bool:
        """Whether the data left: not without a host, nor when it does not read."""
        if self._fd < 0 or not self.is_opened:
            return False
        try:
            return os.write(self._fd, data) == len(data)
        except BlockingIOError:
            return False
