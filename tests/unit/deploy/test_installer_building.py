"""A release is built beside the others, and nothing of it stays if that fails."""

import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from installer import building, placement
from installer.host import Host, InstallError
from support.installed_host import NEW, OLD


def test_accounts_are_made_though_their_files_are_there_from_an_interrupted_installation(host: Host) -> None:
    placement.place(host, OLD)
    ran: list[str] = []

    def execute(command: Sequence[str], _: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
        ran.append(command[0])
        return subprocess.CompletedProcess(command, 0, "", "")

    building.make_accounts(replace(host, execute=execute), OLD)
    assert ran == ["systemd-sysusers", "systemd-tmpfiles"]


def test_a_failed_build_leaves_nothing_and_the_others_as_they_are(host: Host, tmp_path: Path) -> None:
    def execute(command: Sequence[str], _: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
        NEW.folder(host).mkdir()
        return subprocess.CompletedProcess(command, 1, "", "No space left on device")

    failing = replace(host, execute=execute)
    with pytest.raises(InstallError, match="No space left on device"):
        building.build(failing, tmp_path, NEW)
    assert not NEW.folder(host).exists()
    assert not building.build(failing, tmp_path, OLD)
    with pytest.raises(InstallError, match="a release never changes"):
        building.build(failing, tmp_path, replace(OLD, commit="another"))
    assert OLD.folder(host).exists()


@pytest.mark.parametrize("is_bridged", [False, True])
def test_packages_of_the_bridge_are_installed_where_it_is_configured(
    host: Host, tmp_path: Path, is_bridged: bool
) -> None:
    if is_bridged:
        host.path(building.BRIDGE).parent.mkdir(parents=True)
        host.path(building.BRIDGE).write_text("")
    ran: list[str] = []

    def execute(command: Sequence[str], _: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
        ran.append(" ".join(map(str, command)))
        return subprocess.CompletedProcess(command, 0, "", "")

    building.make_environment(replace(host, execute=execute), tmp_path, NEW)
    locks = [command.rpartition("/")[2] for command in ran if "--require-hashes" in command]
    assert locks == ["requirements-bridge.lock" if is_bridged else "requirements.lock"]
