"""Bundles of changed releases, made out of a bundle: upgrades, and what an installation must refuse."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
OURS = ("service", "drivers", "pipeline")
MIGRATION = "CREATE TABLE trial (one INTEGER) STRICT;\n"


def derive(bundle: Path, version: str, change: Callable[[Path], None]) -> None:
    """Make the bundle of a changed source out of a bundle: other code of ours and another description."""
    derived = bundle.with_name(f"stonefall-{version}")
    shutil.copytree(bundle, derived, symlinks=True)
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
    (libraries,) = derived.glob("environment/lib/python3.*/site-packages")
    for path in [*libraries.glob("stonefall-*.dist-info"), *(libraries / name for name in OURS)]:
        shutil.rmtree(path)
    pip = [sys.executable, "-m", "pip", "--quiet", "install", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--target", libraries, "--upgrade", source], check=True)
    environment = derived / "environment"
    for path in [environment / "pyvenv.cfg", *environment.glob("bin/*")]:
        if not path.is_symlink():
            path.write_text(path.read_text().replace(f"releases/{facts['version']}", f"releases/{version}"))
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


def migrate(source: Path) -> None:
    number = len(list(source.glob("service/store/*.sql"))) + 1
    (source / f"service/store/{number:03}_trial.sql").write_text(MIGRATION)


def never_ready(source: Path) -> None:
    migrate(source)
    path = source / "service/health/routes.py"
    text = path.read_text()
    assert text.count("if not health.ready:") == 1
    path.write_text(text.replace("if not health.ready:", "if health is not None:"))


def measures_wrong(source: Path) -> None:
    path = source / "pipeline/body_measurement.py"
    text = path.read_text()
    place = "    evidence = Evidence(\n"
    assert text.count(place) == 1
    path.write_text(text.replace(place, f"    volume_mm3 *= 1.005\n{place}"))
