"""Releases on a host: the order of versions, which are kept, which is the current one."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from installer import releases
from installer.host import Host, InstallError
from support.installed_host import NEW, OLD, put


def test_versions_are_ordered_by_their_numbers() -> None:
    ordered = ["0.3.0", "0.3.1", "0.9.9", "0.10.0a1", "0.10.0rc2", "0.10.0rc10", "0.10.0", "1.0.0", "10.0.0"]
    assert sorted(sorted(ordered), key=releases.version_key) == ordered
    assert releases.version_key("1.0") == releases.version_key("1.0.0")
    with pytest.raises(ValueError, match="is not like"):
        releases.version_key("newest")


def test_three_releases_are_kept_among_them_the_ones_in_use() -> None:
    every = [replace(OLD, version=f"0.{minor}.0") for minor in (3, 9, 10, 11, 12)]
    by_version = {release.version: release for release in every}

    def removed(*needed: str) -> list[str]:
        return [each.version for each in releases.expendable(every, [by_version[name] for name in needed])]

    assert removed("0.12.0", "0.11.0") == ["0.9.0", "0.3.0"]
    assert removed("0.3.0", "0.12.0") == ["0.10.0", "0.9.0"]  # gone back to the oldest: it stays
    assert removed("0.12.0", "0.12.0") == ["0.9.0", "0.3.0"]
    assert releases.expendable(every[:3], [None]) == []


def test_the_current_release_changes_at_one_moment(host: Host) -> None:
    put(host, NEW)
    for release in (OLD, NEW, OLD):
        releases.make_current(host, release)
        assert releases.current(host) == release
    assert host.path(releases.CURRENT).readlink() == Path("releases/0.3.0")


def test_an_interrupted_release_does_not_count(host: Host) -> None:
    put(host, NEW)
    (NEW.folder(host) / releases.COMPLETE).unlink()
    releases.make_current(host, NEW)
    assert releases.installed(host) == [OLD]
    assert releases.current(host) is None


@pytest.mark.parametrize("text", ["{", "{}", json.dumps({**vars(OLD), "version": "../x"})])
def test_a_wrong_description_of_a_release_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bundle.json"
    path.write_text(text)
    with pytest.raises(InstallError, match=r"bundle\.json: "):
        releases.read_release(path)
