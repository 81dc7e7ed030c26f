"""The bundle in a root that systemd-nspawn runs: at first as a chroot, then booted, where the real unit runs.

Refusals, installation, reload, upgrade with a migration, downgrade, and what goes wrong: a release that measures but
never says that it is ready, and one that measures wrong.
"""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

from install.debian_root import ROOT, Machine, timed
from install.derived_bundles import derive, measures_wrong, migrate, never_ready
from support.eventually import eventually

CONFIGURATION = (ROOT / "deploy/container/demo.toml").read_text()
"""The recording of the self-test, again and again, as the image has it."""


def unpack(root: Path, bundle: Path) -> Machine:
    """Unpack a bundle in a clean root, and make three more out of it there."""
    bundles = root / "srv"
    subprocess.run(["tar", "-x", "-C", bundles, "-f", bundle], check=True)
    (first,) = bundles.glob("stonefall-*")
    with timed("three more bundles"):
        derive(first, "0.9001.0", migrate)
        derive(first, "0.9002.0", never_ready)
        derive(first, "0.9003.0", measures_wrong)
    shutil.rmtree(bundles / "source")
    return Machine(root)


def try_bundle(machine: Machine) -> None:
    """Install, reload, upgrade, go back and uninstall, with bundles that lie in the machine's /srv."""
    first, newer, broken, wrong = (
        path.name.removeprefix("stonefall-")
        for path in sorted(
            (machine.root / "srv").glob("stonefall-*"), key=lambda path: (len(path.name), path)
        )
    )
    install = "/srv/stonefall-{}/deploy/install"
    with timed("refused: a damaged bundle"):
        library = next(
            machine.root.glob(f"srv/stonefall-{first}/environment/lib/*/site-packages/numpy/version.py")
        )
        content = library.read_bytes()
        library.write_bytes(content[:-1] + b"?")
        assert "the bundle is damaged" in machine.run(install.format(first), expect=1)
        library.write_bytes(content)
    with timed("refused: not root; twice at once"):
        assert "only root" in machine.run("runuser", "-u", "nobody", "--", install.format(first), expect=1)
        twice = f"mkdir -p /run/lock; flock /run/lock/stonefall-install {install.format(first)}"
        assert "another installation runs" in machine.run("bash", "-c", twice, expect=1)
    with timed("dry run"):
        assert "nothing was changed" in machine.run(install.format(first), "--dry-run")
        assert not (machine.root / "opt/stonefall").exists()
        assert not (machine.root / "usr/bin/python3").exists()
    with timed("installation where systemd does not run"):
        said = machine.run(install.format(first))
        assert "self-test" in said and "systemd does not run here" in said
    with timed("once more"):
        assert "nothing to do" in machine.run(install.format(first))
    machine.run("systemd-analyze", "verify", "/etc/systemd/system/stonefall.service")
    (machine.root / "etc/stonefall/stonefall.toml").write_text(CONFIGURATION)
    with timed("started by hand, as the installer says"):
        by_hand = [line.strip() for line in said.splitlines() if line.startswith("      ")]
        ready = (
            "import time, urllib.request\n"
            "for _ in range(120):\n"
            "    try: print(urllib.request.urlopen('http://127.0.0.1:8080/api/v1/health/ready').read()); break\n"
            "    except OSError: time.sleep(0.5)\n"
            "else: raise SystemExit('never ready')\n"
        )
        script = f'{by_hand[0]}\n{by_hand[1]} & \npython3 -c "$1"; code=$?; kill %1; wait; exit $code'
        machine.run("bash", "-c", f"set -m\n{script}", "-", ready)
    with machine.booted():
        with timed("started by systemd"):
            machine.run("systemctl", "enable", "--now", "stonefall")
            weight = f"CPUWeight={machine.unit('CPUWeight', machine.unit('Slice'))}\n"
            assert weight in (ROOT / "systemd/stonefall.slice").read_text()
            machine.measures()
        with timed("reload: what is applied, what needs a restart, what is refused"):
            reload_configurations(machine)
        with timed("a release that measures wrong, not switched to"):
            pid = machine.unit("MainPID")
            said = machine.run(install.format(wrong), expect=1)
            assert "self-test: " in said and "volume_mm3" in said
            assert machine.current() == first and machine.unit("MainPID") == pid
            assert not (machine.root / f"opt/stonefall/releases/{wrong}").exists()
            machine.measures()
        upgrade = (
            "/opt/stonefall/current/bin/stonefall",
            "upgrade",
            f"/srv/stonefall-{newer}",
            "--stones",
            "4",
        )
        with timed("upgrade: shown only"):
            said = machine.run(*upgrade, "--dry-run")
            assert "migrated at the first start" in said and "all results are equal, bit for bit" in said
            assert machine.current() == first
        with timed("upgrade with a migration"):
            schema, count = machine.database()
            machine.run(*upgrade, "--yes")
            assert machine.current() == newer
            stood_s = (
                float(machine.unit("ActiveEnterTimestampMonotonic"))
                - float(machine.unit("ActiveExitTimestampMonotonic"))
            ) / 1e6
            print(f"=== the daemon stood for {stood_s:.0f} s", flush=True)
            machine.measures()
            assert machine.database()[0] == schema + 1 and machine.database()[1] > count
        with timed("downgrade: refused, then with --restore"):
            switch = "/opt/stonefall/current/deploy/install"
            anyone = ("runuser", "-u", "nobody", "--", switch, "--switch-to", first, "--dry-run")
            assert "nothing was changed" in machine.run(*anyone)
            assert "Nothing was changed" in machine.run(switch, "--switch-to", first, expect=1)
            assert machine.current() == newer
            machine.run(switch, "--switch-to", first, "--restore")
            assert machine.current() == first and machine.database()[0] == schema
            machine.measures()
        with timed("a release that is never ready, rolled back"):
            _, count = machine.database()
            assert f"Rolled back: {first}" in machine.run(install.format(broken), expect=1)
            assert machine.current() == first and machine.database()[0] == schema
            assert machine.database()[1] >= count
            machine.measures()
        later = list(machine.root.glob("var/lib/stonefall/backups/after-*.jsonl"))
        assert len(later) == 2 and all(path.stat().st_size for path in later)
        with timed("uninstall"):
            machine.run("/opt/stonefall/current/deploy/uninstall")
            assert not (machine.root / "opt/stonefall").exists()
            assert machine.database()[1] >= count
            assert (machine.root / "etc/stonefall/stonefall.toml").read_text() == CONFIGURATION


