"""What `deploy/install` looks at before Python is needed."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from installer.releases import Release
from support.installed_host import OLD

ROOT = Path(__file__).parents[3]


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """Return a bundle's folder with everything that is looked at before Python is needed."""
    folder = tmp_path / "stonefall-0.3.0"
    (folder / "deploy").mkdir(parents=True)
    for name in ("install", "environment", "apt-packages.txt"):
        (folder / "deploy" / name).write_bytes((ROOT / "deploy" / name).read_bytes())
    (folder / "numpy.whl").write_bytes(b"whole")
    return folder


def refusal(folder: Path, release: Release) -> str:
    """Return what the installer says of a bundle that it refuses."""
    (folder / "bundle.json").write_text(json.dumps(vars(release), indent=4))
    done = subprocess.run(
        ["bash", folder / "deploy/install", "--dry-run"], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1
    return done.stderr


@pytest.mark.parametrize("argument", ["--dry", "0.3.0", "--purge"])
def test_a_misspelt_argument_changes_nothing(bundle: Path, argument: str) -> None:
    done = subprocess.run(
        ["bash", bundle / "deploy/install", argument], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1
    assert f"there is no argument {argument}" in done.stderr


def add_sums(folder: Path) -> None:
    names = ["numpy.whl", "deploy/install"]
    sums = subprocess.run(["sha256sum", *names], cwd=folder, capture_output=True, check=True).stdout
    (folder / "SHA256SUMS").write_bytes(sums)


def test_a_damaged_bundle_is_refused_before_anything(bundle: Path) -> None:
    add_sums(bundle)
    (bundle / "numpy.whl").write_bytes(b"torn!")
    assert "the bundle is damaged, nothing was changed; copy it again: numpy.whl: FAILED" in refusal(
        bundle, OLD
    )
    (bundle / "numpy.whl").unlink()
    assert "numpy.whl: No such file" in refusal(bundle, OLD)
    (bundle / "SHA256SUMS").unlink()
    assert "SHA256SUMS: No such file" in refusal(bundle, OLD)


def test_a_host_of_another_kind_or_without_room_is_refused(bundle: Path) -> None:
    add_sums(bundle)
    own = subprocess.run(["dpkg", "--print-architecture"], capture_output=True, text=True, check=True)
    here = replace(OLD, architecture=own.stdout.strip())
    assert "the bundle is for vax" in refusal(bundle, replace(here, architecture="vax"))
    assert "it needs 999999999999 MB of disk" in refusal(bundle, replace(here, needs_mb=999999999999))
