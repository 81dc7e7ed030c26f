"""Faults planted in a tree of files: each is found, by its name and with its remedy, and nothing else is."""

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from support.broken_host import CAMERAS_ADDRESS, CAMERAS_PORT, FAULTS, GATE, Tree
from support.configurations import REPLAY
from support.recordings import make_bundle, write_recording
from typer.testing import CliRunner

from service.commands.cli import build_app
from service.host.finding import Finding, HostVerdict
from service.host.host import Host, Ring, host_at
from service.host.machine import HostNeeds, check_host
from service.host.network import CameraNetwork

ROOT = Path(__file__).parents[4]
NETWORK = CameraNetwork(
    addresses=(CAMERAS_ADDRESS,), receive_buffer_bytes=4 << 20, packet_bytes=8192, uplink_bytes_s=2.5e9
)
NEEDS = HostNeeds(
    network=NETWORK,
    gate=Path(GATE),
    spool_dir=Path("/run/stonefall"),
    spool_bytes=340_000_000,
    store_dir=Path("/var/lib/stonefall"),
    min_free_bytes=0,
    workers=2,
)


@pytest.fixture
def tree(tmp_path: Path) -> Tree:
    return Tree(tmp_path)


def faults(tree: Tree, needs: HostNeeds = NEEDS) -> dict[str, Finding]:
    findings = check_host(host_at(tree.root), needs)
    return {finding.subject: finding for finding in findings if finding.verdict is HostVerdict.FAULT}


def test_a_good_host_has_no_fault_and_nothing_unknown(tree: Tree) -> None:
    findings = check_host(host_at(tree.root), NEEDS)
    assert {finding.verdict for finding in findings} == {HostVerdict.GOOD}
    assert {finding.remedy for finding in findings} == {None}
    assert {name.format(port=CAMERAS_PORT) for name in FAULTS} <= {finding.subject for finding in findings}


@pytest.mark.parametrize("subject", FAULTS)
def test_a_planted_fault_is_found_and_no_other(subject: str, tree: Tree) -> None:
    FAULTS[subject](tree)
    found = faults(tree)
    assert found.keys() == {subject.format(port=CAMERAS_PORT)}
    (finding,) = found.values()
    assert finding.found
    assert finding.wanted
    assert finding.remedy
    words = finding.remedy.replace(",", " ").split()
    assert all((ROOT / word).is_file() for word in words if word.startswith(("deploy/", "systemd/")))


def test_every_host_file_says_where_it_goes() -> None:
    for file in (ROOT / "deploy" / "host").iterdir():
        assert file.read_text().startswith("# Goes to /etc/"), file


def test_what_cannot_be_read_is_unknown_and_no_fault(tmp_path: Path) -> None:
    needs = replace(NEEDS, gate=None, network=replace(NETWORK, addresses=()))
    findings = {finding.subject: finding for finding in check_host(host_at(tmp_path), needs)}
    assert findings["clock"].verdict is HostVerdict.FAULT  # there is no time service
    assert findings["disk"].verdict is HostVerdict.GOOD  # the folder will be made on that file system
    others = {subject for subject in findings if subject not in ("clock", "disk")}
    assert {findings[subject].verdict for subject in others} == {HostVerdict.UNKNOWN}


def test_what_the_kernel_says_counts_more_than_which_service_runs(tree: Tree) -> None:
    for answer, verdict in ((False, HostVerdict.FAULT), (True, HostVerdict.GOOD)):
        host = Host(
            tree.root, ring=lambda _: Ring(now=256, most=8192), is_synchronised=lambda now=answer: now
        )
        found = {finding.subject: finding for finding in check_host(host, NEEDS)}
        assert found["clock"].verdict is verdict
        ring = found[f"receive ring of {CAMERAS_PORT}"]
        assert (ring.verdict, ring.found) == (HostVerdict.FAULT, "256 of 8192")
        assert f"ethtool -G {CAMERAS_PORT} rx 4096" in str(ring.remedy)


def test_packets_only_need_to_fit_through_the_port(tree: Tree) -> None:
    tree.write(f"/sys/class/net/{CAMERAS_PORT}/mtu", "4088")
    small = replace(NETWORK, packet_bytes=4088)
    assert faults(tree).keys() == {f"MTU of {CAMERAS_PORT}"}
    assert faults(tree, replace(NEEDS, network=small)) == {}


