"""The host as the checks read it: a tree of files, and the few facts that only its kernel has.

Everything in /proc, /sys, /etc and /run is read below `root`, so that another tree can be looked at: a test's, or
one that was copied from a rig. What only the kernel answers is then not known.
"""

import array
import ctypes
import fcntl
import shutil
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv4Network
from pathlib import Path

ROOT = Path("/")
SIOCETHTOOL, ETHTOOL_GRINGPARAM = 0x8946, 0x10
RING = struct.Struct("9I")
"""`struct ethtool_ringparam`: command, largest rx, mini, jumbo, tx, and the same as they are."""
TIME_ERROR = 5
"""Return value of adjtimex(2) while the clock is not synchronised."""
TIMEX_BYTES = 512
"""More than any `struct timex` has."""


@dataclass(frozen=True, slots=True)
class Ring:
    """Descriptors of a network port's receive ring."""

    now: int
    most: int


@dataclass(frozen=True, slots=True)
class Mount:
    """A file system as /proc/mounts has it."""

    place: Path
    kind: str
    options: tuple[str, ...]


def ring_of(interface: str) -> Ring | None:
    """Return the receive ring of a network port, None if it has none or does not say."""
    answer = array.array("B", RING.pack(ETHTOOL_GRINGPARAM, *8 * (0,)))
    request = struct.pack("16sP16x", interface.encode(), answer.buffer_info()[0])
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, SIOCETHTOOL, request)
        _, most, _, _, _, now, *_ = RING.unpack(answer)
        return Ring(now, most) if most else None
    return None


def is_clock_synchronised() -> bool | None:
    """True when the kernel's clock is synchronised, None if it cannot be asked; changes nothing (`modes` are 0)."""
    with suppress(OSError, AttributeError):
        state = int(ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(TIMEX_BYTES)))
        return None if state < 0 else state != TIME_ERROR
    return None


@dataclass(frozen=True, slots=True)
class Host:
    """A host that is looked at."""

    root: Path = ROOT
    ring: Callable[[str], Ring | None] = ring_of
    is_synchronised: Callable[[], bool | None] = is_clock_synchronised

    def path(self, path: str | Path) -> Path:
        """Return where a path of the host lies."""
        return self.root / str(path).lstrip("/")

    def text(self, path: str | Path) -> str | None:
        """Return the content of a file, stripped; None if it cannot be read."""
        try:
            return self.path(path).read_text(encoding="utf-8", errors="replace").strip()
        except OSError:
            return None

    def number(self, path: str | Path) -> int | None:
        """Return the number in a file, None if there is none."""
        try:
            return int(self.text(path) or "")
        except ValueError:
            return None

    def glob(self, pattern: str) -> list[Path]:
        """Return the paths of the host that match, sorted; as the host names them."""
        found = self.root.glob(pattern.removeprefix("/"))
        return sorted(Path("/") / path.relative_to(self.root) for path in found)

    def free_bytes(self, path: Path) -> int | None:
        """Return the free space of the file system that a folder is on, or will be on; None if it cannot be asked."""
        for folder in (path, *path.parents):
            try:
                return shutil.disk_usage(self.path(folder)).free
            except FileNotFoundError:  # will be made on the file system of its parent
                continue
            except OSError:
                break
        return None

    def mount(self, path: Path) -> Mount | None:
        """Return the file system that a folder is on, None if the mounts cannot be read."""
        best = None
        for line in (self.text("/proc/mounts") or "").splitlines():
            _, place, kind, options, *_ = line.split()
            mount = Mount(Path(place.replace("\\040", " ")), kind, tuple(options.split(",")))
            # of equal ones the last is on top
            if path.is_relative_to(mount.place) and (best is None or mount.place.is_relative_to(best.place)):
                best = mount
        return best

    def interfaces_to(self, address: str) -> list[str]:
        """Return the network ports that lead to the network of an address; several with link-local addresses."""
        if IPv4Address(address).is_loopback:  # the kernel keeps these routes in another table
            return ["lo"]
        ways = [(net.prefixlen, port) for port, net in self._routes() if IPv4Address(address) in net]
        longest = max((length for length, _ in ways), default=0)  # the way out into the world is none
        return sorted({port for length, port in ways if length == longest > 0})

    def _routes(self) -> Iterator[tuple[str, IPv4Network]]:
        for line in (self.text("/proc/net/route") or "").splitlines()[1:]:
            port, to, _, _, _, _, _, mask, *_ = line.split()
            to_address, netmask = (IPv4Address(bytes.fromhex(each)[::-1]) for each in (to, mask))
            yield port, IPv4Network(f"{to_address}/{netmask}", strict=False)


def host_at(root: Path) -> Host:
    """Return this machine, or another tree, of which the kernel here knows nothing."""
    if root.resolve() == ROOT:
        return Host()
    return Host(root=root, ring=lambda _: None, is_synchronised=lambda: None)
