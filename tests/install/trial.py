"""Install, upgrade, roll back, downgrade and uninstall in a Debian root of its own, offline; prints the minutes.

    sudo .venv/bin/python tests/install/trial.py [--folder FOLDER]

Needs root, and debootstrap and systemd-container of Debian. systemd-nspawn runs the root, at first without systemd, as
in a chroot, then booted: there the real unit runs with all its settings. Three more bundles are made of the first one:
an upgrade with a migration of the store, a release that measures but never says that it is ready, and one that
measures wrong.
"""

import argparse
import json
import shutil
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
BOOT_S = 60.0
CONFIGURATION = """
[rig]
backend = "replay"
recording = "/opt/stonefall/current/selftest/recording"
pace = "recorded"
loop = true
[spool]
dir = "/run/stonefall"
[store]
dir = "/var/lib/stonefall"
[workers]
slots = 2
"""
ASK = "import sys, urllib.request; print(urllib.request.urlopen(sys.argv[1]).read().decode())"
MIGRATION = "CREATE TABLE trial (one INTEGER) STRICT;\n"
NSPAWN = ("systemd-nspawn", "--quiet", "--register=no", "--keep-unit", "--private-network")


class Machine:
    """A root folder and how commands are run in it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.leader: int | None = None

    def command(self, *words: str) -> list[str]:
        if self.leader is not None:
            return ["nsenter", "--target", str(self.leader), "--all", *words]
        return [*NSPAWN, "--pipe", "--directory", str(self.root), *words]

    def run(self, *words: str, expect: int = 0) -> str:
        """Run a command, show what it prints, and require its exit status."""
        print(f"$ {' '.join(words)}", flush=True)
        done = subprocess.run(self.command(*words), capture_output=True, text=True)
        said = done.stdout + done.stderr
        print(said, flush=True)
        assert done.returncode == expect, f"exit {done.returncode} instead of {expect}"
        return said

    @contextmanager
    def booted(self) -> Iterator[None]:
        """Let systemd run the machine."""
        nspawn = subprocess.Popen(
            [*NSPAWN, "--boot", "--directory", str(self.root)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            children = Path(f"/proc/{nspawn.pid}/task/{nspawn.pid}/children")
            eventually(lambda: children.read_text().split())
            leader = int(children.read_text().split()[0])
            eventually(lambda: Path(f"/proc/{leader}/root/run/systemd/private").exists())
            self.leader = leader
            self.run("systemctl", "--no-pager", "list-units", "--failed")
            yield
        finally:
            self.leader = None
            nspawn.terminate()
            nspawn.wait(60)

    def database(self) -> tuple[int, int]:
        """Return schema and number of results of the store, through a copy: a look must leave nothing beside it."""
        copy = self.root.parent / "look"
        shutil.rmtree(copy, ignore_errors=True)
        copy.mkdir()
        for path in (self.root / "var/lib/stonefall").glob("results.sqlite*"):
            shutil.copy(path, copy)
        with closing(sqlite3.connect(copy / "results.sqlite")) as connection:
            (schema,) = connection.execute("PRAGMA user_version").fetchone()
            (count,) = connection.execute("SELECT count(*) FROM results").fetchone()
        return schema, count

    def get(self, path: str) -> dict[str, Any]:
        """Return a document of the daemon."""
        answer = output(*self.command("python3", "-c", ASK, f"http://127.0.0.1:8080/api/v1{path}"))
        return dict(json.loads(answer))

    def unit(self, name: str, unit: str = "stonefall") -> str:
        """Return a property of a unit."""
        return output(*self.command("systemctl", "show", "--value", "--property", name, unit)).strip()

    def current(self) -> str:
        return (self.root / "opt/stonefall/current").readlink().name

    def measures(self) -> None:
        """Wait until results come."""
        _, before = self.database()
        eventually(lambda: self.database()[1] > before + 2)


def eventually(is_true: Callable[[], object], patience_s: float = BOOT_S) -> None:
    """Wait until something is true."""
    end = time.monotonic() + patience_s
    while not is_true():
        assert time.monotonic() < end, f"not within {patience_s:.0f} s"
        time.sleep(0.5)


@contextmanager
def timed(title: str) -> Iterator[None]:
    """Print a title, and how long its block took."""
    print(f"\n=== {title}", flush=True)
    start = time.monotonic()
    yield
    print(f"=== {title}: {(time.monotonic() - start) / 60:.1f} minutes", flush=True)


def derive(bundle: Path, version: str, change: Callable[[Path], None]) -> None:
    """Make the bundle of a changed source out of a bundle: another wheel and another description."""
    derived = bundle.with_name(f"stonefall-{version}")
    shutil.copytree(bundle, derived)
    source = bundle.with_name("source")
    shutil.rmtree(source, ignore_errors=True)
    source.mkdir()
    archive = subprocess.run(["git", "-C", ROOT, "archive", "HEAD"], capture_output=True, check=True).stdout
    subprocess.run(["tar", "-x", "-C", source], input=archive, check=True)
    facts = json.loads((derived / "bundle.json").read_text())
    project = source / "pyproject.toml"
    project.write_text(
        project.read_text().replace(f'version = "{facts["version"]}"', f'version = "{version}"', 1)
    )
    change(source)
    next(derived.glob("wheels/stonefall-*.whl")).unlink()
    pip = [sys.executable, "-m", "pip", "--quiet", "wheel", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--wheel-dir", derived / "wheels", source], check=True)
    facts |= {"version": version, "commit": version, "schema": len(list(source.glob("service/store/*.sql")))}
    (derived / "bundle.json").write_text(json.dumps(facts, indent=4) + "\n")
    (derived / "SHA256SUMS").unlink()
    sums = subprocess.run(
        ["find", ".", "-type", "f", "-exec", "sha256sum", "{}", "+"],
        cwd=derived,
        capture_output=True,
        check=True,
    ).stdout
    (derived / "SHA256SUMS").write_bytes(sums)


def output(*command: object) -> str:
    return subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout


def commit_of(folder: Path) -> str | None:
    """Return the commit of the bundle in a folder, None if there is none."""
    for path in folder.glob("*.tar"):
        facts = output("tar", "-x", "-O", "-f", path, "--wildcards", "*/bundle.json")
        return str(json.loads(facts)["commit"])
    return None


def migrate(source: Path) -> None:
    number = len(list(source.glob("service/store/*.sql"))) + 1
    (source / f"service/store/{number:03}_trial.sql").write_text(MIGRATION)


def never_ready(source: Path) -> None:
    migrate(source)
    path = source / "service/api/routes/health.py"
    text = path.read_text()
    assert text.count("if not health.ready:") == 1
    path.write_text(text.replace("if not health.ready:", "if health is not None:"))


def measures_wrong(source: Path) -> None:
    path = source / "pipeline/particle.py"
    text = path.read_text()
    place = "    density = parameters.density_g_cm3\n"
    assert text.count(place) == 1
    path.write_text(text.replace(place, f"{place}    volume_mm3 *= 1.005\n"))


def prepare(folder: Path) -> Machine:
    """Make the root and four bundles in it; what an earlier trial has made of the same commit is used again."""
    machine = Machine(folder / "root")
    bundles = machine.root / "srv"
    clean, tar = folder / "clean", folder / "bundle"
    if not clean.exists():
        with timed("debootstrap"):
            unfinished = folder / "unfinished"
            shutil.rmtree(unfinished, ignore_errors=True)
            command = ["debootstrap", "--variant=minbase", "bookworm", unfinished]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            unfinished.rename(clean)
    if commit_of(tar) != output("git", "-C", ROOT, "rev-parse", "HEAD").strip():
        with timed("deploy/bundle"):
            shutil.rmtree(tar, ignore_errors=True)
            subprocess.run([ROOT / "deploy/bundle", tar], check=True)
    shutil.rmtree(machine.root, ignore_errors=True)
    subprocess.run(["cp", "-a", clean, machine.root], check=True)
    subprocess.run(["tar", "-x", "-C", bundles, "-f", *tar.glob("*.tar")], check=True)
    (first,) = bundles.glob("stonefall-*")
    major = first.name.removeprefix("stonefall-").split(".")[0]
    with timed("three more bundles"):
        derive(first, f"{major}.9001.0", migrate)
        derive(first, f"{major}.9002.0", never_ready)
        derive(first, f"{major}.9003.0", measures_wrong)
    shutil.rmtree(bundles / "source")
    return machine


def trial(machine: Machine) -> None:
    first, newer, broken, wrong = (
        path.name.removeprefix("stonefall-")
        for path in sorted(
            (machine.root / "srv").glob("stonefall-*"), key=lambda path: (len(path.name), path)
        )
    )
    install = "/srv/stonefall-{}/deploy/install"
    with timed("refused: a damaged bundle"):
        wheel = next(machine.root.glob(f"srv/stonefall-{first}/wheels/numpy-*"))
        content = wheel.read_bytes()
        wheel.write_bytes(content[:-1] + b"?")
        assert "the bundle is damaged" in machine.run(install.format(first), expect=1)
        wheel.write_bytes(content)
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
        with timed("upgrade with a migration"):
            schema, count = machine.database()
            machine.run(install.format(newer))
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=ROOT / "build/trial", help="default: build/trial")
    folder: Path = parser.parse_args().folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    with timed("all"):
        trial(prepare(folder))
    print(f"=== {output('du', '--summarize', '--block-size=1M', folder).split()[0]} MB in {folder}")


if __name__ == "__main__":
    main()
