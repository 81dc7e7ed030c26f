"""What `stonefall serve` asks of the process that it runs in."""

import os
import resource
import subprocess
import sys

import pytest

from service.base.errors import SettingsError
from service.commands.serve import LEAST_FILES, allow_files
from service.host.machine import FILES


@pytest.mark.parametrize("most", [LEAST_FILES, FILES, 2 * FILES, resource.RLIM_INFINITY])
def test_it_may_open_as_many_files_as_the_host_allows(monkeypatch: pytest.MonkeyPatch, most: int) -> None:
    asked: list[tuple[int, tuple[int, int]]] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: (64, most))
    monkeypatch.setattr(resource, "setrlimit", lambda kind, limits: asked.append((kind, limits)))
    allow_files()
    n_files = LEAST_FILES if most == LEAST_FILES else FILES
    assert asked == [(resource.RLIMIT_NOFILE, (n_files, most))]


def test_a_host_that_allows_too_few_is_told_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (64, 64))
    with pytest.raises(SettingsError, match=r"only 64 files.*LimitNOFILE=4096.*ulimit -Hn 4096"):
        allow_files()


PROGRAM = """
import os
from service.commands.serve import open_standard_files
open_standard_files()
opened = os.open("/", os.O_RDONLY)
os._exit(0 if opened == 3 and os.read(0, 1) == b"" and os.write(2, b"x") == 1 else 1)
"""


def test_closed_standard_files_are_replaced_before_anything_else_gets_their_numbers() -> None:
    """Started with `<&- >&- 2>&-` sockets and files got the numbers 0 to 2, and the daemon did not start."""
    shell = '"$0" -c "$1" <&- >&- 2>&-'
    run = subprocess.run(["sh", "-c", shell, sys.executable, PROGRAM], check=False, env=dict(os.environ))
    assert run.returncode == 0