def reload_configurations(machine: Machine) -> None:
    """Reload good and bad configurations of the daemon, and restart it with a bad one."""
    file, alarm = machine.root / "etc/stonefall/stonefall.toml", machine.root / "var/lib/stonefall/alarm.txt"
    pid = machine.unit("MainPID")

    def reload(text: str, is_so: Callable[[dict[str, Any]], bool]) -> None:
        file.write_text(text)
        machine.run("systemctl", "reload", "stonefall")
        eventually(lambda: is_so(machine.get("/config")))
        assert machine.unit("MainPID") == pid

    reload(CONFIGURATION + "[optics]\ndust = 0.2\n", lambda now: now["settings"]["optics"]["dust"] == 0.2)
    fewer = CONFIGURATION.replace("slots = 2", "slots = 1")
    reload(fewer, lambda now: now["restart_needed_for"] == ["workers.slots"])
    broken = CONFIGURATION + "[optics]\ndust = -1.0\n"
    reload(broken, lambda now: "dust must be positive" in str(now["problem"]))
    assert machine.get("/health")["checks"]["configuration"]["status"] == "warn"
    machine.measures()
    machine.run("systemctl", "restart", "stonefall", expect=1)
    eventually(alarm.exists)
    assert "stonefall.service failed" in alarm.read_text()
    log = machine.run("journalctl", "--unit", "stonefall", "--lines", "20", "--output", "cat")
    assert "dust must be positive" in log
    file.write_text(CONFIGURATION)
    machine.run("systemctl", "reset-failed", "stonefall")
    machine.run("systemctl", "start", "stonefall")
    alarm.unlink()
    machine.measures()
