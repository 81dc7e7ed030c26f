"""A serial port in software, under a name that survives pulling the plug."""

import os
import select
import tty
from pathlib import Path

from drivers.errors import GateUnavailableError


class PseudoTerminal:
    """The device's end of a serial line; the host opens the symbolic link `link`. Not thread-safe.

    A pseudo-terminal has no modem lines (CTS, DSR, RI, CD) and no baud rate.
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
        """Return the descriptor; it is readable when the host sent something, and while no host has the port open."""
        return self._fd

    def plug(self) -> None:
        """Make the port and its symbolic link, unless plugged in already.

        Raises
        ------
        GateUnavailableError
            The path of the link is taken by something else, or its folder cannot be written.
        """
        if self._fd >= 0:
            return
        if self.link.exists() and not self.link.is_symlink():
            raise GateUnavailableError(
                str(self.link), "exists and is no symbolic link of a simulated gate: choose another path"
            )
        self._fd, host_fd = os.openpty()
        tty.setraw(host_fd)  # else the terminal echoes what the gate sends before the host sets its mode
        port = os.ttyname(host_fd)
        os.close(host_fd)
        os.set_blocking(self._fd, False)
        temporary = self.link.with_name(f".{self.link.name}.new")
        try:
            temporary.unlink(missing_ok=True)
            temporary.symlink_to(port)
            temporary.replace(self.link)  # atomic: a host finds the old port or the new one
        except OSError as err:
            self.unplug()
            raise GateUnavailableError(str(self.link), f"cannot be made: {err.strerror}") from err

    def unplug(self) -> None:
        """Remove port and link; a host that has the port open reads an error from now on."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
            self.link.unlink(missing_ok=True)

    def read(self) -> bytes:
        """Return the bytes that the host sent, empty if none."""
        if self._fd < 0:
            return b""
        try:
            return os.read(self._fd, 4096)
        except OSError:  # no data (EAGAIN) or no host (EIO)
            return b""

    def write(self, data: bytes) -> bool:
        """Send data; returns whether it left, which it does not without a host or when the host does not read."""
        if self._fd < 0 or not self.is_opened:
            return False
        try:
            return os.write(self._fd, data) == len(data)
        except BlockingIOError:
            return False
