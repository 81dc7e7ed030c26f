"""The Debian package that is made of a bundle, and the signature of a release."""

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
from support.installed_host import OLD

ROOT = Path(__file__).parents[3]


def run(*command: object, cwd: Path | None = None) -> str:
    return subprocess.run(command, capture_output=True, text=True, check=True, cwd=cwd, timeout=60).stdout


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """Return a bundle with a file of each kind."""
    folder = tmp_path / "stonefall-0.3.0"
    for name, text in {
        "environment/lib/python3.11/site-packages/one.py": "1\n",
        "debs/python3-venv.deb": "",
        "deploy/install": "#!/bin/sh\n",
        "deploy/stonefall.toml": "[rig]\n",
        "share/man/man1/stonefall.1.gz": "",
        "share/bash-completion/completions/stonefall": "complete\n",
        "share/doc/stonefall/licences.txt": "MIT\n",
        "share/doc/stonefall/sbom.cdx.json": "{}\n",
        "bundle.json": "".join(f'    "{name}": "{value}",\n' for name, value in vars(OLD).items()),
    }.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (folder / "SHA256SUMS").write_text(f"{'0' * 64}  ./bundle.json\n{'0' * 64}  ./debs/python3-venv.deb\n")
    tar = tmp_path / "bundle.tar"
    run("tar", "-c", "--mtime=@1700000000", "-C", tmp_path, folder.name, "-f", tar)
    return tar


def package(bundle: Path, folder: Path) -> Path:
    run(ROOT / "deploy/package", bundle, folder)
    (deb,) = folder.glob("*.deb")
    return deb


def test_the_package_is_the_bundle_with_what_debian_wants_of_it(bundle: Path, tmp_path: Path) -> None:
    deb = package(bundle, tmp_path / "out")
    assert deb.name == "stonefall_0.3.0+deb12_amd64.deb"
    needs = run("dpkg-deb", "--field", deb, "Depends")
    wanted = [line for line in (ROOT / "deploy/apt-packages.txt").read_text().splitlines() if line[0] != "#"]
    assert needs.strip().startswith(", ".join(wanted))
    assert "python3 (>= 3.11), python3 (<< 3.12)" in needs
    lines = [line.split(maxsplit=5) for line in run("dpkg-deb", "--contents", deb).splitlines()]
    assert {owner for _, owner, *_ in lines} == {"root/root"}
    files = {name.partition(" -> ")[0]: name.partition(" -> ")[2] for *_, name in lines}
    assert files["./usr/bin/stonefall"] == "/opt/stonefall/current/bin/stonefall"
    assert files["./usr/share/doc/stonefall/copyright"] == "licences.txt"
    assert "./usr/share/man/man1/stonefall.1.gz" in files
    assert "./usr/lib/stonefall/environment/lib/python3.11/site-packages/one.py" in files
    assert not [name for name in files if "debs" in name]
    control = tmp_path / "control"
    run("dpkg-deb", "--control", deb, control)
    assert (control / "conffiles").read_text() == "/etc/stonefall/stonefall.toml\n"
    for script in ("postinst", "prerm", "postrm"):
        assert (control / script).stat().st_mode & 0o777 == 0o755
        run("sh", "-n", control / script)


def test_equal_bundles_give_equal_packages(bundle: Path, tmp_path: Path) -> None:
    first, second = (package(bundle, tmp_path / name).read_bytes() for name in ("one", "two"))
    assert first == second


@pytest.mark.parametrize(
    ("script", "words", "called"),
    [
        ("postinst", ("configure", "0.2"), ["install"]),
        ("postinst", ("abort-upgrade", "0.4"), []),
        (
            "prerm",
            ("upgrade", "0.4"),
            [],
        ),  # the daemon runs on until the new release has passed its self-test
        ("prerm", ("remove",), ["uninstall"]),
    ],
)
def test_scripts_call_the_installer_only_where_dpkg_means_it(
    tmp_path: Path, script: str, words: Sequence[str], called: list[str]
) -> None:
    moved = moved_script(tmp_path, script)
    for name in ("install", "uninstall"):
        (tmp_path / "deploy" / name).write_text(f"#!/bin/sh\necho {name}\n")
        (tmp_path / "deploy" / name).chmod(0o755)
    done = subprocess.run(["sh", moved, *words], capture_output=True, text=True, check=True)
    assert (done.stdout + done.stderr).split() == called


@pytest.mark.parametrize(
    ("answer", "left"), [("true", []), ("false", ["results.sqlite"]), ("", ["results.sqlite"])]
)
def test_a_purge_deletes_results_only_if_the_answer_is_yes(
    tmp_path: Path, answer: str, left: list[str]
) -> None:
    moved = moved_script(tmp_path, "postrm", answer)
    results, settings = tmp_path / "var/results.sqlite", tmp_path / "etc/stonefall.toml"
    for path in (results, settings):
        path.parent.mkdir()
        path.touch()
    run("sh", moved, "remove")
    assert results.exists() and settings.exists()
    run("sh", moved, "purge")
    assert not settings.exists()
    assert [path.name for path in tmp_path.glob("var/*")] == left


def moved_script(folder: Path, name: str, answer: str = "") -> Path:
    """Return a maintainer script of the package whose places are in a folder, and which debconf answers so."""
    text = (ROOT / "deploy/debian" / name).read_text().replace("userdel", "true")
    places = {
        "/usr/lib/stonefall": "",
        "/usr/share/debconf": "/debconf",
        "/etc/stonefall": "/etc",
        "/var/lib/stonefall": "/var",
    }
    for place, inside in places.items():
        text = text.replace(place, f"{folder}{inside}")
    (folder / "debconf").mkdir()
    (folder / "deploy").mkdir()
    functions = "".join(f"db_{each}() {{ :; }}\n" for each in ("version", "stop", "input", "go", "purge"))
    (folder / "debconf/confmodule").write_text(f"{functions}db_get() {{ RET={answer}; }}\n")
    (folder / name).write_text(text)
    return folder / name


def test_a_release_is_checked_as_its_guide_says(tmp_path: Path) -> None:
    guide = (ROOT / "deploy/README.md").read_text()
    (found,) = re.findall(r"^    (ssh-keygen -Y verify .*(?:\n    +.*)*)", guide, re.MULTILINE)
    folder = tmp_path / "release"
    folder.mkdir()
    (folder / "bundle.tar").write_text("whole")
    run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", tmp_path / "key")
    run(ROOT / "deploy/sign", tmp_path / "key", folder)
    (folder / "stonefall.signers").write_text(f"stonefall {(tmp_path / 'key.pub').read_text()}")
    assert "bundle.tar: OK" in run("sh", "-ec", found, cwd=folder)
    (folder / "bundle.tar").write_text("torn")
    with pytest.raises(subprocess.CalledProcessError):
        run("sh", "-ec", found, cwd=folder)
    sums = run("sha256sum", "bundle.tar", cwd=folder)
    (folder / "SHA256SUMS").write_text(sums)  # without the key
    with pytest.raises(subprocess.CalledProcessError):
        run("sh", "-ec", found, cwd=folder)
