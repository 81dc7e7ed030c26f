"""Package and bundle in clean roots of Debian 12 and 13, installed without network; prints the minutes.

    sudo .venv/bin/python tests/install/trial.py [--folder FOLDER] [bookworm] [trixie]

Needs root, mmdebstrap, iproute2 and systemd-container. For each Debian a root is made in which `deploy/release` makes
and signs all files, and clean roots, for which apt fetches what Debian has; then the network is cut. In the first root,
a chroot: the package by apt, its self-test, a replay to the first result, an upgrade that measures wrong, one with a
migration, removal, and purge with both answers. In the second, booted: the bundle (`booted.py`). In the third, on
Debian 12, the very steps of `deploy/container/Containerfile` are done, and what the image starts is started.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path
from string import Template

sys.path.insert(0, str(Path(__file__).parents[1]))
from install.booted import try_bundle, unpack
from install.debian_root import ROOT, Chroot, output, timed
from install.derived_bundles import derive, measures_wrong, migrate

SUITES = ("bookworm", "trixie")
FIRST_RESULT = """
import json, subprocess, sys, time, urllib.request
start, before = time.monotonic(), None
daemon = subprocess.Popen(sys.argv[1:])
try:
    while True:
        assert daemon.poll() is None and time.monotonic() < start + 300, "no result"
        time.sleep(0.2)
        try:
            with urllib.request.urlopen("http://127.0.0.1:8080/api/v1/accounting") as answer:
                found = json.load(answer)
        except OSError:
            continue
        before = found["measured"] if before is None else before
        if found["measured"] > before:
            print("measured", found["measured"] - before, "first result after", round(time.monotonic() - start), "s")
            break
finally:
    daemon.terminate()
    assert daemon.wait(60) == 0
