"""What the pages take from npm: it comes with the wheel, and an installation without npm is whole all the same."""

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).parents[3]


def test_the_wheel_has_pages_and_packages_with_their_licence(tmp_path: Path) -> None:
    source = tmp_path / "source"
    for name in ("service", "drivers", "pipeline", "tests/research"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__", "packages"))
    for name in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / name, source / name)
    three = source / "service/screens/packages/three"
    three.mkdir(parents=True)
    for name in ("three.module.js", "LICENSE"):
        (three / name).write_text("from npm")
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", tmp_path, source],
        check=True,
    )  # fmt: skip
    (wheel,) = tmp_path.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    pages = {path.relative_to(ROOT).as_posix() for path in (ROOT / "service/screens").glob("*/*.*")}
    assert {name for name in pages if "/packages/" not in name and "/__pycache__/" not in name} <= names
    assert {f"service/screens/packages/three/{name}" for name in ("three.module.js", "LICENSE")} <= names
    assert {"research/benchmark.py", "pipeline/evaluation/trials.py"} <= names, (
        "a plant's lacks them: deploy/bundle"
    )


def test_without_npm_it_says_so_in_one_line_and_succeeds(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "deploy", tmp_path / "deploy", ignore=shutil.ignore_patterns("node_modules"))
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("bash", "cat", "cut", "dirname", "env", "sha256sum"):
        found = shutil.which(name)
        assert found is not None
        (tools / name).symlink_to(found)
    done = subprocess.run(
        [tmp_path / "deploy/packages"],
        env={**os.environ, "PATH": str(tools)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "" and len(done.stderr.splitlines()) == 1 and "npm is not installed" in done.stderr
    assert not (tmp_path / "service").exists()


def test_the_lock_pins_every_package_by_hash_and_names_no_host() -> None:
    text = (ROOT / "deploy/npm/package-lock.json").read_text()
    packages = {name: each for name, each in json.loads(text)["packages"].items() if name}
    assert set(packages) == {"node_modules/three", "node_modules/axe-core"}
    assert all(each["integrity"].startswith("sha512-") for each in packages.values())
    assert "http" not in text
