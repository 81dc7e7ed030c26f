"""Files in /etc: placed, replaced while nobody edited them, and taken away again."""

from dataclasses import replace
from pathlib import Path

import pytest
from installer import placement, service, switch, uninstall
from installer.host import Host, InstallError
from support.installed_host import NEW, OLD, UNIT, Script, put

ROOT = Path(__file__).parents[3]


def test_files_are_placed_once_and_an_edited_one_stays(host: Host) -> None:
    assert placement.place(host, OLD) == [
        "/etc/systemd/network/50-x.network.default",  # ports of another machine: only an example
        "/etc/sysctl.d/90-x.conf",
        UNIT,
        "/etc/sysusers.d/stonefall.conf",
        "/etc/stonefall/stonefall.toml",
    ]
    assert placement.place(host, OLD) == []

    put(host, NEW, unit="[Unit]\nDescription=new\n")
    host.path("/etc/stonefall/stonefall.toml").write_text("# mine\n")
    assert placement.place(host, NEW) == [UNIT, "/etc/stonefall/stonefall.toml.default"]
    assert host.path("/etc/stonefall/stonefall.toml").read_text() == "# mine\n"
    assert UNIT in placement.place(host, OLD)  # a rollback brings the unit of its release

    host.path(UNIT).write_text("[Unit]\nDescription=mine\n")
    assert f"{UNIT}.default" in placement.place(host, NEW)
    assert host.path(UNIT).read_text() == "[Unit]\nDescription=mine\n"
    assert dict(placement.placed(host, [OLD, NEW])) == {
        "/etc/sysctl.d/90-x.conf": False,
        "/etc/systemd/network/50-x.network.default": False,
        UNIT: True,
        f"{UNIT}.default": False,
        "/etc/sysusers.d/stonefall.conf": False,
    }


def test_the_configuration_is_not_even_replaced_when_unedited(host: Host) -> None:
    placement.place(host, OLD)
    put(host, NEW)
    assert placement.place(host, NEW) == ["/etc/stonefall/stonefall.toml.default"]
    assert host.path("/etc/stonefall/stonefall.toml").read_text() == "# of 0.3.0\n"


def test_a_dry_run_changes_nothing(host: Host, capsys: pytest.CaptureFixture[str]) -> None:
    dry = replace(host, dry_run=True)
    before = sorted(host.root.rglob("*"))
    assert len(placement.place(dry, OLD)) == 5
    assert switch.activate(dry, OLD)
    assert sorted(host.root.rglob("*")) == before
    assert UNIT in capsys.readouterr().out


def test_every_file_of_the_repository_has_its_place() -> None:
    targets = [each.target for each in placement.placements(ROOT)]
    assert len(targets) == len(set(targets))
    assert "/etc/systemd/system/stonefall.service.d/networks.conf" in targets
    assert f"/etc/systemd/system/{service.BRIDGE}" in targets
    assert all(target.startswith("/etc/") for target in targets)


def test_uninstalling_leaves_results_and_what_was_edited(host: Host, script: Script) -> None:
    scripted = replace(host, execute=script)
    results = host.path("/var/lib/stonefall/results.sqlite")
    results.write_text("results")
    host.path("/etc/sysctl.d/90-x.conf").write_text("# mine\n")
    with pytest.raises(InstallError, match="nothing was changed"):
        uninstall.uninstall(scripted, "yes")
    assert host.path(UNIT).exists()
    uninstall.uninstall(scripted, None)
    left = {str(path.relative_to(host.root)) for path in host.root.rglob("*") if path.is_file()}
    assert left == {
        "var/lib/stonefall/results.sqlite",
        "etc/stonefall/stonefall.toml",
        "etc/sysctl.d/90-x.conf",
    }
    uninstall.uninstall(scripted, uninstall.WORDS)
    assert not results.exists()


def test_the_command_is_on_the_path_unless_the_package_has_put_it_there(host: Host) -> None:
    assert switch.activate(host, OLD)
    links = [host.path(link) for link in placement.LINKS]
    assert [str(link.readlink()) for link in links] == [
        "/opt/stonefall/current/bin/stonefall",
        "/opt/stonefall/current/share/man/man1/stonefall.1.gz",
        "/opt/stonefall/current/share/bash-completion/completions/stonefall",
    ]
    assert not placement.link_command(host)
    links[0].unlink()
    links[0].write_text("another program\n")
    assert not placement.link_command(host)
    assert list(placement.links(host)) == list(placement.LINKS)[1:]
    for link in links[1:]:
        link.unlink()
    host.path(placement.PACKAGED).parent.mkdir(parents=True)
    host.path(placement.PACKAGED).symlink_to("/opt/stonefall/current/bin/stonefall")
    assert not placement.link_command(host)  # the package has its own


def test_a_dry_run_links_nothing(host: Host) -> None:
    assert placement.link_command(replace(host, dry_run=True))
    assert not host.path("/usr/local").exists()
