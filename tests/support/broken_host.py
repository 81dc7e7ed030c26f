"""A host as a tree of files, good or with planted faults; as a script: `stonefall doctor` on a broken one.

The script plays a small simulated rig, plants all faults of `FAULTS`, pulls a camera's plug, and prints what `doctor`
says; it exits with 1 unless each fault is named with its remedy.
"""

import json
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

PORT, CAMERAS_PORT, GATE = "eth0", "enp1s0f0", "/dev/serial/by-id/usb-gate"
CAMERAS_ADDRESS = "10.77.0.1"
FILES = {
    "/proc/sys/net/core/rmem_max": "16777216",
    "/proc/sys/net/core/rmem_default": "4194304",
    "/proc/sys/net/core/netdev_max_backlog": "10000",
    "/proc/net/route": (
        "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\tWindow\tIRTT\n"
        "eth0\t00000000\t010200C0\t0003\t0\t0\t0\t00000000\t0\t0\t0\n"
        "eth0\t000200C0\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n"
        "enp1s0f0\t00004D0A\t00000000\t0001\t0\t0\t0\t00FFFFFF\t0\t0\t0\n"
    ),
    "/proc/mounts": "/dev/sda1 / ext4 rw 0 0\ntmpfs /run tmpfs rw,nosuid,size=4000000k,mode=755 0 0\n",
    "/proc/meminfo": "MemTotal:       32000000 kB\nMemFree:        20000000 kB\n",
    "/proc/self/limits": "Limit                     Soft Limit           Hard Limit           Units\n",
    "/etc/systemd/system/stonefall.service": "[Service]\nLimitNOFILE=4096\n",
    "/etc/systemd/journald.conf": "[Journal]\n#SystemMaxUse=\n",
    "/etc/systemd/journald.conf.d/50-stonefall-journald.conf": "[Journal]\nSystemMaxUse=1G\n",
    "/var/log/journal/machine/system.journal": "",
    "/run/chrony/chronyd.pid": "321\n",
    "/sys/devices/system/cpu/online": "0-1\n",
    "/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor": "performance\n",
    "/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor": "performance\n",
    "/sys/class/tty/usb-gate/device/latency_timer": "1\n",
    "/sys/class/net/eth0/mtu": "1500\n",
}
CAMERAS_FILES = {
    "/sys/class/net/{}/mtu": "9000\n",
    "/sys/class/net/{}/operstate": "up\n",
    "/sys/class/net/{}/speed": "20000\n",
    "/sys/class/net/{}/device/msi_irqs/41": "",
    "/sys/class/net/{}/device/msi_irqs/42": "",
    "/proc/irq/41/smp_affinity_list": "0\n",
    "/proc/irq/42/smp_affinity_list": "1\n",
}


class Tree:
    """The files of a host, below a folder."""

    def __init__(self, root: Path, port: str = CAMERAS_PORT, gate: str = GATE) -> None:
        self.root, self.port, self.gate = root, port, gate
        for name, text in (FILES | CAMERAS_FILES).items():
            self.write(name.format(port), text)
        self.write(gate, "")
        self.path(gate).chmod(0o660)

    def path(self, name: str) -> Path:
        return self.root / name.removeprefix("/")

    def write(self, name: str, text: str) -> None:
        self.path(name).parent.mkdir(parents=True, exist_ok=True)
        self.path(name).write_text(text)

    def remove(self, name: str) -> None:
        self.path(name).unlink()


FAULTS: Mapping[str, Callable[[Tree], None]] = {
    "net.core.rmem_max": lambda tree: tree.write("/proc/sys/net/core/rmem_max", "212992"),
    "net.core.rmem_default": lambda tree: tree.write("/proc/sys/net/core/rmem_default", "212992"),
    "MTU of {port}": lambda tree: tree.write(f"/sys/class/net/{tree.port}/mtu", "1500"),
    "interrupts of {port}": lambda tree: tree.write("/proc/irq/42/smp_affinity_list", "0"),
    "speed of the links": lambda tree: tree.write(f"/sys/class/net/{tree.port}/speed", "1000"),
    "CPU governor": lambda tree: tree.write(
        "/sys/devices/system/cpu/cpu1/cpufreq/scaling_governor", "powersave"
    ),
    "light gate": lambda tree: tree.path(tree.gate).chmod(0o600),
    "ModemManager": lambda tree: tree.write("/proc/77/comm", "ModemManager"),
    "brltty": lambda tree: tree.write("/usr/lib/udev/rules.d/85-brltty.rules", ""),
    "clock": lambda tree: tree.remove("/run/chrony/chronyd.pid"),
    "journal": lambda tree: tree.remove("/etc/systemd/journald.conf.d/50-stonefall-journald.conf"),
    "spool": lambda tree: tree.write("/proc/mounts", "/dev/sda1 / ext4 rw 0 0\n"),
    "open files": lambda tree: tree.write(
        "/etc/systemd/system/stonefall.service", "[Service]\nLimitNOFILE=1024\n"
    ),
    "memory": lambda tree: tree.write("/proc/meminfo", "MemTotal: 1000000 kB\n"),
}
"""By the subject of the finding that names it: what plants the fault."""


def main() -> int:
    """Show `doctor` on a broken host with a simulated rig; return the exit code."""
    from support.simulator_process import SimulatorProcess
    from support.small_recording import write_small_recording
    from support.warm_stonefall import run_stonefall

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_small_recording(folder / "recording", n_stones=1)
        with SimulatorProcess(folder, folder / "recording") as simulator:
            config = folder / "stonefall.toml"
            section = simulator.section.replace('serial = "', 'serial = "UNPLUGGED-', 1)
            config.write_text(
                f'{section}[spool]\ndir = "/run/stonefall"\n[store]\ndir = "state"\n'
                "retention.min_free_gb = 0.0\n[api]\nport = 1\n"
            )
            tree = Tree(folder / "host", port="lo", gate=str(folder / "gate"))
            for plant in FAULTS.values():
                plant(tree)
            sys.stdout.write(run_stonefall("doctor", "--config", config, "--root", tree.root).stdout)
            said = json.loads(
                run_stonefall("doctor", "--config", config, "--root", tree.root, "--json").stdout
            )
    planted = {subject.format(port="lo") for subject in FAULTS} | {"cameras"}
    named = {
        each["subject"]
        for part in said.values()
        for each in part
        if each["verdict"] == "fault" and each["remedy"]
    }
    sys.stdout.write(f"{len(planted & named)} of {len(planted)} planted faults are named with a remedy\n")
    return 0 if planted <= named else 1


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    sys.exit(main())
