"""Checks of the way from the cameras to this machine: buffers, packets, links, receive rings, interrupts."""

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from service.host.finding import Finding, fault, installed, judged, unknown
from service.host.host import Host

BACKLOG = 10_000
"""Packets that a port of 10 Gb/s may hand over at one interrupt."""
JUMBO = 9000
"""Largest packets that network cards commonly allow, with which the files of deploy/host set the ports up."""
RING = 4096
"""Wanted receive ring, as far as the port has one: two milliseconds of a full link of 10 Gb/s in packets of 8 KB."""
NETWORKS = "/etc/systemd/network"
SYSCTL = installed("90-stonefall.conf", "/etc/sysctl.d", "sysctl --system")
LINK = installed(
    "50-stonefall-cameras.link", NETWORKS, "editor /etc/systemd/network/50-stonefall-cameras.link"
)
PORTS = installed(
    "50-stonefall-cameras.network", NETWORKS, "editor /etc/systemd/network/50-stonefall-cameras.network"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraNetwork:
    """The network of the cameras."""

    addresses: tuple[str, ...]  # of this machine towards them, or else theirs
    receive_buffer_bytes: int
    packet_bytes: int
    uplink_bytes_s: float


def check_network(host: Host, network: CameraNetwork) -> Iterator[Finding]:
    """Check the network towards the cameras: the kernel's receive buffers, ports and links."""
    for name, at_least in (
        ("rmem_max", network.receive_buffer_bytes),
        ("rmem_default", network.receive_buffer_bytes),
        ("netdev_max_backlog", BACKLOG),
    ):
        yield _sysctl(host, f"net.core.{name}", at_least)
    if not network.addresses:
        wanted = "rig.interfaces: this machine's addresses towards the cameras"
        yield unknown("camera ports", "the configuration names none", wanted)
        return
    ports: list[str] = []
    for address in network.addresses:
        found = host.interfaces_to(address)
        if not found:
            yield fault(
                f"port of {address}",
                found="no network port leads there",
                wanted="a port with an address in its network",
                remedy=f"plug its cable in, set its address: {PORTS}",
            )
        ports += [port for port in found if port not in ports]
    for port in ports:
        yield from _port(host, port, network)
    yield from _speed(host, ports, network)


def _sysctl(host: Host, name: str, wanted: int) -> Finding:
    path = "/proc/sys/" + name.replace(".", "/")
    if (found := host.number(path)) is None:
        return unknown(name, f"{path} cannot be read", f"at least {wanted}")
    return judged(name, is_good=found >= wanted, found=f"{found}", wanted=f"at least {wanted}", remedy=SYSCTL)


def _port(host: Host, port: str, network: CameraNetwork) -> Iterator[Finding]:
    """Check link, MTU, receive ring and interrupts of one port of the cameras."""
    folder = f"/sys/class/net/{port}"
    if host.text(f"{folder}/operstate") == "down":
        yield fault(
            f"link of {port}",
            found="down",
            wanted="up",
            remedy=f"switch the cameras' switch on, check the cable, then: ip link set {port} up",
        )
    wanted = network.packet_bytes
    if (mtu := host.number(f"{folder}/mtu")) is None:
        yield unknown(f"MTU of {port}", f"{folder}/mtu cannot be read", f"at least {wanted}")
    else:
        yield judged(
            f"MTU of {port}",
            is_good=mtu >= wanted,
            found=f"{mtu}",
            wanted=f"at least {wanted}, for packets of rig.packet_size_bytes",
            remedy=f"{PORTS}; until the next start: ip link set {port} mtu {JUMBO}",
        )
    if (ring := host.ring(port)) is not None:
        wanted = min(RING, ring.most)
        yield judged(
            f"receive ring of {port}",
            is_good=ring.now >= wanted,
            found=f"{ring.now} of {ring.most}",
            wanted=f"at least {wanted}",
            remedy=f"{LINK}; until the next start: ethtool -G {port} rx {wanted}",
        )
    yield from _interrupts(host, port)


def _interrupts(host: Host, port: str) -> Iterator[Finding]:
    """Check that a port of several queues spreads its interrupts over the cores."""
    numbers = [path.name for path in host.glob(f"/sys/class/net/{port}/device/msi_irqs/*")]
    cores = {
        number: core for number in numbers if (core := host.text(f"/proc/irq/{number}/smp_affinity_list"))
    }
    if len(cores) < 2 or host.text("/sys/devices/system/cpu/online") in (None, "0"):
        return
    allowed = sorted(set(cores.values()))
    yield judged(
        f"interrupts of {port}",
        is_good=len(allowed) > 1 or not allowed[0].isdigit(),
        found=f"{len(cores)} on core {', '.join(allowed)}",
        wanted="spread over the cores",
        remedy="apt-get install irqbalance && systemctl enable --now irqbalance",
    )


def _speed(host: Host, ports: list[str], network: CameraNetwork) -> Iterator[Finding]:
    """Check that the links together are as fast as the configuration says; virtual ones state no speed."""
    if (found_bytes_s := links_bytes_s(host, ports)) is None:
        return
    found_mb_s, wanted_mb_s = found_bytes_s / 1e6, network.uplink_bytes_s / 1e6
    yield judged(
        "speed of the links",
        is_good=found_mb_s >= wanted_mb_s,
        found=f"{found_mb_s:g} MB/s over {', '.join(ports)}",
        wanted=f"rig.uplink_bytes_s: {wanted_mb_s:g} MB/s",
        remedy="check cable and switch port; if the links are meant to be slower, say so in rig.uplink_bytes_s",
    )


def links_bytes_s(host: Host, ports: Collection[str]) -> float | None:
    """Return the speed of these links together; None without any, or where one does not say it, as virtual ones."""
    known = [host.number(f"/sys/class/net/{port}/speed") for port in ports]
    speeds_mbit_s = [speed for speed in known if speed is not None and speed > 0]
    return sum(speeds_mbit_s) * 125e3 if 0 < len(ports) == len(speeds_mbit_s) else None
