"""Ports of light gates: kept from other programs and from resets of the board, and why one cannot be opened."""

import errno
import fcntl
import grp
import os
import termios
from contextlib import suppress
from pathlib import Path

from drivers.errors import DeviceFault, Told, told

PTY_MAJORS = range(136, 144)
"""Device numbers of pseudo-terminals, which keep the mark of `TIOCEXCL` when they are closed."""


def keep_port(fd: int) -> None:
    """Let no other program open a port, and let closing it leave DTR and RTS up, whose fall resets many boards.

    Two readers of one port would each get a part of the lines; a lock alone holds off only those who ask for it.
    """
    with suppress(OSError, termios.error):  # a port that cannot do it is used as it is
        mode = termios.tcgetattr(fd)
        mode[2] &= ~termios.HUPCL
        termios.tcsetattr(fd, termios.TCSANOW, mode)
        if os.major(os.fstat(fd).st_rdev) not in PTY_MAJORS:
            fcntl.ioctl(fd, termios.TIOCEXCL)


def group_of(port: str) -> str:
    """Return the name of the group that a port belongs to, which is not dialout on every system."""
    try:
        group = Path(port).stat().st_gid
        return grp.getgrgid(group).gr_name
    except OSError:
        return "dialout"
    except KeyError:
        return str(group)


def port_problem(error: Exception, port: str) -> Told:
    """Return the reason why a serial port cannot be opened, with the remedy where there is one."""
    match error:
        case OSError(errno=errno.ENOENT):
            return told(DeviceFault.GATE_PORT_MISSING)
        case OSError(errno=errno.EACCES):
            return told(DeviceFault.GATE_PORT_DENIED, group=group_of(port))
        case OSError(errno=errno.EAGAIN | errno.EBUSY):
            return told(DeviceFault.GATE_PORT_TAKEN)
    return told(DeviceFault.GATE_PORT_UNUSABLE, reported=str(error))
