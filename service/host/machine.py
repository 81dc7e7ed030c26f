"""Checks of the machine itself: processor, memory, disk, spool, gate, clock, journal, descriptors."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from service.host.finding import Finding, installed, judged, unknown
from service.host.gate_port import check_gate
from service.host.host import Host, Mount
from service.host.network import CameraNetwork, check_network

DAEMON_BYTES, WORKER_BYTES, CALIBRATION_BYTES = 800 << 20, 400 << 20, 500 << 20
"""Memory of the daemon and of a worker, measured, and of a calibration that is solved, reckoned."""
FILES = 4096
"""Open files and connections: cameras, workers, and what REST admits; as the unit sets it."""
UNIT = "/etc/systemd/system/stonefall.service"
GOVERNOR = installed("stonefall-governor.conf", "/etc/tmpfiles.d", "systemd-tmpfiles --create")
CHRONY = "apt-get install chrony && " + installed(
    "50-stonefall-chrony.conf", "/etc/chrony/conf.d", "editor /etc/chrony/conf.d/50-stonefall-chrony.conf"
)
JOURNAL = installed(
    "50-stonefall-journald.conf", "/etc/systemd/journald.conf.d", "systemctl restart systemd-journald"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class HostNeeds:
    """Needs that are checked on the host."""

    network: CameraNetwork | None  # None: a recording is replayed
    gate: Path | None  # device of the light gate; None: a recording is replayed
    spool_dir: Path
    spool_bytes: int  # of all bundles that may wait
    store_dir: Path
    min_free_bytes: int  # of the disk, below which files are removed
    workers: int

    @property
    def memory_bytes(self) -> int:
        """Memory of all processes, the spool on tmpfs included."""
        return DAEMON_BYTES + self.workers * WORKER_BYTES + CALIBRATION_BYTES + self.spool_bytes


def check_host(host: Host, needs: HostNeeds) -> list[Finding]:
    """Check a host; reads files, and asks each network port for its receive ring."""
    return list(_checks(host, needs))


def _checks(host: Host, needs: HostNeeds) -> Iterator[Finding]:
    if needs.network is not None:
        yield from check_network(host, needs.network)
    yield _governor(host)
    if needs.gate is not None:
        yield from check_gate(host, needs.gate)
    yield _clock(host)
    yield _journal(host)
    yield _spool(host, needs)
    yield _descriptors(host)
    yield _disk(host, needs)
    yield _memory(host, needs)


def _governor(host: Host) -> Finding:
    governors = {
        host.text(path) for path in host.glob("/sys/devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor")
    }
    if not governors:
        return unknown("CPU governor", "this machine does not set the frequency itself", "performance")
    return judged(
        "CPU governor",
        is_good=governors == {"performance"},
        found=", ".join(sorted(map(str, governors))),
        wanted="performance: a core that wakes slowly reads frames late",
        remedy=GOVERNOR,
    )


def _clock(host: Host) -> Finding:
    services = {
        "chrony": host.glob("/run/chrony/chronyd.pid"),
        "systemd-timesyncd": host.glob("/run/systemd/timesync/synchronized"),
        "ntpsec": host.glob("/run/ntpd.pid"),
    }
    by = ", ".join(name for name, found in services.items() if found) or "no time service"
    is_synchronised = host.is_synchronised()
    words = {True: "synchronised", False: "not synchronised", None: "state not known"}[is_synchronised]
    return judged(
        "clock",
        is_good=any(services.values()) if is_synchronised is None else is_synchronised,
        found=f"{words}, {by}",
        wanted="synchronised: results, lots and audit are dated by it",
        remedy=CHRONY,
    )


def _journal(host: Host) -> Finding:
    wanted = "kept on disk (/var/log/journal), with SystemMaxUse"
    files = [Path("/etc/systemd/journald.conf")]
    for folder in ("/usr/lib", "/run", "/etc"):
        files += host.glob(f"{folder}/systemd/journald.conf.d/*.conf")
    texts = [text for file in files if (text := host.text(file)) is not None]
    if not texts:
        return unknown("journal", "no journald is configured here", wanted)
    limits = [limit for text in texts for limit in re.findall(r"(?m)^\s*SystemMaxUse\s*=\s*(\S+)", text)]
    is_kept = host.path("/var/log/journal").is_dir()
    kept = "kept on disk" if is_kept else "lost at each start"
    return judged(
        "journal",
        is_good=bool(limits) and is_kept,
        found=f"{kept}, SystemMaxUse {limits[-1] if limits else 'not set'}",
        wanted=wanted,
        remedy=JOURNAL,
    )


def _spool(host: Host, needs: HostNeeds) -> Finding:
    wanted = f"tmpfs with room for {needs.spool_bytes / 1e9:.2f} GB of bundles"
    if (mount := host.mount(needs.spool_dir)) is None:
        return unknown("spool", "the mounts cannot be read", wanted)
    room = host.free_bytes(needs.spool_dir)
    size = _size_bytes(mount)
    is_large = all(known is None or known >= needs.spool_bytes for known in (room, size))
    return judged(
        "spool",
        is_good=mount.kind == "tmpfs" and is_large,
        found=f"{needs.spool_dir} is on {mount.kind}"
        + (f" of {size / 1e9:.2f} GB" if size is not None else "")
        + (f", {room / 1e9:.2f} GB free" if room is not None else ""),
        wanted=wanted,
        remedy="spool.dir on tmpfs: /run/stonefall, which the unit makes"
        if mount.kind != "tmpfs"
        else f"a smaller spool.max_bundles, or: mount -o remount,size={needs.spool_bytes // 2**20 * 2}m {mount.place}",
    )


def _size_bytes(mount: Mount) -> int | None:
    """Return the size that a tmpfs is limited to, as in size=1638400k; None if it is not."""
    size = re.search(r"(?:^|,)size=(\d+)([kmg]?)", ",".join(mount.options))
    return None if size is None else int(size[1]) << {"": 0, "k": 10, "m": 20, "g": 30}[size[2]]


def _descriptors(host: Host) -> Finding:
    drop_ins = host.glob("/etc/systemd/system/stonefall.service.d/*.conf")
    texts = [text for file in (Path(UNIT), *drop_ins) if (text := host.text(file)) is not None]
    set_there = [int(each) for text in texts for each in re.findall(r"(?m)^LimitNOFILE=(\d+)", text)]
    ours = re.search(r"Max open files\s+(\d+)", host.text("/proc/self/limits") or "")
    if set_there:
        n_files, where = set_there[-1], "of the unit"
    elif ours is not None:
        n_files, where = int(ours[1]), "of this process"
    else:
        return unknown("open files", "the limit cannot be read", f"at least {FILES}")
    return judged(
        "open files",
        is_good=n_files >= FILES,
        found=f"{n_files} {where}",
        wanted=f"at least {FILES}",
        remedy=f"LimitNOFILE={FILES} in the unit, as systemd/stonefall.service has it; in a shell: ulimit -n {FILES}",
    )


def _disk(host: Host, needs: HostNeeds) -> Finding:
    wanted = f"more than store.retention.min_free_gb = {needs.min_free_bytes / 1e9:g}"
    if (free := host.free_bytes(needs.store_dir)) is None:
        return unknown("disk", f"the file system of {needs.store_dir} does not answer", wanted)
    return judged(
        "disk",
        is_good=free > needs.min_free_bytes,
        found=f"{free / 1e9:.1f} GB free at {needs.store_dir}",
        wanted=wanted,
        remedy="make room; without it the oldest meshes are removed: set limits in [store.retention]",
    )


def _memory(host: Host, needs: HostNeeds) -> Finding:
    wanted = f"{needs.memory_bytes / 1e9:.1f} GB for {needs.workers} workers and the spool"
    total = re.search(r"MemTotal:\s+(\d+) kB", host.text("/proc/meminfo") or "")
    if total is None:
        return unknown("memory", "/proc/meminfo cannot be read", wanted)
    n_bytes = int(total[1]) << 10
    return judged(
        "memory",
        is_good=n_bytes >= needs.memory_bytes,
        found=f"{n_bytes / 1e9:.1f} GB",
        wanted=wanted,
        remedy="fewer workers.slots, a smaller spool.max_bundles, or more memory",
    )
