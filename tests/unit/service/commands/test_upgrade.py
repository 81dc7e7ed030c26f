"""`stonefall upgrade`: what is damaged or of a foreign key is refused; else the release's own installer runs."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from support.eventually import PATIENCE_S, eventually
from typer.testing import CliRunner, Result

from service.base.errors import UsageError
from service.commands import upgrade
from service.commands.cli import build_app

ROOT = Path(__file__).parents[4]


@pytest.fixture
def release(tmp_path: Path) -> Path:
    """Return the file of a release whose installer says how it was run."""
    inner = tmp_path / "made/stonefall-9.0.0"
    (inner / "deploy").mkdir(parents=True)
    (inner / "bundle.json").write_text("{}")
    (inner / "deploy/install").write_text('echo "$(basename "$(dirname "$0")") $*" >"$TOLD"; exit 7\n')
    file = tmp_path / "stonefall-9.0.0-debian12-amd64.tar.gz"
    subprocess.run(["tar", "-czf", file, "-C", tmp_path / "made", "stonefall-9.0.0"], check=True)
    return file


def upgraded(*arguments: object) -> Result:
    return CliRunner().invoke(build_app(["upgrade"]), ["upgrade", *map(str, arguments)])


def key(folder: Path, name: str) -> Path:
    path = folder / name
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", name, "-f", path], check=True)
    return path


def sign(file: Path, private: Path) -> None:
    """Sign a release as `deploy/sign` does."""
    sums = subprocess.run(["sha256sum", file.name], cwd=file.parent, capture_output=True, check=True).stdout
    (file.parent / "SHA256SUMS").write_bytes(sums)
    (file.parent / "SHA256SUMS.sig").unlink(missing_ok=True)
    command = ["ssh-keygen", "-q", "-Y", "sign", "-f", private, "-n", "stonefall", file.parent / "SHA256SUMS"]
    subprocess.run(command, check=True, capture_output=True)


@pytest.mark.parametrize(
    ("options", "passed"), [((), ""), (("--dry-run",), " --show"), (("--yes", "--stones", "9"), " --yes")]
)
@pytest.mark.parametrize("is_unpacked", [False, True])
def test_the_release_s_own_installer_reviews_it(
    options: tuple[str, ...],
    passed: str,
    is_unpacked: bool,
    release: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TOLD", str(tmp_path / "told"))
    done = upgraded(tmp_path / "made/stonefall-9.0.0" if is_unpacked else release, *options)
    assert done.exit_code == 7  # the installer's
    assert (tmp_path / "told").read_text() == f"deploy --review={9 if options[1:] else 50}{passed}\n"


def test_an_interrupted_installer_ends_in_its_own_order(tmp_path: Path) -> None:
    """Ctrl-C reaches both: the installer goes back to the former release, which nothing may cut short."""
    (tmp_path / "deploy").mkdir()
    (tmp_path / "deploy/install").write_text(
        "trap 'sleep 1; touch rolled-back; exit 5' INT\ntouch started\nwhile :; do sleep 0.05; done\n"
    )
    program = (
        "import sys; from pathlib import Path; from service.commands.upgrade import install_from as run;"
    )
    with subprocess.Popen(
        [sys.executable, "-c", f"{program} sys.exit(run(Path('.'), []))"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        start_new_session=True,
    ) as process:
        eventually((tmp_path / "started").exists)
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait(PATIENCE_S) == 5
    assert (tmp_path / "rolled-back").exists()


def test_what_is_no_release_is_refused(release: Path, tmp_path: Path) -> None:
    assert "no such file" in str(upgraded(tmp_path / "none.tar").exception)
    assert "has no deploy/install" in str(upgraded(tmp_path).exception)
    release.write_bytes(release.read_bytes()[:50])
    assert "is no file of a release" in str(upgraded(release).exception)


def test_checksums_and_signature_decide_before_anything_is_unpacked(release: Path, tmp_path: Path) -> None:
    signers = tmp_path / "release-signers"
    ours, theirs = key(tmp_path, "ours"), key(tmp_path, "theirs")
    (said,) = upgrade.checks_of(release, signers)
    assert said.startswith("no SHA256SUMS beside")
    sign(release, ours)
    (said,) = upgrade.checks_of(release, signers)
    assert said.startswith("SHA-256 and signature; whose it is nobody says here")
    signers.write_text(f"stonefall {ours.with_suffix('.pub').read_text()}")
    assert upgrade.checks_of(release, signers) == [f"SHA-256 and signature, of a key in {signers}"]
    sign(release, theirs)
    with pytest.raises(UsageError, match="not of a key in"):
        upgrade.checks_of(release, signers)
    sums = tmp_path / "SHA256SUMS"
    sign(release, ours)
    sums.write_text(sums.read_text() + f"{64 * '0'}  other\n")
    for trusted in (signers, tmp_path / "none"):
        with pytest.raises(UsageError, match="nothing was changed"):
            upgrade.checks_of(release, trusted)
    (tmp_path / "SHA256SUMS.sig").unlink()
    assert upgrade.checks_of(release, signers) == ["SHA-256 as in SHA256SUMS, which is not signed"]
    release.write_bytes(b"torn")
    assert "is not as" in str(upgraded(release).exception)
    sums.write_text(f"{64 * '0'}  other\n")
    with pytest.raises(UsageError, match="does not name it"):
        upgrade.checks_of(release, signers)
