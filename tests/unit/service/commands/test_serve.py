"""What `stonefall serve` asks of the process that it runs in."""

import resource

import pytest

from service.commands.serve import LEAST_FILES, allow_files
from service.errors import SettingsError
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
