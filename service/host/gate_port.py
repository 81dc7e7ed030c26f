"""Checks of the light gate's port: its name, its group, its latency, and the programs that take ports for their own."""

import os
import re
from collections.abc import Iterator
from pathlib import Path

from service.host.finding import Finding, fault, installed, judged
from service.host.host import Host

KERNEL_NAME = re.compile(r"/dev/tty(USB|ACM)\d+")
"""Names that the kernel gives in the order of plugging in."""
LATENCY_MS = 1
"""Time for which the driver of a USB converter may collect bytes."""
RULES = Path("/etc/udev/rules.d/90-stonefall-gate.rules")
GATE_RULES = installed(RULES.name, str(RULES.parent), "udevadm control --reload && udevadm trigger")


def check_gate(host: Host, port: Path) -> Iterator[Finding]:
    """Check the device of a light gate, and the programs that write to such devices or take them away."""
    is_simulated = host.path(port).resolve().is_relative_to("/dev/pts")
    if not is_simulated and "gpiochip" not in port.name:
        yield _brltty(host)  # also for a port that is not there: it may be the reason
        yield _modem_manager(host, port)
    wanted = "a device that the group dialout may use"
    try:
        status = host.path(port).stat()
    except OSError as err:
        yield fault(
            "light gate",
            found=f"{port}: {err.strerror}",
            wanted=wanted,
            remedy="plug it in; ls -l /dev/serial/by-id shows the name for [rig.gate]",
        )
        return
    if KERNEL_NAME.fullmatch(str(port)):
        yield fault(
            "light gate's name",
            found=f"{port}, which another device may have after the next start",
            wanted="a name that stays",
            remedy="use the name below /dev/serial/by-id (or by-path) in [rig.gate]",
        )
    device = host.path(port).resolve()
    group = _group(host, status.st_gid)
    is_everybodys = status.st_mode & 0o006 == 0o006
    is_ours = is_everybodys or (status.st_mode & 0o060 == 0o060 and group in (None, "dialout"))
    yield judged(
        "light gate",
        is_good=is_ours or is_simulated,
        found=f"{port}, mode {status.st_mode & 0o777:o}" + (f", group {group}" if group else ""),
        wanted=wanted,
        remedy=GATE_RULES,
    )
    latency = f"/sys/class/tty/{device.name}/device/latency_timer"
    if (ms := host.number(latency)) is not None:
        yield judged(
            "light gate's latency",
            is_good=ms <= LATENCY_MS,
            found=f"{ms} ms",
            wanted=f"{LATENCY_MS} ms: its driver collects bytes for so long",
            remedy=GATE_RULES,
        )


def _group(host: Host, number: int) -> str | None:
    """Return the name of a group, None if the host does not list it."""
    for line in (host.text("/etc/group") or "").splitlines():
        name, _, listed, *_ = [*line.split(":"), "", ""]
        if listed == str(number):
            return name
    return None


def _modem_manager(host: Host, port: Path) -> Finding:
    is_active = any(host.text(path) == "ModemManager" for path in host.glob("/proc/[0-9]*/comm"))
    is_installed = is_active or host.path("/usr/sbin/ModemManager").exists()
    is_ignored = bool(re.search(r"(?m)^E:ID_MM_(DEVICE|PORT)_IGNORE=1$", _udev_data(host, port)))
    state = "running" if is_active else "installed" if is_installed else "not installed"
    return judged(
        "ModemManager",
        is_good=is_ignored or not is_installed,
        found=state + (", and leaves the gate alone" if is_ignored else ""),
        wanted="not there, or the gate marked ID_MM_DEVICE_IGNORE: it writes AT commands to a new port",
        remedy=f"{GATE_RULES}; plug the gate in anew; where no modem is needed: apt-get purge modemmanager",
    )


def _udev_data(host: Host, port: Path) -> str:
    """Return the entry of a device in the database of udev, empty if there is none."""
    try:
        number = host.path(port).stat().st_rdev
    except OSError:
        return ""
    return host.text(f"/run/udev/data/c{os.major(number)}:{os.minor(number)}") or ""


def _brltty(host: Host) -> Finding:
    rules = [
        path for folder in ("/usr/lib", "/lib") for path in host.glob(f"{folder}/udev/rules.d/*brltty*.rules")
    ]
    is_held_off = "BRLTTY" in (host.text(RULES) or "")
    return judged(
        "brltty",
        is_good=is_held_off or not rules,
        found=(f"installed ({rules[0]})" if rules else "not installed")
        + (", and held off" if rules and is_held_off else ""),
        wanted="not there, or held off: it takes converters for braille displays, and their port vanishes",
        remedy=f"{GATE_RULES}; plug the gate in anew; where nobody needs braille: apt-get purge brltty",
    )
