"""`stonefall upgrade`: check a release's file, show what it changes and how results would shift, ask, switch.

The file brings the installer that does it, `deploy/install --review`: here the file is checked and unpacked.
"""

import hashlib
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from service.base.errors import UsageError

SIGNERS = Path("/etc/stonefall/release-signers")
"""Keys whose releases are installed, as `ssh-keygen` reads them (ALLOWED SIGNERS): `stonefall ssh-ed25519 AAAA...`"""
SUMS, SIGNATURE = "SHA256SUMS", "SHA256SUMS.sig"
NAMESPACE = "stonefall"


def command(
    file: Annotated[
        Path, typer.Argument(help="The file of a release, or the folder that it was unpacked to.")
    ],
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Put it beside the current release, show all, and switch nothing."),
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Do not ask while shifts are within the limits.")
    ] = False,
    stones: Annotated[int, typer.Option(min=1, help="Newest archived stones that are compared.")] = 50,
) -> None:
    """Upgrade this host to a release: check it, show what changes, compare results of archived stones, ask, switch.

    As root. The daemon measures until the switch; a release that is not healthy then is rolled back by itself.
    """
    chosen = [f"--review={stones}", *(["--show"] if dry_run else ["--yes"] if yes else [])]
    if file.is_dir():
        raise typer.Exit(install_from(file, chosen))
    if not file.is_file():
        raise UsageError(f"{file}: there is no such file")
    for line in checks_of(file):
        typer.echo(f"  checked   {line}")
    with tempfile.TemporaryDirectory(prefix="stonefall-upgrade-", dir="/var/tmp") as folder:
        unpacked = _run("tar", "-x", "--no-same-owner", "--strip-components=1", "-C", folder, "-f", file)
        if unpacked.returncode != 0 or not (Path(folder) / "bundle.json").is_file():
            raise UsageError(
                f"{file}: is no file of a release: {unpacked.stderr.strip() or 'it has no bundle.json'}"
            )
        raise typer.Exit(install_from(Path(folder), chosen))


def install_from(folder: Path, chosen: list[str]) -> int:
    """Run the installer of an unpacked release, on this terminal; return its exit status."""
    install = folder.resolve() / "deploy/install"
    if not install.is_file():
        raise UsageError(f"{folder}: is no release: it has no deploy/install")
    process = subprocess.Popen(["/bin/bash", install, *chosen])  # noqa: S603 - its sums were checked
    while True:
        with suppress(
            KeyboardInterrupt
        ):  # the installer has it from the same terminal, and goes back in order
            return process.wait()


def checks_of(file: Path, signers: Path = SIGNERS) -> list[str]:
    """Check a file against the checksums beside it, and these against their signature; return what was checked.

    What the file has within is checked by its installer, against its own checksums.

    Raises `UsageError` when it is another file, or the signature is not of a key that this host relies on.
    """
    sums, signature = file.with_name(SUMS), file.with_name(SIGNATURE)
    if not sums.is_file():
        return [f"no {SUMS} beside {file.name}: only the checksums within it say that it is whole"]
    with file.open("rb") as content:
        digest = hashlib.file_digest(content, "sha256").hexdigest()
    listed = dict(line.split(maxsplit=1)[::-1] for line in sums.read_text().splitlines() if line.strip())
    known = listed.get(file.name) or listed.get(f"*{file.name}")
    if known != digest:
        raise UsageError(
            f"{file}: is not as {sums} says{'' if known else ', which does not name it'}: nothing was changed"
        )
    if not signature.is_file():
        return [f"SHA-256 as in {SUMS}, which is not signed"]
    if not signers.is_file():
        found = _run("ssh-keygen", "-Y", "check-novalidate", "-n", NAMESPACE, "-s", signature, stdin=sums)
        if found.returncode != 0:
            raise UsageError(f"{signature}: {_last(found)}: nothing was changed")
        return [f"SHA-256 and signature; whose it is nobody says here: no {signers}. {_last(found)}"]
    verify = ("ssh-keygen", "-Y", "verify", "-f", signers, "-I", NAMESPACE, "-n", NAMESPACE, "-s", signature)
    found = _run(*verify, stdin=sums)
    if found.returncode != 0:
        raise UsageError(f"{signature}: not of a key in {signers}: {_last(found)}: nothing was changed")
    return [f"SHA-256 and signature, of a key in {signers}"]


def _run(*words: object, stdin: Path | None = None) -> subprocess.CompletedProcess[str]:
    text = None if stdin is None else stdin.read_text()
    command = [str(word) for word in words]
    return subprocess.run(command, input=text, capture_output=True, text=True, check=False)  # noqa: S603 - no shell


def _last(done: subprocess.CompletedProcess[str]) -> str:
    lines = (done.stdout + done.stderr).strip().splitlines()
    return lines[-1] if lines else f"exit {done.returncode}"