def test_an_address_without_a_port_is_a_fault(tree: Tree) -> None:
    network = replace(NETWORK, addresses=(CAMERAS_ADDRESS, "10.99.0.1"))
    assert faults(tree, replace(NEEDS, network=network)).keys() == {"port of 10.99.0.1"}


def test_a_name_of_the_kernel_and_a_slow_converter_are_faults(tree: Tree) -> None:
    tree.write("/dev/ttyUSB0", "")
    tree.path("/dev/ttyUSB0").chmod(0o660)
    tree.write("/sys/class/tty/ttyUSB0/device/latency_timer", "16")
    found = faults(tree, replace(NEEDS, gate=Path("/dev/ttyUSB0")))
    assert found.keys() == {"light gate's name", "light gate's latency"}
    tree.remove("/dev/ttyUSB0")
    gone = faults(tree, replace(NEEDS, gate=Path("/dev/ttyUSB0")))
    assert "No such file" in gone["light gate"].found
    assert faults(tree, replace(NEEDS, gate=Path("gpiochip0"))).keys() == {"light gate"}


def test_the_rule_holds_off_both_programs_that_take_ports(tree: Tree) -> None:
    for subject in ("ModemManager", "brltty"):
        FAULTS[subject](tree)
    number = tree.path(GATE).stat().st_rdev
    tree.write(f"/run/udev/data/c{os.major(number)}:{os.minor(number)}", "I:1\nE:ID_MM_DEVICE_IGNORE=1\n")
    rules = (ROOT / "deploy" / "host" / "90-stonefall-gate.rules").read_text()
    assert 'ENV{ID_MM_DEVICE_IGNORE}="1"' in rules
    tree.write("/etc/udev/rules.d/90-stonefall-gate.rules", rules)
    assert faults(tree) == {}


def test_a_port_that_brltty_took_is_missing_and_brltty_is_named(tree: Tree) -> None:
    FAULTS["brltty"](tree)
    tree.remove(GATE)
    assert faults(tree).keys() == {"brltty", "light gate"}


def test_a_modem_manager_that_is_installed_and_stands_still_is_named(tree: Tree) -> None:
    tree.write("/usr/sbin/ModemManager", "")
    assert faults(tree)["ModemManager"].found == "installed"
    tree.write("/dev/gpiochip0", "")
    tree.path("/dev/gpiochip0").chmod(0o660)
    assert faults(tree, replace(NEEDS, gate=Path("/dev/gpiochip0"))) == {}  # a GPIO chip is no modem


@pytest.mark.parametrize(("group", "is_fault"), [("dialout", False), ("plugdev", True)])
def test_a_port_of_another_group_is_a_fault(tree: Tree, group: str, is_fault: bool) -> None:
    tree.write("/etc/group", f"root:x:4711:\n{group}:x:{tree.path(GATE).stat().st_gid}:stonefall\nbroken\n")
    assert faults(tree).keys() == ({"light gate"} if is_fault else set())
    tree.path(GATE).chmod(0o666)
    assert faults(tree) == {}, "everybody may use it"


def test_a_spool_on_a_tmpfs_that_is_too_small_is_a_fault(tree: Tree) -> None:
    tree.write("/proc/mounts", "/dev/sda1 / ext4 rw 0 0\ntmpfs /run tmpfs rw,size=100000k,mode=755 0 0\n")
    (finding,) = faults(tree).values()
    assert "tmpfs of 0.10 GB" in finding.found
    assert "remount,size=648m /run" in str(finding.remedy)


def test_a_replay_needs_no_network_and_the_exit_code_tells(tree: Tree, tmp_path: Path) -> None:
    write_recording(tmp_path / "recording", [make_bundle(1)])
    config = tmp_path / "stonefall.toml"
    config.write_text(REPLAY.replace('"spool"', '"/run/stonefall"') + "retention.min_free_gb = 0.0\n")
    command = ["check-host", "--config", str(config), "--root", str(tree.root)]
    app, run = build_app(["check-host"]), CliRunner().invoke
    good = run(app, [*command, "--json"])
    assert good.exit_code == 0, good
    assert not any("net.core" in finding["subject"] for finding in json.loads(good.stdout))
    FAULTS["memory"](tree)
    bad = run(app, [*command, "--json"])
    assert bad.exit_code == 1
    wrong = [finding for finding in json.loads(bad.stdout) if finding["verdict"] == "fault"]
    assert [(finding["subject"], finding["found"]) for finding in wrong] == [("memory", "1.0 GB")]
    assert "-> fewer workers.slots" in run(app, command).stdout