"""
START = "/deploy/container/start"


def clean_root(folder: Path, suite: str, name: str) -> Path:
    """Return a new root of Debian, unpacked from one that mmdebstrap makes once with the mirror of this machine."""
    tar, root = folder / f"{suite}.tar", folder / f"{suite}-{name}"
    if not tar.exists():
        asked = ["apt-get", "indextargets", "--format", "$(REPO_URI)", "Label: Debian", "Component: main"]
        mirror = output(*asked).split()[0]
        command = ["mmdebstrap", "--quiet", "--variant=minbase", "--mode=root", suite, f"{tar}.new.tar"]
        subprocess.run([*command, f"deb {mirror} {suite} main"], check=True)
        Path(f"{tar}.new.tar").rename(tar)
    shutil.rmtree(root, ignore_errors=True)
    root.mkdir()
    subprocess.run(["tar", "-x", "-C", root, "-f", tar], check=True)
    shutil.copy("/etc/resolv.conf", root / "etc/resolv.conf")
    return root


def commit_of(folder: Path) -> str | None:
    """Return the commit of the bundle in a folder, None if there is none."""
    for path in folder.glob("*.tar.gz"):
        facts = output("tar", "-x", "-O", "-f", path, "--wildcards", "*/bundle.json")
        return str(json.loads(facts)["commit"])
    return None


def make_release(folder: Path, suite: str) -> Path:
    """Run `deploy/release` in a root, and return the folder of its files; those of the same commit are used again."""
    files = folder / f"{suite}-files"
    if commit_of(files) == output("git", "-C", ROOT, "rev-parse", "HEAD").strip():
        return files
    builder = Chroot(clean_root(folder, suite, "builder"), is_online=True)
    subprocess.run(["git", "clone", "--quiet", ROOT, builder.root / "srv/checkout"], check=True)
    told = certificate_in(builder.root)
    with timed(f"{suite}: deploy/release"):
        builder.run("apt-get", "update", "-qq")
        builder.run(
            "apt-get", "install", "-qq", "--no-install-recommends", "openssh-client", "git", "python3-venv"
        )
        builder.run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", "/root/key")
        builder.run("env", *told, "/srv/checkout/deploy/release", "/root/key", "/srv/release")
    shutil.rmtree(files, ignore_errors=True)
    shutil.move(builder.root / "srv/release", files)
    shutil.rmtree(builder.root)
    make_later_packages(folder, suite, files)
    return files


def make_later_packages(folder: Path, suite: str, files: Path) -> None:
    """Make two packages more out of a release: with a migration of the store, and one that measures wrong."""
    (bundle,) = files.glob("*.tar.gz")
    work = folder / f"{suite}-derived"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir()
    subprocess.run(["tar", "-x", "-C", work, "-f", bundle], check=True)
    (first,) = work.glob("stonefall-*")
    (files / "later").mkdir()
    for version, change in (("0.9001.0", migrate), ("0.9003.0", measures_wrong)):
        derive(first, version, change)
        tar = work / f"{version}.tar"
        subprocess.run(["tar", "-c", "-C", work, "-f", tar, f"stonefall-{version}"], check=True)
        subprocess.run([ROOT / "deploy/package", tar, files / "later"], check=True)
    shutil.rmtree(work)


def fetch_packages(machine: Chroot, *wanted: str) -> None:
    """Let apt fetch what an installation needs of Debian, while there is a network."""
    online = Chroot(machine.root, is_online=True)
    online.run("apt-get", "update", "-qq")
    online.run("apt-get", "install", "-qq", "--download-only", "--no-install-recommends", *wanted)


def replay(machine: Chroot) -> None:
    """Replay the recording of the self-test as the image does, to a first result."""
    measure = ("python3", "-c", FIRST_RESULT, f"/usr/lib/stonefall{START}", "demo")
    caches = ("env", "NUMBA_CACHE_DIR=/var/cache/stonefall/numba", "OMP_NUM_THREADS=1")
    said = machine.run("runuser", "-u", "stonefall", "--", *caches, *measure)
    assert re.search(r"measured [1-9]", said)


def try_package(folder: Path, suite: str, files: Path) -> None:
    machine = Chroot(clean_root(folder, suite, "package"))
    (package,) = files.glob("*.deb")
    newer, wrong = sorted((files / "later").glob("*.deb"))
    for path in (package, newer, wrong):
        shutil.copy(path, machine.root / "srv")
    apt = ("apt-get", "install", "--yes", "--no-install-recommends")
    fetch_packages(machine, f"/srv/{package.name}")
    with timed(f"{suite}: apt install ./{package.name}, no network"):
        said = machine.run(*apt, f"/srv/{package.name}")
        assert "self-test" in said and "systemd does not run here" in said
    first = machine.current()
    assert f"stonefall {first}," in machine.run("stonefall", "--version")
    machine.run(
        "test", "-e", "/usr/share/bash-completion/completions/stonefall", "-a", "-e", "/usr/bin/stonefall"
    )
    machine.run("dpkg", "--verify", "stonefall")
    with timed(f"{suite}: replay to a first result"):
        replay(machine)
    schema, count = machine.database()
    assert count > 0
    with timed(f"{suite}: an upgrade that measures wrong is not switched to"):
        said = machine.run(*apt, f"/srv/{wrong.name}", expect=100)
        assert "self-test: " in said and "volume_mm3" in said
        assert machine.current() == first
        replay(machine)
    with timed(f"{suite}: an upgrade with a migration"):
        said = machine.run(*apt, "--allow-downgrades", f"/srv/{newer.name}")
        assert machine.current() == "0.9001.0" and "backup of the database" in said
        replay(machine)
        assert machine.database()[0] == schema + 1 and machine.database()[1] > count
    with timed(f"{suite}: removal, purge without and with the answer"):
        machine.run("apt-get", "remove", "--yes", "stonefall")
        assert not (machine.root / "opt/stonefall").exists()
        assert (machine.root / "etc/stonefall/stonefall.toml").exists()
        machine.run("apt-get", "purge", "--yes", "stonefall")
        assert not (machine.root / "etc/stonefall").exists() and machine.database()[1] > count
        machine.run(*apt, f"/srv/{newer.name}")
        answer = 'echo "stonefall stonefall/purge-data boolean true" | debconf-set-selections'
        machine.run("sh", "-c", answer)
        machine.run("apt-get", "purge", "--yes", "stonefall")
        assert not (machine.root / "var/lib/stonefall").exists()
        left = output("find", machine.root, "-xdev", "-name", "*stonefall*", "-not", "-path", "*/srv/*")
        print(f"left: {left}")
    shutil.rmtree(machine.root)


def try_image(folder: Path, suite: str, files: Path) -> None:
    """Do the steps of the Containerfile in a root instead of its base image, which comes from a registry."""
    root = clean_root(folder, suite, "image")
    online, machine = Chroot(root, is_online=True), Chroot(root)
    arguments: dict[str, str] = {}
    environment, told, user, command = [], certificate_in(root), "root", []
    text = (ROOT / "deploy/container/Containerfile").read_text().replace("\\\n", " ")
    for word, _, rest in (line.partition(" ") for line in text.splitlines() if line[:1].isupper()):
        match word:
            case "ARG":
                name, _, value = rest.partition("=")
                arguments[name] = value
            case "COPY":
                source, target = rest.split()
                for path in files.glob(source):
                    shutil.copy(path, root / target.lstrip("/"))
            case "RUN":
                with timed(f"{suite}: the image is made"):
                    online.run("env", *environment, *told, "sh", "-c", rest)
            case "ENV":
                environment += shlex.split(Template(rest).substitute(arguments))
            case "USER":
                user = rest
            case "ENTRYPOINT":
                command = json.loads(rest)
    assert command and (root / command[0].lstrip("/")).exists()
    as_user = ("runuser", "-u", user, "--", "env", *environment)
    with timed(f"{suite}: the image's demo to a first result"):
        machine.run(*as_user, "python3", "-c", FIRST_RESULT, *command, "demo")
    with timed(f"{suite}: the image's rehearsal"):
        said = machine.run(*as_user, *command, "rehearse", "--speed", "10", "--linger-s", "0")
        assert re.search(r"lot +L-2 \(closed\): [1-9]", said)
    shutil.rmtree(root)


def certificate_in(root: Path) -> list[str]:
    """Return the variables that pip needs in a root, where the network of this machine has a certificate of its own."""
    if (certificate := os.environ.get("PIP_CERT")) is None:
        return []
    shutil.copy(certificate, root / "srv/certificates.crt")
    return ["PIP_CERT=/srv/certificates.crt"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--folder", type=Path, default=ROOT / "build/trial", help="default: build/trial")
    parser.add_argument("suites", nargs="*", metavar="SUITE", help=f"default: {' '.join(SUITES)}")
    arguments = parser.parse_args()
    folder: Path = arguments.folder.absolute()
    folder.mkdir(parents=True, exist_ok=True)
    for suite in arguments.suites or SUITES:
        start = time.monotonic()
        files = make_release(folder, suite)
        try_package(folder, suite, files)
        (bundle,) = files.glob("*.tar.gz")
        with timed(f"{suite}: the bundle, booted"):
            root = clean_root(folder, suite, "booted")
            try_bundle(unpack(root, bundle))
            shutil.rmtree(root)
        if suite == SUITES[0]:
            try_image(folder, suite, files)
        print(f"=== {suite}: all in {(time.monotonic() - start) / 60:.1f} minutes", flush=True)


if __name__ == "__main__":
    main()
