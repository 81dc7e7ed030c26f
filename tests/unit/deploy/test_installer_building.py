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


def test_a_failed_build_leaves_nothing_and_the_others_as_they_are(
    host: Host, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def copy(source: Path, target: Path, **_: object) -> None:
        target.mkdir()
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(building.shutil, "copytree", copy)
    failing = replace(host, execute=lambda *_: pytest.fail("nothing is run"))
    with pytest.raises(OSError, match="No space left on device"):
        building.build(failing, tmp_path, NEW)
    assert not NEW.folder(host).exists()
    assert not building.build(failing, tmp_path, OLD)
    with pytest.raises(InstallError, match="a release never changes"):
        building.build(failing, tmp_path, replace(OLD, commit="another"))
    assert OLD.folder(host).exists()


def test_the_environment_is_copied_and_that_of_the_package_linked(
    host: Host, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bundle, folder = tmp_path / "bundle", NEW.folder(host)
    (bundle / "environment/bin").mkdir(parents=True)
    (bundle / "environment/one.py").write_text("1\n")
    (bundle / "environment/bin/python").symlink_to("/usr/bin/python3")
    folder.mkdir()
    (folder / "left").write_text("by an interrupted installation")
    building.copy_environment(bundle, folder)
    assert sorted(path.name for path in folder.iterdir()) == ["bin", "one.py"]
    assert (folder / "bin/python").readlink() == Path("/usr/bin/python3")
    assert not (folder / "one.py").samefile(bundle / "environment/one.py")

    monkeypatch.setattr(building, "PACKAGE", bundle)
    building.copy_environment(bundle, folder)
    assert (folder / "one.py").samefile(bundle / "environment/one.py")

    def refuse(*_: object) -> None:
        raise OSError(18, "Invalid cross-device link")

    monkeypatch.setattr(building.os, "link", refuse)
    building.copy_environment(bundle, folder)
    assert (folder / "one.py").read_text() == "1\n"


def test_a_release_for_another_debian_is_built_anew(host: Host, tmp_path: Path) -> None:
    trixie = replace(OLD, debian="13", commit="another")
    failing = replace(host, execute=lambda *_: pytest.fail("nothing is run without an environment"))
    with pytest.raises(FileNotFoundError):  # it goes on to the environment of the bundle, which has none here
        building.build(failing, tmp_path, trixie)
